"""All settings of a fleet file; a motor's file may override any key of those in `Settings`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import Field

from pipeline.config.execution import Execution, Folders, Metrics, Retention
from pipeline.config.faults import Misfit
from pipeline.config.fitting import Estimation, Model, ReferenceConditions
from pipeline.config.preparation import (
    Cleaning,
    Nights,
    SensorHealth,
    Smoothing,
    TimeBase,
    TransportDelay,
    Windows,
)
from pipeline.config.section import Section
from pipeline.config.watching import Alarms, Look, Trend


class Settings(Section):
    """All that a motor's file may override."""

    nights: Nights = Nights()
    time_base: TimeBase = TimeBase()
    cleaning: Cleaning = Cleaning()
    transport_delay: TransportDelay = TransportDelay()
    smoothing: Smoothing = Smoothing()
    windows: Windows = Windows()
    model: Model = Model()
    estimation: Estimation = Estimation()
    reference: ReferenceConditions = ReferenceConditions()
    sensor_health: SensorHealth = SensorHealth()
    trend: Trend = Trend()
    alarms: Alarms = Alarms()
    look: Look = Look()

    def misfits(self) -> Iterator[Misfit]:
        """Smoothing that reaches beyond a block."""
        if self.smoothing.window_s >= self.windows.block_s:
            message = f"expected less than windows.block_s = {self.windows.block_s:g}"
            yield ("smoothing", "window_s"), message, self.smoothing.window_s


class FleetFile(Settings):
    """`fleet.toml`."""

    name: str = Field(min_length=1)
    """The fleet's name, as reports show it."""
    folders: Folders = Folders()
    execution: Execution = Execution()
    retention: Retention = Retention()
    metrics: Metrics = Metrics()
    defaults: dict[str, Any] = Field({})
    """Any part of a motor's file, for motors that do not state it: tables are merged key by key,
    but a channel's that names a `source` or a `constant` stands alone. `{name_in_log}` in a text is
    the motor's name in the log."""

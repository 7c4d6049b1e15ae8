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
from pipeline.config.section import Section, Stage, left_out
from pipeline.config.watching import Alarms, Look, Trend


class Settings(Section):
    """All that a motor's file may override."""

    nights: Nights = left_out()
    time_base: TimeBase = left_out()
    cleaning: Cleaning = left_out()
    transport_delay: TransportDelay = left_out()
    smoothing: Smoothing = left_out()
    windows: Windows = left_out()
    model: Model = left_out()
    estimation: Estimation = left_out()
    reference: ReferenceConditions = left_out()
    sensor_health: SensorHealth = left_out()
    trend: Trend = left_out()
    alarms: Alarms = left_out()
    look: Look = left_out()

    def misfits(self) -> Iterator[Misfit]:
        """Smoothing that reaches beyond a block."""
        if self.smoothing.window_s >= self.windows.block_s:
            message = f"expected less than windows.block_s = {self.windows.block_s:g}"
            yield ("smoothing", "window_s"), message, self.smoothing.window_s


class FleetFile(Settings):
    """`fleet.toml`."""

    shapes = Stage.NOTHING

    name: str = Field(min_length=1)
    """The fleet's name, as reports show it."""
    folders: Folders = left_out()
    execution: Execution = left_out()
    retention: Retention = left_out()
    metrics: Metrics = left_out()
    defaults: dict[str, Any] = Field({})
    """Any part of a motor's file, for motors that do not state it: tables are merged key by key,
    but a channel's that names a `source` or a `constant` stands alone. `{name_in_log}` in a text is
    the motor's name in the log."""

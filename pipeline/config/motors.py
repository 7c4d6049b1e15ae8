"""A motor's file: what it is, where its logs lie and how to read them, what happened to it."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, Field

from leakage import Constant, Parameter
from leakage.estimation.blocks import ChosenPeriods, Stretch
from leakage.physics.paths import FLUSHING_PARAMETER, FLUSHING_PATH
from pipeline.clock import microseconds
from pipeline.config.channels import (
    COUNTED,
    NEVER_CONSTANT,
    PORT_PRESSURES,
    Channel,
    ChannelName,
)
from pipeline.config.logs import Logs, field_path
from pipeline.config.motor_types import OilSample, order_faults
from pipeline.config.nights import Night
from pipeline.config.section import (
    Id,
    Misfit,
    NonNegative,
    OilName,
    Section,
    Stage,
    left_out,
    name_of,
)
from pipeline.units import QUANTITIES, UNITS

# Events behind which the motor is the same: its baseline and its change go on (model.md, 7c.6).
CARRIED = ("oil_change", "meter_changed", "sensor_changed")
# An estimated flushing is at most this, or four times what is stated of it.
MOST_FLUSHING_L_PER_MIN = 20.0


class Event(Section):
    """Something that happened to a motor, dated.

    An overhaul, an exchanged motor and a changed flushing start a new baseline; a change of oil, of
    the flow meter or of another sensor carries the baseline and the change so far across.
    """

    shapes = Stage.TRENDS

    date: dt.date
    """First night's label from which it holds."""
    kind: Literal[
        "overhaul",
        "oil_change",
        "meter_changed",
        "sensor_changed",
        "motor_exchanged",
        "flushing_change",
        "note",
    ]
    """A `note` (a filter change, a cleaning) is shown only."""
    oil: OilName | None = None
    """The new oil, where it changed; needed for `oil_change`."""
    note: Annotated[str, Stage.NOTHING] = ""
    """In words."""

    def misfits(self) -> Iterator[Misfit]:
        if self.kind == "oil_change" and self.oil is None:
            yield self.at("oil", "expected the oil's name: the old one if it is of the same kind")
        if self.kind == "note" and self.oil is not None:
            yield self.at("oil", 'a note changes nothing: expected kind = "oil_change"')


class Periods(Section):
    """Times chosen by hand; a night that any of them touches uses only these."""

    shapes = Stage.BLOCKS

    training: tuple[tuple[AwareDatetime, AwareDatetime], ...] = ()
    """Periods [from, to) to fit, with offset from UTC."""
    validation: tuple[tuple[AwareDatetime, AwareDatetime], ...] = ()
    """Periods to validate on."""

    def misfits(self) -> Iterator[Misfit]:
        periods = sorted((*self.training, *self.validation))
        if any(begin >= end for begin, end in periods):
            yield (), "expected each period as [from, to], the later time second", None
        if any(period[1] > following[0] for period, following in pairwise(periods)):
            yield (), "expected periods that do not overlap", None

    def within(self, night: Night) -> ChosenPeriods:
        """Return those that touch a night, in order of time."""

        def touching(chosen: Iterable[tuple[dt.datetime, dt.datetime]]) -> tuple[Stretch, ...]:
            stretches = sorted((microseconds(begin), microseconds(end)) for begin, end in chosen)
            return tuple(
                stretch
                for stretch in stretches
                if stretch[0] < night.end_us and stretch[1] > night.start_us
            )

        return ChosenPeriods(touching(self.training), touching(self.validation))


class FlushingTable(Section):
    """Flushing of the motor: the flow that is added on the way to the sensor."""

    shapes = Stage.FIGURES

    mode: Literal["none", "fixed", "estimated"] = "none"
    """Flushing in the primary fit."""
    also: tuple[Literal["none", "fixed", "estimated"], ...] = ()
    """Other modes to fit beside the primary."""
    flow_l_per_min: NonNegative = 0.0
    """The fixed value, or the first starting point."""

    def misfits(self) -> Iterator[Misfit]:
        if len({self.mode, *self.also}) != 1 + len(self.also):
            yield (), "expected each mode once among mode and also", None

    @property
    def modes(self) -> tuple[str, ...]:
        """All modes to fit, the primary first."""
        return (self.mode, *self.also)

    def path(self, mode: str) -> Constant:
        """Return the flushing of a mode as a constant path."""
        flow = 0.0 if mode == "none" else self.flow_l_per_min
        most = max(MOST_FLUSHING_L_PER_MIN, 4.0 * flow)
        limits = (0.0, most) if mode == "estimated" else (flow, flow)
        return Constant(
            FLUSHING_PATH,
            Parameter(FLUSHING_PARAMETER, "l_per_min", flow, *limits, fixed=mode != "estimated"),
        )


class MotorFile(Section):
    """`motors/<motor_id>.toml`."""

    shapes = Stage.TRENDS

    motor_id: Id
    """Unique name, which is also the file's."""
    motor_type: Annotated[str, name_of("motor_types"), Stage.FIGURES]
    """One of the motor types."""
    name_in_log: Annotated[str, Stage.NOTHING] = Field("", exclude=True)
    """The motor's name in the log, where not `motor_id`."""
    formerly: Annotated[str, Stage.NOTHING] = Field("", exclude=True)
    """Its `motor_id` before it was renamed: the next run gives it what is published of that."""
    oil: OilName
    """One of the oils; changes are dated in `events`."""
    oil_circuit: str = ""
    """Motors with the same name share tank and pump."""
    logs: Logs
    """The log files."""
    channels: dict[ChannelName, Channel]
    """Where each channel stands in the log."""
    flushing: FlushingTable = left_out()
    """Flow added before the sensor."""
    periods: Periods = left_out()
    """Training and validation set by hand."""
    events: tuple[Event, ...] = Field((), max_length=1000)
    """Dated events."""
    oil_samples: tuple[OilSample, ...] = Field((), max_length=1000)
    """Analyses of the oil, by date; those of a shared oil are in its circuit's file."""
    override: Annotated[dict[str, Any], Stage.NOTHING] = Field({})
    """Any section of the fleet file, for this motor alone."""

    def misfits(self) -> Iterator[Misfit]:
        yield from self._missing_channels()
        yield from order_faults(self.oil_samples)
        taken: dict[tuple[str, str], str] = {}
        for name, channel in self.channels.items():
            for key, message in self._misfits_of(name, channel, taken):
                yield ("channels", name, key), message, getattr(channel, key)

    def _misfits_of(
        self, name: str, channel: Channel, taken: dict[tuple[str, str], str]
    ) -> Iterator[tuple[str, str]]:
        place = (channel.source, channel.field or self.logs.value_column)
        other = taken.setdefault(place, name) if channel.source else name
        if other != name:
            yield "source", f"expected a column of its own: this is that of {other}, too"
        if channel.constant is not None and name in NEVER_CONSTANT:
            yield "constant", "expected a source"
        known = UNITS[QUANTITIES[name]]
        if channel.unit not in known and not (channel.is_counted and name == COUNTED):
            yield "unit", f"expected one of {', '.join(known)}"
        if any(unit not in known for unit, _ in channel.earlier_units):
            yield "earlier_units", f"expected units of {', '.join(known)}"
        for key in ("field", "quality_source") if self.logs.format == "mcap" else ():
            try:
                field_path(getattr(channel, key) or "value")
            except ValueError as error:
                yield key, str(error)

    def _missing_channels(self) -> Iterator[Misfit]:
        names = set(self.channels)
        given = ", ".join(sorted(names))
        ports = set(PORT_PRESSURES)
        if (ports <= names) == ("pressure_difference" in names) or len(ports & names) == 1:
            message = "expected pressure_difference, or high_port_pressure and low_port_pressure"
            yield ("channels",), message, given
        if absent := {"oil_temperature", "speed", "leakage_flow"} - names:
            yield ("channels",), f"expected also {', '.join(sorted(absent))}", given
        if {"kinematic_viscosity", "dynamic_viscosity"} <= names:
            message = "expected kinematic_viscosity or dynamic_viscosity, not both"
            yield ("channels",), message, given

    @property
    def changes(self) -> tuple[Event, ...]:
        """Events that change what the nights show."""
        return tuple(event for event in self.events if event.kind != "note")

    @property
    def baseline_events(self) -> tuple[Event, ...]:
        """Events that begin a new baseline: nights before are no measure for those after."""
        return tuple(event for event in self.changes if event.kind not in CARRIED)

    def alike(self, night: dt.date) -> tuple[dt.date, dt.date]:
        """Return since when, and until before when, readings are a night's by columns and units.

        Other oil changes none of them but the flow, by as much as the model says.
        """
        dates = [event.date for event in self.changes if event.kind != "oil_change"]
        since = max((date for date in dates if date <= night), default=dt.date.min)
        return since, min((date for date in dates if date > night), default=dt.date.max)

    @property
    def oils(self) -> tuple[str, ...]:
        """Names of the oils that the motor runs on or did."""
        return tuple(dict.fromkeys([self.oil, *(event.oil for event in self.events if event.oil)]))

    def oil_on(self, night: dt.date) -> str:
        """Name of the oil that the motor runs on in a night."""
        change = self._filling(night)
        return self.oil if change is None else change.oil or self.oil

    def filled_on(self, night: dt.date) -> dt.date | None:
        """Return date on which the oil of a night was filled in; None where no event tells it."""
        change = self._filling(night)
        return None if change is None else change.date

    def _filling(self, night: dt.date) -> Event | None:
        changes = [event for event in self.events if event.oil and event.date <= night]
        return max(changes, key=lambda event: event.date, default=None)

"""A motor's file: what it is, where its logs lie and how to read them, what happened to it."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from leakage import Constant, Parameter
from pipeline.config.faults import Place, refuse
from pipeline.config.motor_types import FLUSHING_PARAMETER, FLUSHING_PATH
from pipeline.config.settings import NonNegative, Positive, Section, known_zone
from pipeline.errors import UsageError
from pipeline.ingest import ChannelSource, LogSource
from pipeline.ingest.time_stamps import require_time_format
from pipeline.units import CHANNELS, QUANTITIES, UNITS

MotorId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
ChannelName = Literal[
    "pressure_difference",
    "high_port_pressure",
    "low_port_pressure",
    "charge_pressure",
    "case_pressure",
    "oil_temperature",
    "speed",
    "leakage_flow",
]
FALLBACK_VALID_RANGE: dict[str, tuple[float, float]] = {
    "pressure_difference": (-450.0, 450.0),
    "high_port_pressure": (-1.0, 450.0),
    "low_port_pressure": (-1.0, 450.0),
    "charge_pressure": (-1.0, 100.0),
    "case_pressure": (-1.0, 50.0),
    "oil_temperature": (-40.0, 120.0),
    "speed": (-500.0, 500.0),
    "leakage_flow": (0.0, 200.0),
}


class Channel(Section):
    """One channel of the log: where it stands, its unit, and what its sensor can say.

    Limits, resolution and tolerance are in the unit of the tables (bar, °C, rpm, l/min), whatever
    the log's.
    """

    source: str = Field(
        min_length=1, description="Column of a CSV or Parquet log, topic of an MCAP"
    )
    field: str = Field(
        "value", min_length=1, description="Key in the JSON message of an MCAP topic"
    )
    unit: str = Field(description="Unit in the log")
    scale: float = Field(1.0, description="Factor on the logged number, before the unit")
    offset: float = Field(0.0, description="Added to the scaled number, in the log's unit")
    valid_range: tuple[float, float] | None = Field(
        None, description="Values outside are refused; without it the channel's usual range"
    )
    sensor_maximum: float | None = Field(
        None,
        description="Highest value that the sensor gives; for the drain flow also what it gives "
        "under back-flow",
    )
    resolution: NonNegative = Field(0.0, description="Smallest step of the sensor")
    offset_tolerance: NonNegative = Field(
        0.0, description="Stated constant error of the sensor; 0: none stated"
    )
    gain_tolerance_percent: NonNegative = Field(
        0.0, description="Stated error in proportion to the reading; 0: none stated"
    )
    frozen_after_s: Positive | None = Field(
        None, description="Overrides cleaning.frozen_after_s; temperature: 900 s unless stated"
    )

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, scale: float) -> float:
        if scale == 0.0:
            raise ValueError("expected a factor other than 0")
        return scale

    @field_validator("valid_range")
    @classmethod
    def _ordered(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        if limits is not None and not limits[0] < limits[1]:
            raise ValueError("expected [lowest, highest]")
        return limits


class Logs(Section):
    """The motor's log files and their dialect."""

    format: Literal["csv", "parquet", "mcap"] = Field(description="Format of the files")
    files: tuple[str, ...] = Field(
        min_length=1,
        description="Paths or globs below the log root; a path named and absent is an error",
    )
    time: str = Field(
        "time", description="Column of the time; MCAP: `log_time` or `publish_time` of the message"
    )
    time_format: str = Field(
        "iso8601",
        description="`iso8601`, `epoch_s`, `epoch_ms`, `epoch_us`, `epoch_ns` or a strptime format",
    )
    time_zone: str = Field("UTC", description="Zone of time stamps that state none")
    separator: str = Field(",", min_length=1, max_length=1, description="CSV: between cells")
    decimal: Literal[".", ","] = Field(".", description="CSV: decimal mark")
    encoding: str = Field("utf-8", description="CSV: text encoding")
    skip_rows: int = Field(0, ge=0, description="CSV: lines before the header")
    missing_tokens: tuple[str, ...] = Field(
        ("", "NA", "null"), description="CSV: what a cell without a value holds"
    )

    @field_validator("files")
    @classmethod
    def _below_the_log_root(cls, files: tuple[str, ...]) -> tuple[str, ...]:
        refuse(
            "files",
            (
                ((index,), message, pattern)
                for index, pattern in enumerate(files)
                if (message := _fault_of_pattern(pattern)) is not None
            ),
        )
        return files

    @field_validator("time_zone")
    @classmethod
    def _known_zone(cls, name: str) -> str:
        return known_zone(name)

    @field_validator("time_format")
    @classmethod
    def _known_format(cls, time_format: str) -> str:
        try:
            require_time_format(time_format)
        except UsageError as error:
            raise ValueError(error.message) from error
        return time_format

    @field_validator("encoding")
    @classmethod
    def _known_encoding(cls, encoding: str) -> str:
        try:
            b"x".decode(encoding, "ignore")  # an empty text asks no codec
        except (LookupError, ValueError):
            raise ValueError("expected a text encoding, such as utf-8 or cp1252") from None
        return encoding

    @model_validator(mode="after")
    def _readable(self) -> Logs:
        # The reader's own judgement of the dialect; the channel only stands in.
        try:
            self.source((ChannelSource("speed", "speed", "rpm"),))
        except UsageError as error:
            raise ValueError(error.message) from error
        return self

    def source(self, channels: tuple[ChannelSource, ...]) -> LogSource:
        """What the reader is told, with the channels that it is to read."""
        dialect = self.model_dump(exclude={"files", "time"})
        return LogSource(channels=channels, time_source=self.time, **dialect)


def _fault_of_pattern(pattern: str) -> str | None:
    """What is wrong with a path or glob of logs; None: nothing."""
    parts = pattern.replace("\\", "/").split("/")
    if pattern.startswith(("/", "\\")) or ".." in parts:
        return "expected a path below the log root, without '..'"
    if not pattern.isprintable() or not parts[-1].strip(". "):
        return "expected the name of a file, or a glob"
    if parts[-1] == "**" or any("**" in part and part != "**" for part in parts):
        return "expected ** only as a folder of its own, with a file's name or glob behind it"
    return None


class Event(Section):
    """Something that starts a new baseline."""

    date: dt.date = Field(description="First night's label from which it holds")
    kind: Literal["overhaul", "oil_change", "flushing_change", "motor_exchanged"] = Field(
        description="What happened"
    )
    oil: str | None = Field(None, description="The new oil, where it changed")
    note: str = Field("", description="In words")


class FlushingTable(Section):
    """How the motor is flushed: the flow that is added on the way to the sensor."""

    mode: Literal["none", "fixed", "estimated"] = Field(
        "none", description="The primary fit's: no flushing, a known flow, or an estimated one"
    )
    also: tuple[Literal["none", "fixed", "estimated"], ...] = Field(
        (), description="Other modes to fit beside the primary one"
    )
    flow_l_per_min: NonNegative = Field(
        0.0, description="Flushing flow: the fixed value, or the first starting point"
    )
    minimum_l_per_min: NonNegative = Field(0.0, description="Lower bound where estimated")
    maximum_l_per_min: NonNegative = Field(20.0, description="Upper bound where estimated")

    @model_validator(mode="after")
    def _consistent(self) -> FlushingTable:
        if not self.minimum_l_per_min <= self.flow_l_per_min <= self.maximum_l_per_min:
            raise ValueError("expected minimum_l_per_min <= flow_l_per_min <= maximum_l_per_min")
        if len({self.mode, *self.also}) != 1 + len(self.also):
            raise ValueError("expected each mode once among mode and also")
        return self

    @property
    def modes(self) -> tuple[str, ...]:
        """All modes to fit, the primary one first."""
        return (self.mode, *self.also)

    def path(self, mode: str) -> Constant:
        """The flushing of one mode as a constant path."""
        flow = 0.0 if mode == "none" else self.flow_l_per_min
        limits = (flow, flow)
        if mode == "estimated":
            limits = (self.minimum_l_per_min, self.maximum_l_per_min)
        return Constant(
            FLUSHING_PATH,
            Parameter(FLUSHING_PARAMETER, "l_per_min", flow, *limits, fixed=mode != "estimated"),
        )


class MotorFile(Section):
    """`motors/<motor_id>.toml`."""

    motor_id: MotorId = Field(description="Unique name; the file has the same")
    motor_type: str = Field(description="One of the motor types")
    oil: str = Field(description="One of the oils; changes are dated in `events`")
    oil_circuit: str = Field("", description="Motors with the same name share tank and pump")
    logs: Logs = Field(description="The log files")
    channels: dict[ChannelName, Channel] = Field(description="Where each channel stands in the log")
    flushing: FlushingTable = Field(
        default_factory=lambda: FlushingTable(), description="Flow added before the sensor"
    )
    events: tuple[Event, ...] = Field((), description="Dated events; they start a new baseline")
    override: dict[str, Any] = Field(
        default_factory=dict, description="Any section of the fleet file, for this motor alone"
    )

    @model_validator(mode="after")
    def _complete(self) -> MotorFile:
        refuse("motor", channel_faults({name: part.unit for name, part in self.channels.items()}))
        return self

    def oil_on(self, night: dt.date) -> str:
        """Name of the oil that the motor runs on in a night."""
        changes = [event for event in self.events if event.oil and event.date <= night]
        return max(changes, key=lambda event: event.date).oil or self.oil if changes else self.oil

    def log_source(self) -> LogSource:
        """What the reader is told."""
        channels = tuple(
            ChannelSource(
                channel=name,
                source=self.channels[name].source,
                unit=self.channels[name].unit,
                field=self.channels[name].field,
                scale=self.channels[name].scale,
                offset=self.channels[name].offset,
            )
            for name in CHANNELS
            if name in self.channels
        )
        return self.logs.source(channels)


def channel_faults(units: Mapping[str, object]) -> Iterator[tuple[Place, str, object]]:
    """What is wrong with a motor's channels as a whole, whatever is wrong within each.

    Parameters
    ----------
    units
        Unit by channel, as they stand in the file.
    """
    names = set(units)
    given = ", ".join(sorted(names))
    ports = {"high_port_pressure", "low_port_pressure"}
    has_ports = ports <= names
    if has_ports == ("pressure_difference" in names) or (not has_ports and ports & names):
        message = "expected pressure_difference, or high_port_pressure and low_port_pressure"
        yield ("channels",), message, given
    absent = {"oil_temperature", "speed", "leakage_flow"} - names
    if absent:
        yield ("channels",), f"expected also {', '.join(sorted(absent))}", given
    for name, unit in units.items():
        known = UNITS[QUANTITIES[name]] if name in QUANTITIES else {}
        if known and isinstance(unit, str) and unit not in known:
            yield ("channels", name, "unit"), f"expected one of {', '.join(known)}", unit

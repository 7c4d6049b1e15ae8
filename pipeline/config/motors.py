"""A motor's file: what it is, where its logs lie and how to read them, what happened to it."""

from __future__ import annotations

import codecs
import datetime as dt
from collections.abc import Iterator, Mapping
from itertools import chain, pairwise
from typing import Annotated, Any, Final, Literal

from pydantic import AwareDatetime, Field, field_validator, model_validator

from leakage import Constant, Parameter
from leakage.physics.paths import FLUSHING_PARAMETER, FLUSHING_PATH
from pipeline.config.databases import Database
from pipeline.config.faults import Place, refuse
from pipeline.config.field_paths import field_path
from pipeline.config.oil_samples import OilSample, order_faults
from pipeline.config.readers import reader_entry
from pipeline.config.settings import NonNegative, Positive, Section, known_zone
from pipeline.config.time_formats import require_time_format
from pipeline.units import QUANTITIES, UNITS

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
    "running_hours",
    "kinematic_viscosity",
    "dynamic_viscosity",
]

LogLayout = Literal["wide", "long", "file_per_channel"]
# Cells of a CSV that mean "no sample". `NaN` does not: it is a reading that is not finite.
MISSING_TOKENS = ("", "-", "--", "---", "null", "NULL", "NA", "N/A", "n/a", "#N/A", "Bad", "BAD")
# Marks that may stand between groups of three digits.
THOUSANDS = (".", ",", "'", "’", " ", "\u00a0", "\u202f", "_")
QualityValue = str | int | float | bool
# What historians write beside a good sample: the word, or OPC DA's code without any remark. 0 is
# good in OPC UA and bad in OPC DA, so whoever has it says which it is.
GOOD_QUALITY: tuple[QualityValue, ...] = ("Good", 192)
# Unit of a drain flow that is logged as counts of a volume.
COUNT = "count"
COUNTED: Final = "leakage_flow"
# Keys of a channel that is not logged.
OF_A_CONSTANT = {"constant", "unit", "offset_tolerance", "gain_tolerance_percent"}
# Channels that differ from sample to sample, or say nothing.
NEVER_CONSTANT = (COUNTED, "running_hours")
# Files into which the nights of a database are written.
LANDED = ("*.parquet",)
# Bytes of a pattern of logs; S3 takes no longer names, and most systems 255 bytes a part.
LONGEST_PATTERN, LONGEST_NAME = 1024, 255
FALLBACK_VALID_RANGE: dict[str, tuple[float, float]] = {
    "pressure_difference": (-450.0, 450.0),
    "high_port_pressure": (-1.0, 450.0),
    "low_port_pressure": (-1.0, 450.0),
    "charge_pressure": (-1.0, 100.0),
    "case_pressure": (-1.0, 50.0),
    "oil_temperature": (-40.0, 120.0),
    "speed": (-500.0, 500.0),
    "leakage_flow": (0.0, 200.0),
    "running_hours": (0.0, 1e6),
    "kinematic_viscosity": (1.0, 5000.0),
    "dynamic_viscosity": (1.0, 5000.0),
}


class Channel(Section):
    """One channel of the log: where it stands, its unit, and what its sensor can say.

    Limits, resolution and tolerance are in the unit of the tables (bar, °C, rpm, l/min, mm2/s,
    mPa.s), whatever the log's.
    """

    source: str = Field(
        "",
        description="Column of a CSV or Parquet log (nested: its path, `a.b.c`), topic of an MCAP; "
        "in the layout `long` the channel's name, in `file_per_channel` a glob of the file's name. "
        "Needed without a `constant`",
    )
    constant: float | None = Field(
        None,
        description="In place of `source`, for what is not logged, such as the speed of a motor "
        "that always turns alike, or the case pressure: its value, in `unit`. The drain flow's "
        "time stamps are its own, and no rule of cleaning judges it",
    )
    field: str = Field(
        "value",
        min_length=1,
        description="Field in the message of an MCAP topic: a key, or a path such as "
        "`hydraulics.pressure.a`, `pressures[0].value` or, in a map, `temperatures.oil`",
    )
    value_column: str = Field(
        "",
        description="Layout `file_per_channel`: column of this channel's values, where it is "
        "another than `logs.value_column`; several channels may be columns of one file",
    )
    unit: str = Field(description="Unit in the log")
    quality_source: str = Field(
        "",
        description="Column of this channel's quality (CSV, Parquet; in the layouts `long` and "
        "`file_per_channel` of the row), or path of a field in the same message (MCAP). A sample "
        "without a good code is refused as `bad_quality` and ends the held value of an "
        "`on_change` channel. Empty: none",
    )
    quality_good: tuple[QualityValue, ...] = Field(
        GOOD_QUALITY,
        description="Codes of a good sample, as text (without regard to case), number or truth "
        "value; all others are bad, and so is a blank. OPC DA: `[192]`; OPC UA: `[0]`, which is "
        "bad in OPC DA and therefore only good if it is listed here",
    )
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
    resolution: NonNegative = Field(
        0.0,
        description="Smallest step of the sensor; where none is stated, spikes are judged by the "
        "step that the readings visibly have",
    )
    offset_tolerance: NonNegative = Field(
        0.0, description="Stated constant error of the sensor; 0: none stated"
    )
    gain_tolerance_percent: NonNegative = Field(
        0.0, description="Stated error in proportion to the reading; 0: none stated"
    )
    frozen_after_s: Positive | None = Field(
        None, description="Overrides cleaning.frozen_after_s; temperature: 900 s unless stated"
    )
    sampling: Literal["periodic", "on_change", "mean"] = Field(
        "periodic",
        description="`periodic`: readings at a fixed rate; `on_change`: samples sent on change, "
        "or kept by a historian's compression (silence is neither a gap nor a frozen sensor, and "
        "no sample is a spike); `mean`: means of a period",
    )
    longest_silence_s: Positive | None = Field(
        None,
        description="Longer silence than this is a gap in this channel; needed for `on_change`, "
        "else five sample periods unless stated",
    )
    between: Literal["interpolate", "hold"] = Field(
        "interpolate",
        description="Between two samples: `interpolate` (a compressed archive), or `hold` the "
        "first one (a value sent on change; `on_change` only). The last `on_change` sample before "
        "a night is the first of these two at its start, if silence may be that long",
    )
    mean_of_s: Positive | None = Field(
        None, description="Averaging period of a sample; needed for `mean`"
    )
    mean_stamp: Literal["begin", "middle", "end"] = Field(
        "middle", description="Place of a mean's time stamp in its period"
    )
    counts: Literal["cumulative", "pulses"] | None = Field(
        None,
        description="Drain flow only, with the unit `count`: the log holds a running total "
        "(`cumulative`), or the counts since the sample before (`pulses`)",
    )
    volume_per_count_cm3: Positive | None = Field(
        None, description="Volume of one count; 1000 for a counter of litres"
    )
    counter_rolls_over_at: Positive | None = Field(
        None,
        description="A running total begins at 0 again after this many counts; without it every "
        "fall of the total is a reset, and that sample is refused",
    )
    time_offset_s: float = Field(
        0.0,
        ge=-600.0,
        le=600.0,
        description="Added to the channel's time stamps, to correct its clock",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Channel:
        refuse("channel", chain(_place_faults(self), _sampling_faults(self), _quality_faults(self)))
        return self

    @field_validator("field")
    @classmethod
    def _path(cls, field: str) -> str:
        field_path(field)
        return field

    @field_validator("quality_good", mode="before")
    @classmethod
    def _words(cls, good: object) -> object:
        words = tuple(good) if isinstance(good, list | tuple) else ()
        if not words or not all(isinstance(word, str | int | float) for word in words):
            raise ValueError("expected a list of at least one text, number, true or false")
        return words

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


Channels = Mapping[ChannelName, Channel]


def _place_faults(channel: Channel) -> Iterator[tuple[Place, str, object]]:
    """Neither a source nor a constant, or a constant with keys of what is logged."""
    if channel.constant is None:
        if not channel.source:
            yield ("source",), "is missing: the place in the log, or else a constant", None
        return
    for key in sorted(channel.model_fields_set - OF_A_CONSTANT):
        yield (key,), "expected no such key beside a constant", getattr(channel, key)


def _quality_faults(channel: Channel) -> Iterator[tuple[Place, str, object]]:
    if "quality_good" in channel.model_fields_set and not channel.quality_source:
        yield ("quality_good",), "expected quality_source beside it", channel.quality_good


def _sampling_faults(channel: Channel) -> Iterator[tuple[Place, str, object]]:
    """Keys of a channel's sampling that do not go together."""
    if (channel.longest_silence_s is None) and channel.sampling == "on_change":
        yield ("longest_silence_s",), 'expected a time, as sampling = "on_change" needs it', None
    if channel.between == "hold" and channel.sampling != "on_change":
        yield ("between",), 'expected sampling = "on_change" beside it', channel.between
    if (channel.mean_of_s is None) == (channel.sampling == "mean"):
        message = 'expected together with sampling = "mean", and only then'
        yield ("mean_of_s",), message, channel.mean_of_s
    if (channel.counts is None) == (channel.unit == COUNT):
        yield ("counts",), f'expected together with unit = "{COUNT}"', channel.counts
    if (channel.counts is None) != (channel.volume_per_count_cm3 is None):
        message = "expected together with counts, and only then"
        yield ("volume_per_count_cm3",), message, channel.volume_per_count_cm3
    if channel.counts is not None and channel.sampling == "mean":
        yield ("counts",), 'expected no sampling = "mean" beside it', channel.counts
    if channel.counter_rolls_over_at is not None and channel.counts != "cumulative":
        message = 'expected counts = "cumulative" beside it'
        yield ("counter_rolls_over_at",), message, channel.counter_rolls_over_at


class Logs(Section):
    """The motor's log files and their dialect, or the database that has its samples."""

    format: str = Field(
        description="`csv`, `parquet`, `mcap`, `sql` (a database), or a format that an installed "
        "package reads ([readers](readers.md))"
    )
    options: dict[str, Any] = Field(
        default_factory=dict, description="Options of an installed package's reader"
    )
    files: tuple[str, ...] = Field(
        (),
        description="Paths or globs below the log root; a path named and absent is an error. "
        "Needed without a `database`",
    )
    database: Database | None = Field(None, description="With `sql`: where the samples are")
    time: str = Field(
        "time", description="Column of the time; MCAP: `log_time` or `publish_time` of the message"
    )
    time_format: str = Field(
        "iso8601",
        description="`iso8601`, `epoch_s`, `epoch_ms`, `epoch_us`, `epoch_ns`, `excel_days` or a "
        "strptime format",
    )
    time_zone: str = Field("UTC", description="Zone of time stamps that state none")
    date_column: str = Field(
        "", description="Column of the date, where the time has one of its own; read as `date time`"
    )
    layout: LogLayout = Field(
        "wide",
        description="CSV, Parquet: one column per channel, one row per sample with the channel's "
        "name, or one file per channel",
    )
    channel_column: str = Field("channel", description="Layout `long`: column of channels' names")
    motor_column: str = Field(
        "", description="CSV, Parquet: column of the motor's name, where rows are of several"
    )
    motor_name: str = Field("", description="The motor's name in `motor_column`")
    value_column: str = Field(
        "value", description="Layouts `long` and `file_per_channel`: column of the values"
    )
    separator: str = Field(",", min_length=1, max_length=1, description="CSV: between cells")
    decimal: Literal[".", ","] = Field(".", description="CSV: decimal mark")
    thousands: str = Field("", description="CSV: mark between groups of three digits")
    encoding: str = Field("utf-8", description="CSV: text encoding")
    skip_rows: int = Field(0, ge=0, description="CSV: lines before the header")
    unit_rows: int = Field(0, ge=0, description="CSV: lines after the header that hold no samples")
    missing_tokens: tuple[str, ...] = Field(
        MISSING_TOKENS, description="CSV: content of a cell without a value"
    )
    settle_s: NonNegative = Field(
        0.0,
        description="A new file that was written to within this time before a run is left to a "
        "later run. Without it, only a file that changes during reading is",
    )
    stamp: str = Field(
        "",
        description="MCAP: path of a time stamp within the message, such as `header.stamp`, to use "
        "instead of its log time; a number or text there is in `time_format`",
    )
    salvage: bool = Field(
        False,
        description="MCAP: read the part of a truncated or damaged file before the damage, "
        "instead of refusing the file; the loss is noted",
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

    @field_validator("format")
    @classmethod
    def _readable(cls, name: str) -> str:
        reader_entry(name)
        return name

    @field_validator("time_zone")
    @classmethod
    def _known_zone(cls, name: str) -> str:
        return known_zone(name)

    @field_validator("time_format")
    @classmethod
    def _known_format(cls, time_format: str) -> str:
        require_time_format(time_format)
        return time_format

    @field_validator("encoding")
    @classmethod
    def _known_encoding(cls, encoding: str) -> str:
        try:
            codecs.getincrementaldecoder(encoding)()
            " ".encode(encoding)  # an empty text asks no codec
        except (LookupError, ValueError):
            raise ValueError("expected a text encoding, such as utf-8 or cp1252") from None
        return encoding

    @field_validator("stamp")
    @classmethod
    def _path(cls, stamp: str) -> str:
        if stamp:
            field_path(stamp)
        return stamp

    @model_validator(mode="after")
    def _marks_apart(self) -> Logs:
        refuse("logs", chain(_mark_faults(self), _source_faults(self)))
        if bool(self.motor_column) != bool(self.motor_name):
            message = "expected motor_column and motor_name together"
            refuse("logs", [(("motor_name",), message, self.motor_name)])
        return self


def _source_faults(logs: Logs) -> Iterator[tuple[Place, str, object]]:
    """Files and a database where the format has the other."""
    is_sql = logs.format == "sql"
    if is_sql != (logs.database is not None):
        yield ("database",), 'expected together with format = "sql", and only then', None
    if is_sql == bool(logs.files):
        message = "expected at least one path or glob"
        if is_sql:
            message = 'expected no files with format = "sql"'
        yield ("files",), message, logs.files
    if is_sql and logs.layout == "file_per_channel":
        yield ("layout",), 'expected "wide" or "long" with format = "sql"', logs.layout


def _mark_faults(logs: Logs) -> Iterator[tuple[Place, str, object]]:
    """Marks of a CSV that cannot stand beside one another."""
    if not logs.separator.isascii() or logs.separator in '"\r\n':
        yield (
            ("separator",),
            "expected a character of ASCII that is no quotation mark",
            logs.separator,
        )
    if logs.separator == logs.decimal:
        yield ("separator",), "expected another mark than the decimal mark", logs.separator
    if logs.thousands and logs.thousands not in THOUSANDS:
        message = f"expected one of {', '.join(map(repr, THOUSANDS))}"
        yield ("thousands",), message, logs.thousands
    if logs.thousands and logs.thousands in (logs.decimal, logs.separator):
        message = "expected another mark than the decimal mark and the separator"
        yield ("thousands",), message, logs.thousands


def _fault_of_pattern(pattern: str) -> str | None:
    """Fault of a path or glob of logs; None without one."""
    parts = pattern.replace("\\", "/").split("/")
    if pattern.startswith(("/", "\\")) or ".." in parts:
        return "expected a path below the log root, without '..'"
    if not pattern.isprintable() or not parts[-1].strip(". "):
        return "expected the name of a file, or a glob"
    longest = max(len(part.encode()) for part in parts)
    if longest > LONGEST_NAME or len(pattern.encode()) > LONGEST_PATTERN:
        return f"expected names of at most {LONGEST_NAME} bytes, {LONGEST_PATTERN} together"
    if parts[-1] == "**" or any("**" in part and part != "**" for part in parts):
        return "expected ** only as a folder of its own, with a file's name or glob behind it"
    return None


class Event(Section):
    """Something that starts a new baseline."""

    date: dt.date = Field(description="First night's label from which it holds")
    kind: Literal["overhaul", "oil_change", "flushing_change", "motor_exchanged"] = Field(
        description="Kind of event"
    )
    oil: str | None = Field(
        None, description="The new oil, where it changed; needed for `oil_change`"
    )
    note: str = Field("", description="In words")

    @model_validator(mode="after")
    def _names_its_oil(self) -> Event:
        if self.kind == "oil_change" and self.oil is None:
            message = 'expected the oil\'s name, as kind = "oil_change" needs it'
            refuse("event", [(("oil",), f"{message}: the old one if it is of the same kind", None)])
        return self


class Periods(Section):
    """Times to fit and to validate on, chosen by hand.

    A night that one of them touches uses only these; all others are split by the rules.
    """

    training: tuple[tuple[AwareDatetime, AwareDatetime], ...] = Field(
        (), description="Periods to fit, each [from, to), with their offset from UTC"
    )
    validation: tuple[tuple[AwareDatetime, AwareDatetime], ...] = Field(
        (), description="Periods to validate on, each [from, to), with their offset from UTC"
    )

    @model_validator(mode="after")
    def _apart(self) -> Periods:
        periods = sorted((*self.training, *self.validation))
        if any(begin >= end for begin, end in periods):
            raise ValueError("expected each period as [from, to], the later time second")
        if any(one[1] > other[0] for one, other in pairwise(periods)):
            raise ValueError("expected periods that do not overlap")
        return self


class FlushingTable(Section):
    """Flushing of the motor: the flow that is added on the way to the sensor."""

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
    name_in_log: str = Field(
        "",
        exclude=True,
        description="The motor's name as the log writes it, for `[defaults]`; empty: `motor_id`",
    )
    oil: str = Field(description="One of the oils; changes are dated in `events`")
    oil_circuit: str = Field("", description="Motors with the same name share tank and pump")
    logs: Logs = Field(description="The log files")
    channels: dict[ChannelName, Channel] = Field(description="Where each channel stands in the log")
    flushing: FlushingTable = Field(
        default_factory=lambda: FlushingTable(), description="Flow added before the sensor"
    )
    periods: Periods = Field(
        default_factory=lambda: Periods(), description="Training and validation set by hand"
    )
    events: tuple[Event, ...] = Field((), description="Dated events; they start a new baseline")
    oil_samples: tuple[OilSample, ...] = Field(
        (),
        description="Analyses of the oil, by date; those of a shared oil are in its circuit's file",
    )
    override: dict[str, Any] = Field(
        default_factory=dict, description="Any section of the fleet file, for this motor alone"
    )

    @model_validator(mode="after")
    def _complete(self) -> MotorFile:
        refuse("motor", channel_faults({name: part.unit for name, part in self.channels.items()}))
        refuse("motor", _constant_faults(self.channels))
        if self.logs.format == "mcap":
            refuse("motor", _quality_paths(self.channels))
        refuse("motor", order_faults(self.oil_samples))
        return self

    def oil_on(self, night: dt.date) -> str:
        """Name of the oil that the motor runs on in a night."""
        change = self._filling(night)
        return self.oil if change is None else change.oil or self.oil

    def filled_on(self, night: dt.date) -> dt.date | None:
        """Date on which the oil of a night was filled in; None where no event tells it."""
        change = self._filling(night)
        return None if change is None else change.date

    def _filling(self, night: dt.date) -> Event | None:
        changes = [event for event in self.events if event.oil and event.date <= night]
        return max(changes, key=lambda event: event.date, default=None)


def _constant_faults(channels: Channels) -> Iterator[tuple[Place, str, object]]:
    """Constants of channels that have to be measured."""
    for name, channel in channels.items():
        if channel.constant is not None and name in NEVER_CONSTANT:
            yield ("channels", name, "constant"), "expected a source", channel.constant


def _quality_paths(channels: Mapping[ChannelName, Channel]) -> Iterator[tuple[Place, str, object]]:
    """Paths of qualities that lead to no field of an MCAP message."""
    for name, channel in channels.items():
        try:
            field_path(channel.quality_source or "none")
        except ValueError as error:
            yield ("channels", name, "quality_source"), str(error), channel.quality_source


def channel_faults(units: Mapping[str, object]) -> Iterator[tuple[Place, str, object]]:
    """Faults of a motor's channels as a whole, besides those within each."""
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
    if {"kinematic_viscosity", "dynamic_viscosity"} <= names:
        yield ("channels",), "expected kinematic_viscosity or dynamic_viscosity, not both", given
    for name, unit in units.items():
        known = UNITS[QUANTITIES[name]] if name in QUANTITIES else {}
        if name == COUNTED and unit == COUNT:
            continue
        if known and isinstance(unit, str) and unit not in known:
            yield ("channels", name, "unit"), f"expected one of {', '.join(known)}", unit

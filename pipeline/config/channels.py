"""Channels of a motor's log: `[channels.<name>]` of its file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field, field_validator

from pipeline.config.faults import Misfit
from pipeline.config.field_paths import FieldText
from pipeline.config.section import NonNegative, Positive, Section, Stage
from pipeline.units import QUANTITIES, UNITS

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


def _factor(scale: float) -> float:
    if scale == 0.0:
        raise ValueError("expected a factor other than 0")
    return scale


def _limits(limits: tuple[float, float]) -> tuple[float, float]:
    if not limits[0] < limits[1]:
        raise ValueError("expected [lowest, highest]")
    return limits


Factor = Annotated[float, AfterValidator(_factor)]
Limits = Annotated[tuple[float, float], AfterValidator(_limits)]


class Channel(Section):
    """One channel of the log: where it stands, its unit, and what its sensor can say.

    Limits, resolution and tolerance are in the unit of the tables (bar, °C, rpm, l/min, mm2/s,
    mPa.s), whatever the log's.
    """

    shapes = Stage.READING | Stage.BLOCKS

    source: Annotated[str, Stage.READING] = ""
    """Column of a CSV or Parquet log (nested: its path, `a.b.c`), topic of an MCAP; in the layout
    `long` the channel's name, in `file_per_channel` a glob of the file's name. Needed without a
    `constant`."""
    constant: float | None = None
    """In place of `source`, for what is not logged, such as the speed of a motor that always turns
    alike, or the case pressure: its value, in `unit`. The drain flow's time stamps are its own, and
    no rule of cleaning judges it."""
    field: Annotated[FieldText, Stage.READING] = Field("value", min_length=1)
    """Field in the message of an MCAP topic: a key, or a path such as `hydraulics.pressure.a`,
    `pressures[0].value` or, in a map, `temperatures.oil`."""
    value_column: Annotated[str, Stage.READING] = ""
    """Layout `file_per_channel`: column of this channel's values, where it is another than
    `logs.value_column`; several channels may be columns of one file."""
    unit: str
    """Unit in the log."""
    quality_source: str = ""
    """Column of this channel's quality (CSV, Parquet; in the layouts `long` and `file_per_channel`
    of the row), or path of a field in the same message (MCAP). A sample without a good code is
    refused as `bad_quality` and ends the held value of an `on_change` channel. Empty: none."""
    quality_good: tuple[QualityValue, ...] = GOOD_QUALITY
    """Codes of a good sample, as text (without regard to case), number or truth value; all others
    are bad, and so is a blank. OPC DA: `[192]`; OPC UA: `[0]`, which is bad in OPC DA and therefore
    only good if it is listed here."""
    scale: Factor = 1.0
    """Factor on the logged number, before the unit."""
    offset: float = 0.0
    """Added to the scaled number, in the log's unit."""
    valid_range: Limits | None = None
    """Values outside are refused; without it the channel's usual range."""
    sensor_maximum: Positive | None = None
    """Highest value that the sensor gives; for the drain flow also what it gives under
    back-flow."""
    resolution: NonNegative = 0.0
    """Smallest step of the sensor; where none is stated, spikes are judged by the step that the
    readings visibly have."""
    offset_tolerance: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Stated constant error of the sensor; 0: none stated."""
    gain_tolerance_percent: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Stated error in proportion to the reading; 0: none stated."""
    frozen_after_s: Positive | None = None
    """Overrides cleaning.frozen_after_s; temperature: 900 s unless stated."""
    sampling: Literal["periodic", "on_change", "mean"] = "periodic"
    """`periodic`: readings at a fixed rate; `on_change`: samples sent on change, or kept by a
    historian's compression (silence is neither a gap nor a frozen sensor, and no sample is a
    spike); `mean`: means of a period."""
    longest_silence_s: Positive | None = Field(None, le=31_536_000.0)
    """Longer silence than this is a gap in this channel; needed for `on_change`, else five sample
    periods unless stated."""
    between: Literal["interpolate", "hold"] = "interpolate"
    """Between two samples: `interpolate` (a compressed archive), or `hold` the first one (a value
    sent on change; `on_change` only). The last `on_change` sample before a night is the first of
    these two at its start, if silence may be that long."""
    mean_of_s: Positive | None = None
    """Averaging period of a sample; needed for `mean`."""
    mean_stamp: Literal["begin", "middle", "end"] = "middle"
    """Place of a mean's time stamp in its period."""
    counts: Literal["cumulative", "pulses"] | None = None
    """Drain flow only, with the unit `count`: the log holds a running total (`cumulative`), or the
    counts since the sample before (`pulses`)."""
    volume_per_count_cm3: Positive | None = None
    """Volume of one count; 1000 for a counter of litres."""
    counter_rolls_over_at: Positive | None = None
    """A running total begins at 0 again after this many counts; without it every fall of the total
    is a reset, and that sample is refused."""
    time_offset_s: float = Field(0.0, ge=-600.0, le=600.0)
    """Added to the channel's time stamps, to correct its clock."""

    @field_validator("quality_good", mode="before")
    @classmethod
    def _words(cls, good: object) -> object:
        words = tuple(good) if isinstance(good, list | tuple) else ()
        if not words or not all(isinstance(word, str | int | float) for word in words):
            raise ValueError("expected a list of at least one text, number, true or false")
        return words

    def misfits(self) -> Iterator[Misfit]:
        """Keys that do not go together."""
        if self.constant is None and not self.source:
            yield ("source",), "is missing: the place in the log, or else a constant", None
        beside = sorted(self.model_fields_set - OF_A_CONSTANT)
        for key in beside if self.constant is not None else ():
            yield (key,), "expected no such key beside a constant", getattr(self, key)
        if "quality_good" in self.model_fields_set and not self.quality_source:
            yield ("quality_good",), "expected quality_source beside it", self.quality_good
        if self.sensor_maximum and self.valid_range and self.sensor_maximum <= self.valid_range[0]:
            message = "expected more than the lower end of valid_range"
            yield ("sensor_maximum",), message, self.sensor_maximum
        if self.longest_silence_s is None and self.sampling == "on_change":
            yield ("longest_silence_s",), 'expected a time for sampling = "on_change"', None
        if self.between == "hold" and self.sampling != "on_change":
            yield ("between",), 'expected sampling = "on_change" beside it', self.between
        if (self.mean_of_s is None) == (self.sampling == "mean"):
            message = 'expected together with sampling = "mean", and only then'
            yield ("mean_of_s",), message, self.mean_of_s
        yield from self._misfits_of_counts()

    def _misfits_of_counts(self) -> Iterator[Misfit]:
        if (self.counts is None) == (self.unit == COUNT):
            yield ("counts",), f'expected together with unit = "{COUNT}"', self.counts
        if (self.counts is None) != (self.volume_per_count_cm3 is None):
            message = "expected together with counts, and only then"
            yield ("volume_per_count_cm3",), message, self.volume_per_count_cm3
        if self.counts is not None and self.sampling == "mean":
            yield ("counts",), 'expected no sampling = "mean" beside it', self.counts
        if self.counter_rolls_over_at is not None and self.counts != "cumulative":
            message = 'expected counts = "cumulative" beside it'
            yield ("counter_rolls_over_at",), message, self.counter_rolls_over_at


Channels = Mapping[ChannelName, Channel]


def channel_faults(units: Mapping[str, object]) -> Iterator[Misfit]:
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

"""Channels of a motor's log: `[channels.<name>]` of its file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Final, Literal

from pydantic import AwareDatetime, Field, field_validator

from pipeline.config.section import Misfit, NonNegative, Positive, Section, Stage

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
# Units of a drain flow that is logged as counts of a volume: a running total, or the counts since
# the sample before.
TOTAL, PULSES = "count", "pulses"
COUNTED: Final = "leakage_flow"
# The two of which the pressure difference is taken where it has no channel of its own.
PORT_PRESSURES: Final = ("high_port_pressure", "low_port_pressure")
# Keys of a channel that is not logged.
OF_A_CONSTANT = {"constant", "unit", "offset_tolerance", "gain_tolerance_percent"}
# Channels that differ from sample to sample, or say nothing.
NEVER_CONSTANT = (COUNTED, "running_hours")


class Channel(Section):
    """A channel of the log.

    Limits, resolution and tolerance are in the unit of the tables (bar, °C, rpm, l/min, mm2/s,
    mPa.s), whatever the log's.
    """

    shapes = Stage.READING | Stage.BLOCKS

    source: Annotated[str, Stage.READING] = ""
    """Column, topic (MCAP), the channel's name (`long`), or a glob of the file's name
    (`file_per_channel`)."""
    constant: float | None = None
    """Value in place of `source`, where not logged."""
    field: Annotated[str, Stage.READING] = ""
    """Field of the message (MCAP), such as `pressures[0].value`, or column of its file
    (`file_per_channel`), where not `logs.value_column`."""
    unit: str
    """Unit in the log; where it was changed, the newest. Drain flow: also `count`, a running total,
    or `pulses`, counts of a sample."""
    earlier_units: tuple[tuple[str, AwareDatetime], ...] = ()
    """Units before, oldest first, each with the first time of the next: `["l/min", TIME]`."""
    quality_source: str = ""
    """Column, or field of the message (MCAP), of the channel's quality."""
    quality_good: tuple[QualityValue, ...] = GOOD_QUALITY
    """Codes of a good sample. OPC DA: `[192]`; OPC UA: `[0]`."""
    scale: float = 1.0
    """Factor on the logged number."""
    offset: float = 0.0
    """Added to the scaled number."""
    valid_range: tuple[float, float] | None = None
    """Values outside are refused; by default the usual range."""
    sensor_maximum: Positive | None = None
    """Highest value that the sensor gives."""
    resolution: NonNegative = 0.0
    """Smallest step of the sensor."""
    offset_tolerance: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Constant error of the sensor."""
    gain_tolerance_percent: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Error in proportion to the reading."""
    frozen_after_s: Positive | None = None
    """Time without a change after which a sensor is frozen; by default 60 s, temperature 900 s."""
    sampling: Literal["periodic", "on_change", "mean"] = "periodic"
    """Fixed rate (`periodic`), sent on change (`on_change`), means of a period (`mean`)."""
    longest_silence_s: Positive | None = Field(None, le=31_536_000.0)
    """Silence that is a gap; required for `on_change`."""
    between: Literal["interpolate", "hold"] = "interpolate"
    """`on_change`: values on the line between two samples, as a compressing archive means them, or
    the last one (`hold`)."""
    mean_of_s: Positive | None = None
    """Averaging period of a sample; needed for `mean`."""
    volume_per_count_cm3: Positive | None = None
    """`count`, `pulses`: volume of each; 1000 for a counter of litres."""
    time_offset_s: float = Field(0.0, ge=-600.0, le=600.0)
    """Added to the channel's time stamps; minus half of `mean_of_s` where a mean is stamped at the
    end of its period."""

    @field_validator("quality_good", mode="before")
    @classmethod
    def _words(cls, good: object) -> object:
        words = tuple(good) if isinstance(good, list | tuple) else ()
        if not words or not all(isinstance(word, str | int | float) for word in words):
            raise ValueError("expected a list of at least one text, number, true or false")
        return words

    def misfits(self) -> Iterator[Misfit]:
        given, (lowest, highest) = self.model_fields_set, self.valid_range or (None, None)
        if self.constant is None and not self.source:
            yield ("source",), "is missing: the place in the log, or else a constant", None
        for key in sorted(given - OF_A_CONSTANT) if self.constant is not None else ():
            yield self.at(key, "expected no such key beside a constant")
        if self.scale == 0.0:
            yield self.at("scale", "expected a factor other than 0")
        if lowest is not None and highest is not None and lowest >= highest:
            yield self.at("valid_range", "expected [lowest, highest]")
        if "quality_good" in given and not self.quality_source:
            yield self.at("quality_good", "expected quality_source beside it")
        if self.sensor_maximum and lowest is not None and self.sensor_maximum <= lowest:
            yield self.at("sensor_maximum", "expected more than the lower end of valid_range")
        if self.is_on_change and self.longest_silence_s is None:
            yield self.at("longest_silence_s", 'expected a time for sampling = "on_change"')
        if self.between == "hold" and not self.is_on_change:
            yield self.at("between", 'expected sampling = "on_change" beside it')
        if (self.sampling == "mean") == (self.mean_of_s is None):
            yield self.at("mean_of_s", 'expected together with sampling = "mean", and only then')
        yield from self._misfits_of_units()

    def _misfits_of_units(self) -> Iterator[Misfit]:
        ends = [end for _, end in self.earlier_units]
        if any(end >= later for end, later in pairwise(ends)):
            yield self.at("earlier_units", "expected the oldest first, each with a later time")
        if self.is_counted == (self.volume_per_count_cm3 is None):
            message = f'expected together with unit = "{TOTAL}" or "{PULSES}", and only then'
            yield self.at("volume_per_count_cm3", message)
        if self.is_counted and self.earlier_units:
            yield self.at("earlier_units", "expected none beside counts")
        if self.is_counted and self.sampling == "mean":
            yield self.at("unit", 'expected no counts beside sampling = "mean"')

    @property
    def is_counted(self) -> bool:
        """True if the log has counts of a volume."""
        return self.unit in (TOTAL, PULSES)

    @property
    def is_on_change(self) -> bool:
        """True if silence says that the value has not changed, or lies on a line."""
        return self.sampling == "on_change"

    @property
    def units(self) -> tuple[str, ...]:
        """All units in which the log has the channel, the newest first."""
        return (self.unit, *(unit for unit, _ in reversed(self.earlier_units)))


Channels = Mapping[ChannelName, Channel]

"""Settings from raw samples to blocks: nights, time base, cleaning, delay, smoothing, windows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal
from zoneinfo import ZoneInfo

from pydantic import Field

from pipeline.config.faults import Misfit
from pipeline.config.section import NonNegative, Positive, Seconds, Section, Share, Stage, TimeZone

Rate = Annotated[float, Field(gt=0, le=1000)]
InputName = Literal["pressure_difference", "oil_temperature", "speed"]


class Nights(Section):
    """A night is [end hour, next end hour) in local time, labelled by the date on which it ends."""

    shapes = Stage.READING | Stage.BLOCKS

    time_zone: TimeZone = "UTC"
    """IANA time zone of the fleet, such as Europe/Oslo."""
    end_hour: int = Field(6, ge=0, le=23)
    """Local hour at which a night ends."""

    @property
    def zone(self) -> ZoneInfo:
        """The time zone itself."""
        return ZoneInfo(self.time_zone)


class TimeBase(Section):
    """The one grid of time on which all channels of a motor's night are brought together."""

    shapes = Stage.BLOCKS

    rate_hz: Rate | None = None
    """Samples a second; without it the rate of the fastest channel."""
    maximum_rate_hz: Rate = 10.0
    """Upper limit of the rate where not stated."""


class Cleaning(Section):
    """Rules that refuse samples. The table `quality` counts each refusal."""

    shapes = Stage.BLOCKS

    standstill_rpm: NonNegative = 0.5
    """Below this |speed| the motor stands still."""
    guard_before_s: Seconds = 10.0
    """Time refused before a standstill or a back-flow."""
    guard_after_s: Seconds = 30.0
    """Time refused after a standstill or a back-flow."""
    hampel_window: int = Field(11, ge=3, le=1001)
    """Samples in the Hampel filter's centred window; odd."""
    hampel_threshold: Positive = 5.0
    """A spike is further from the local median than this many scaled MAD."""
    frozen_after_s: Positive = 60.0
    """A sensor is frozen after this time without a change beyond its resolution."""
    gap_sample_periods: Positive = 5.0
    """Longer silence than this many sample periods is a gap."""
    temperature_gap_s: Positive = 5.0
    """Longer silence than this is a gap in the oil temperature."""
    maximum_mean_s: Positive = 10.0
    """A channel logged as means of a longer period than this makes the night fail with
    `means_too_long`."""
    out_of_order: Literal["sort", "refuse"] = "sort"
    """Samples behind the log's own time: `sort` puts those back whose place is free, within five
    sample periods of others, and refuses the rest; `refuse`: all of them."""
    refuse_transients: bool = False
    """Refuse fast changes of speed or pressure."""
    transient_speed_rpm_per_s: Positive = 5.0
    """Speed changes faster than this are transients."""
    transient_pressure_bar_per_s: Positive = 50.0
    """Pressure changes faster than this are transients."""

    def misfits(self) -> Iterator[Misfit]:
        """A window without a middle."""
        if self.hampel_window % 2 == 0:
            yield ("hampel_window",), "expected an odd number of samples", self.hampel_window


class TransportDelay(Section):
    """Time between the motor and the sensors of its drain line, equation (14)."""

    shapes = Stage.BLOCKS

    mode: Literal["off", "fixed", "flow"] = "off"
    """`fixed`: always the same; `flow`: the line's volume over the drain flow. Either reports an
    estimate beside it; with `fixed` and 0 s it changes nothing else."""
    fixed_s: Seconds = 0.0
    """`fixed`: the delay."""
    line_length_m: Positive | None = None
    """`flow`: length of the drain line from the motor to the sensor."""
    line_inner_diameter_mm: Positive | None = None
    """`flow`: inner diameter of the drain line."""
    flow_average_s: Seconds = 10.0
    """`flow`: averaging time of the drain flow that gives the delay."""
    maximum_s: Positive = 60.0
    """A sample with a longer delay is refused; longest delay estimated."""
    leading: tuple[InputName, ...] = ()
    """Inputs that the drain flow follows late: it is paired with them at t − τ (the thesis; a line
    that is not full)."""
    lagging: tuple[InputName, ...] = ()
    """Inputs measured in the drain line, at the flow sensor: the flow is paired with them at t + τ
    (oil temperature in a full line)."""

    def misfits(self) -> Iterator[Misfit]:
        """Inputs named twice or not at all; a mode without what it needs."""
        named = (*self.leading, *self.lagging)
        if len(set(named)) < len(named):
            yield (), "expected each input once among leading and lagging", None
        if self.mode != "off" and not named:
            yield (), "expected an input in leading or in lagging", None
        if self.mode == "flow" and None in (self.line_length_m, self.line_inner_diameter_mm):
            yield (), "expected line_length_m and line_inner_diameter_mm beside mode", None
        if self.mode == "fixed" and self.fixed_s > self.maximum_s:
            yield ("fixed_s",), "expected no more than maximum_s", self.fixed_s


class Smoothing(Section):
    """Moving average of the drain flow, and of its regressors with it (model.md, section 4)."""

    shapes = Stage.BLOCKS

    window_s: Seconds = 0.0
    """Length of the centred average; 0: none."""
    apply_to: Literal["all", "leakage"] = "all"
    """`all`: the same filter on regressors and drain flow, which leaves the loss factors unbiased;
    `leakage`: on the drain flow alone, as the thesis does."""


class Windows(Section):
    """Blocks of a night, and how they are split into training and validation."""

    shapes = Stage.BLOCKS

    block_s: float = Field(120.0, ge=1, le=86_400)
    """Length of a block of statistics."""
    maximum_blocks: int = Field(96, ge=4)
    """At most this many blocks are stored a night; neighbours are merged."""
    split: Literal["chronological", "interleaved"] = "chronological"
    """`chronological`: the first blocks train, the last validate; `interleaved`: seven blocks
    train, three validate, in turn."""
    training_share: Share = Field(0.8, lt=1)
    """Share of the kept samples that trains."""
    guard_blocks: int = Field(1, ge=0)
    """Blocks left out at each border between training and validation."""
    minimum_block_share: NonNegative = Field(0.0, le=1)
    """A block that kept a smaller share of its samples is left out."""
    longest_gap_s: Positive | None = None
    """Longer gaps between kept samples cut the night into stretches; without it the night is
    one."""
    minimum_stretch_minutes: NonNegative = 0.0
    """A stretch with fewer kept samples, as time, is left out."""
    minimum_pressure_spread_bar: Annotated[NonNegative, Stage.NIGHT] = 0.0
    """Spread of |pressure difference| over the training samples, 5th to 95th percentile, that a fit
    needs."""
    minimum_speed_spread_rpm: Annotated[NonNegative, Stage.NIGHT] = 0.0
    """The same of |speed|."""
    minimum_temperature_spread_c: Annotated[NonNegative, Stage.NIGHT] = 0.0
    """The same of the oil temperature."""
    minimum_kept_share: Annotated[Share, Stage.NIGHT] = 0.6
    """Share of the running motor's samples that must be kept for a fit."""
    minimum_training_minutes: Annotated[Positive, Stage.FIGURES] = 5.0
    """Kept samples needed for training, as time."""


class SensorHealth(Section):
    """Halts that show the zero of the pressure and flow sensors; published in `operation`."""

    shapes = Stage.NIGHT

    settle_s: Seconds = 45.0
    """Time after the motor has stopped that is left out."""
    minimum_s: Positive = 20.0
    """Credible samples, as time, that a halt needs after that."""
    depressurised_below_bar: Positive = 5.0
    """|pressure difference| all the while; a halt under load shows no zero."""

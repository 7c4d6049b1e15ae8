"""A channel's samples in order, every rule applied, and what each of them refused counted.

Channels are cleaned on their own samples, before the time base: a bad temperature sample,
interpolated to 10 Hz, would spoil nineteen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Mask, Times, Values, chosen_rows
from pipeline.config import Channel
from pipeline.config.channels import TOTAL, ChannelName
from pipeline.config.logs import Logs
from pipeline.ingest import RawChannel
from pipeline.night.masks import (
    CM3_PER_US_TO_L_PER_MIN,
    ROUNDING,
    at_maximum,
    flow_from_counts,
    frozen,
    missing_sample,
    out_of_range,
    spike,
    step_of_readings,
    stretches,
)
from pipeline.night.time_order import Order, Steps, order_of
from pipeline.units import FALLBACK_VALID_RANGE

# Hampel's filter: samples in its centred window, and scaled MAD off their median that are a spike.
HAMPEL_WINDOW, HAMPEL_THRESHOLD = 11, 5.0
# Silence of more sample periods is a gap.
GAP_SAMPLE_PERIODS = 5.0
# Below this |speed| the motor stands still: the slowest work of such motors is some 1 rpm.
STANDSTILL_RPM = 0.5
# Time without a change after which a sensor is frozen; oil holds its temperature for longer.
FROZEN_AFTER_S, TEMPERATURE_FROZEN_AFTER_S = 60.0, 900.0
# Oil temperature is logged once a second or less: its silence is a gap after this time.
TEMPERATURE_GAP_S = 5.0
# Longest period of a mean that a fit can use: over longer ones conditions change too much.
MAXIMUM_MEAN_S = 10.0

Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class ChannelRules:
    """What a channel's samples are, and the rules that they are judged by."""

    valid_range: tuple[float, float]  # lowest and highest plausible value [bar, °C, rpm or l/min]
    sensor_maximum: float | None  # highest value the sensor gives, or None
    resolution: float  # smallest step of the sensor
    frozen_after_s: float  # longest credible time without a change [s]
    longest_gap_s: float | None  # longer silence is a gap; None: by the sample period
    shortest_gap_s: float = 0.0  # a gap is no shorter, however fast the samples are
    # Values smaller in magnitude never count as frozen: a halted motor's speed stays 0.
    at_rest_below: float = 0.0
    # A sample is written where the value changes: silence is no gap, and there is no period.
    on_change: bool = False
    hold: bool = False  # between two samples the first holds; else the value is interpolated
    mean_us: float = 0.0  # period of which a sample is the mean; 0: a reading
    shift_us: int = 0  # from the stamp as logged to the time at which the sample holds
    # Unit of a running total, or of counts since the sample before; None for a flow. Volume of a
    # count.
    counts: str | None = None
    volume_per_count_cm3: float = 0.0
    # A row of the log is of this channel alone, so that a row without a value says that there is
    # none; else it may only be a row of another channel.
    has_rows_of_its_own: bool = False

    @classmethod
    def of(cls, name: str, channel: Channel, logs: Logs | None = None) -> ChannelRules:
        """Return the rules of a channel: what it states, else the constants."""
        is_temperature = name == "oil_temperature"
        fallback = TEMPERATURE_FROZEN_AFTER_S if is_temperature else FROZEN_AFTER_S
        # A value that did not change was not sent: silence is no sign of a frozen sensor.
        silence_s = channel.longest_silence_s or 0.0
        fallback = max(fallback, silence_s) if channel.is_on_change else fallback
        rules = cls(
            valid_range=channel.valid_range or FALLBACK_VALID_RANGE[name],
            sensor_maximum=channel.sensor_maximum,
            resolution=channel.resolution,
            frozen_after_s=channel.frozen_after_s or fallback,
            longest_gap_s=silence_s or None,
            shortest_gap_s=TEMPERATURE_GAP_S if is_temperature else 0.0,
            at_rest_below=STANDSTILL_RPM if name == "speed" else 0.0,
            on_change=channel.is_on_change,
            hold=channel.between == "hold",
            mean_us=(channel.mean_of_s or 0.0) * SECOND_US,
            shift_us=round(channel.time_offset_s * SECOND_US),
            counts=channel.unit if channel.is_counted else None,
            volume_per_count_cm3=channel.volume_per_count_cm3 or 0.0,
            has_rows_of_its_own=logs is not None and logs.layout != "wide",
        )
        # A value that is stated is refused by none.
        anything, ever = (-math.inf, math.inf), math.inf
        stated = replace(rules, valid_range=anything, frozen_after_s=ever, longest_gap_s=ever)
        return rules if channel.constant is None else stated

    def longest_gap_us(self, period_us: float | None) -> float:
        """Return the longest silence that is no gap, at a typical period."""
        if self.longest_gap_s is not None:
            return self.longest_gap_s * SECOND_US
        return max(GAP_SAMPLE_PERIODS * (period_us or 0.0), self.shortest_gap_s * SECOND_US)

    def step_of(self, readings: Values, period_us: float | None) -> float:
        """Return the step of readings: stated, of a count in a period, or as they show it."""
        counted = 0.0
        if self.counts is not None and period_us:
            counted = self.volume_per_count_cm3 / period_us * CM3_PER_US_TO_L_PER_MIN
        return max(self.resolution, counted) or step_of_readings(readings)


def means_too_long(channels: Mapping[ChannelName, Channel]) -> str | None:
    """Return which channels are means of too long periods for a fit, in words, or None."""
    too_long = [
        f"{name} is logged as means of {channel.mean_of_s:g} s"
        for name, channel in channels.items()
        if channel.mean_of_s is not None and channel.mean_of_s > MAXIMUM_MEAN_S
    ]
    if not too_long:
        return None
    return f"{'; '.join(too_long)}; at most {MAXIMUM_MEAN_S:g} s are allowed: log it more often"


@dataclass(frozen=True, slots=True)
class Rests:
    """Standstills of the motor."""

    # First and last sample of each [µs], shape (n,).
    begins_us: Times
    ends_us: Times

    @classmethod
    def of(cls, speed: CleanChannel) -> Rests:
        """Return standstills by the clean samples of the speed."""
        at_rest = ~speed.refused & (np.abs(speed.value) < (1.0 - ROUNDING) * STANDSTILL_RPM)
        begins, ends = stretches(at_rest)
        return cls(speed.time_us[begins], speed.time_us[ends - 1])

    def hold(self, time_us: Times) -> Mask:
        """Return times that lie within a halt, shape (m,)."""
        if not len(self.begins_us):
            return np.zeros(len(time_us), dtype=np.bool_)
        last = self.begins_us.searchsorted(time_us, "right") - 1
        inside: Mask = (last >= 0) & (time_us <= self.ends_us[last])
        return inside


NO_RESTS = Rests(np.empty(0, np.int64), np.empty(0, np.int64))


@dataclass(frozen=True, slots=True)
class CleanChannel:
    """A channel's samples in order of time, the refused ones marked."""

    time_us: Times  # UTC microseconds, strictly increasing, shape (n,)
    value: Values  # in the unit of the tables, shape (n,)
    refused: Mask  # samples that a rule refused, shape (n,)
    at_maximum: Mask  # samples at which the sensor was at its maximum, shape (n,)
    steps: Steps  # from each sample to the next, and their typical length
    longest_gap_us: float  # longer silence than this is a gap
    gaps: Places  # steps that are gaps
    rules: ChannelRules  # what the samples are
    counts: Mapping[str, int]  # refused samples by reason, and ``any`` for those refused at all
    n_samples: int  # samples that the rules looked at
    # Samples by reason that were kept although it applies: `backward_time` for those put back in
    # order, `jitter` for those that came off their period.
    noted: Mapping[str, int] = field(default_factory=dict)
    # Samples of an on-change channel from which on there is no value, shape (n,); None: none.
    ends: Mask | None = None
    # Samples at the front that are from before the night, 0 or 1; no count has them.
    n_carried: int = 0

    @property
    def period_us(self) -> float | None:
        """Typical distance of two samples [µs]; None for fewer than two."""
        return self.steps.period_us


def clean_channel(
    raw: RawChannel,
    rules: ChannelRules,
    night_start_us: int | None = None,
    rests: Rests = NO_RESTS,
    order_of_stamps: Callable[[Times], Order] = order_of,
) -> CleanChannel:
    """Apply every rule of a channel to its own samples.

    Of what lies before `night_start_us`, the last sample of an on-change channel carries over; in
    `rests` nothing need move.
    """
    early, here = None, raw
    if night_start_us is not None and raw.time_us.min(initial=night_start_us) < night_start_us:
        before = raw.time_us < night_start_us
        early, here = raw.rows(before), raw.rows(chosen_rows(~before))
    order = order_of_stamps(here.time_us)
    n_put_back, n_backward, n_duplicate = (
        int(np.count_nonzero(~here.missing[rows]))
        for rows in (order.late, order.backward, order.repeated)
    )
    cells = _correct_times(here.rows(order.rows, order.time_us), rules)
    # A day at 100 Hz is not to be in memory twice.
    del raw, here
    readings_us = cells.time_us if not cells.missing.any() else cells.time_us[~cells.missing]
    steps = Steps.of(readings_us)
    longest_gap_us = rules.longest_gap_us(steps.period_us)
    samples = _samples_of(cells, rules, steps.period_us)
    if samples.time_us is not readings_us:
        steps = steps.with_period(samples.time_us)
    noted = {"backward_time": n_put_back}
    if not rules.on_change:
        noted["jitter"] = steps.n_jittered(samples.time_us)
    n_carried = 0
    if early is not None and night_start_us is not None:
        carried = _carried_over(early, rules, night_start_us - longest_gap_us)
        n_carried = len(carried.time_us)
        if n_carried:
            samples = RawChannel.join([carried, samples])
            steps = steps.with_period(samples.time_us)
    time, value, masks = _judged_alone(samples, rules, longest_gap_us)
    if time is not samples.time_us:
        steps = steps.with_period(time)
    gaps = steps.longer_than(longest_gap_us, time)
    credible = ~reduce(np.logical_or, masks.values())
    rows = chosen_rows(credible)
    course_us, readings = time[rows], value[rows]
    course = Course(
        course_us,
        readings,
        _borders(course_us, gaps, np.flatnonzero(~credible), longest_gap_us),
        rules,
        rules.step_of(readings, steps.period_us),
        rests,
    )
    masks |= {reason: _within(credible, rule(course)) for reason, rule in CHANNEL_RULES.items()}
    refused = reduce(np.logical_or, masks.values())
    counts = {reason: int(np.count_nonzero(mask[n_carried:])) for reason, mask in masks.items()}
    counts |= {"backward_time": n_backward, "duplicate_time": n_duplicate}
    out_of_order = n_backward + n_duplicate
    ends = (masks[name] for name in ("missing", "not_finite", "bad_quality") if name in masks)
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        steps=steps,
        longest_gap_us=longest_gap_us,
        gaps=gaps,
        rules=rules,
        counts=counts | {"any": int(np.count_nonzero(refused[n_carried:])) + out_of_order},
        n_samples=len(time) - n_carried + out_of_order,
        noted=noted,
        ends=reduce(np.logical_or, ends) if rules.on_change else None,
        n_carried=n_carried,
    )


def _correct_times(raw: RawChannel, rules: ChannelRules) -> RawChannel:
    """Return samples at the times at which they hold."""
    return replace(raw, time_us=raw.time_us + rules.shift_us) if rules.shift_us else raw


def _samples_of(cells: RawChannel, rules: ChannelRules, period_us: float | None) -> RawChannel:
    """Return cells in order without the blank ones that are no sample."""
    if rules.on_change:
        samples = _says_something(cells, rules)
    elif cells.missing.any():
        row_us = Steps.of(cells.time_us).period_us
        samples = ~cells.missing
        samples |= missing_sample(cells.time_us, cells.missing, period_us, row_us)
    else:
        return cells
    return cells if samples.all() else cells.rows(samples)


def _says_something(cells: RawChannel, rules: ChannelRules) -> Mask:
    """Return cells of an on-change channel that hold a value, or say that there is none."""
    if rules.has_rows_of_its_own:
        return np.ones(len(cells.time_us), dtype=np.bool_)
    says: Mask = ~cells.missing
    return says if cells.bad_quality is None else says | cells.bad_quality


def _carried_over(early: RawChannel, rules: ChannelRules, earliest_us: float) -> RawChannel:
    """Return the last sample of an on-change channel before the night, if it may hold; or none."""
    says = _says_something(early, rules) & (early.time_us >= earliest_us)
    rows = np.flatnonzero(says) if rules.on_change else np.empty(0, np.intp)
    # Of two at the same time the first counts, as within the night.
    last = rows[[np.argmax(early.time_us[rows])]] if len(rows) else rows
    return _correct_times(early.rows(last), rules)


def _judged_alone(
    samples: RawChannel, rules: ChannelRules, longest_gap_us: float
) -> tuple[Times, Values, dict[str, Mask]]:
    """Return times and values, of a counter as a flow, and what each value is refused for alone."""
    time, value, bad = samples.time_us, samples.value, samples.bad_quality
    masks = {"missing": samples.missing, "not_finite": ~(samples.missing | np.isfinite(value))}
    if bad is not None:
        masks["bad_quality"] = bad
    if rules.counts is not None:
        time, value, of_counter = flow_from_counts(
            time,
            value if bad is None else np.where(bad, np.nan, value),
            longest_gap_us,
            rules.volume_per_count_cm3,
            is_total=rules.counts == TOTAL,
        )
        masks |= of_counter
    masks |= {
        "out_of_range": out_of_range(value, rules.valid_range),
        "at_maximum": at_maximum(value, rules.sensor_maximum, rules.resolution),
    }
    return time, value, masks


def _borders(time_us: Times, long_steps: Places, refused: Places, longest_gap_us: float) -> Places:
    """Return first of the credible samples after a gap; the other places are among all samples."""
    behind = np.append(long_steps, refused) + 1
    first: Places = np.unique(behind - np.searchsorted(refused, behind))
    first = first[(first > 0) & (first < len(time_us))]
    after_gap: Mask = time_us[first] - time_us[first - 1] > longest_gap_us
    return first[after_gap]


def _within(chosen: Mask, flags: Mask) -> Mask:
    """Return flags of the chosen samples laid back among all of them."""
    mask = np.zeros(len(chosen), dtype=np.bool_)
    if flags.any():
        mask[chosen] = flags
    return mask


@dataclass(frozen=True, slots=True)
class Course:
    """Credible samples of a channel, as the rules for a channel judge them."""

    # time_us, value: shape (n,).
    time_us: Times
    value: Values
    borders: Places  # first samples after a gap, in which nobody saw the sensor
    rules: ChannelRules  # the channel's limits
    resolution: float  # step of the readings
    rests: Rests


def _spikes(course: Course) -> Mask:
    """Return spikes among the samples between two gaps: a gap ends a neighbourhood."""
    # A compressed archive holds only what differs from its neighbourhood.
    if course.rules.on_change:
        return np.zeros(len(course.value), dtype=np.bool_)
    return spike(course.value, HAMPEL_WINDOW, HAMPEL_THRESHOLD, course.resolution, course.borders)


def _stuck(course: Course) -> Mask:
    """Return frozen values; a gap adds no time to a stretch."""
    rules = course.rules
    after_us = rules.frozen_after_s * SECOND_US
    stuck = frozen(course.time_us, course.value, rules.resolution, after_us, course.borders)
    if stuck.any():
        # As many counts in each period are a steady flow; none for long is a counter that
        # stopped.
        at_rest_below = (1.0 - ROUNDING) * rules.at_rest_below
        still = course.value[stuck]
        moves = (still == 0.0) if rules.counts else np.abs(still) >= at_rest_below
        stuck[stuck] = moves & ~course.rests.hold(course.time_us[stuck])
    return stuck


# Rules for the credible samples of a channel, by their reason in `quality`. Each gives a mask
# of the samples that it refuses; `QUALITY_REASONS` has the words.
CHANNEL_RULES: dict[str, Callable[[Course], Mask]] = {"spike": _spikes, "frozen": _stuck}

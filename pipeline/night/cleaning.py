"""A channel's samples in order, every rule applied, and what each of them refused counted.

Channels are cleaned on their own samples, before the time base: one bad temperature sample,
interpolated to 10 Hz, would spoil nineteen. The rules themselves are in `pipeline.night.masks`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Mask, Times, Values, chosen_rows
from pipeline.ingest import RawChannel
from pipeline.night.channel_rules import (
    PERIODIC,
    ChannelRules,
    Sampling,
    flow_from_counts,
    step_of_readings,
)
from pipeline.night.masks import (
    ROUNDING,
    at_maximum,
    frozen,
    out_of_range,
    spike,
    stretches,
)
from pipeline.night.time_order import SharedStamps, Steps, carried_over, corrected, samples_of

# Hampel's filter: samples in its centred window, and scaled MAD off their median that are a spike.
HAMPEL_WINDOW, HAMPEL_THRESHOLD = 11, 5.0
# Silence of more sample periods is a gap.
GAP_SAMPLE_PERIODS = 5.0

Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Rests:
    """Standstills of the motor."""

    # First and last sample of each [µs], shape (n,).
    begins_us: Times
    ends_us: Times

    @classmethod
    def of(cls, speed: CleanChannel, standstill_rpm: float) -> Rests:
        """Return standstills by the clean samples of the speed."""
        at_rest = ~speed.refused & (np.abs(speed.value) < (1.0 - ROUNDING) * standstill_rpm)
        begins, ends = stretches(at_rest)
        return cls(speed.time_us[begins], speed.time_us[ends - 1])

    def hold(self, time_us: Times) -> Mask:
        """Return times that lie within one, shape (m,)."""
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
    gaps: Places  # steps that are one
    counts: Mapping[str, int]  # refused samples by reason, and ``any`` for those refused at all
    n_samples: int  # samples that the rules looked at
    # Samples by reason that were kept although it applies: `backward_time` for those put back in
    # order, `jitter` for those that came off their period.
    noted: Mapping[str, int] = field(default_factory=dict)
    sampling: Sampling = PERIODIC  # what the samples are
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
    stamps: SharedStamps | None = None,
    rests: Rests = NO_RESTS,
) -> CleanChannel:
    """Apply every rule of a channel to its own samples.

    Of what lies before `night_start_us`, the last sample of an on-change channel carries over, and
    no rule counts it; None: all samples are of the night. `stamps` has those of the channel before,
    which may be the same; `rests` are the motor's standstills, in which nothing need move.
    """
    stamps = stamps or SharedStamps()
    early, here = None, raw
    if night_start_us is not None and raw.time_us.min(initial=night_start_us) < night_start_us:
        before = raw.time_us < night_start_us
        early, here = raw.rows(before), raw.rows(chosen_rows(~before))
    order = stamps.order(here.time_us)
    n_put_back, n_backward, n_duplicate = (
        int(np.count_nonzero(~here.missing[rows]))
        for rows in (order.late, order.backward, order.repeated)
    )
    cells = corrected(here.rows(order.rows, order.time_us), rules)
    # A day at 100 Hz is not to be in memory twice.
    del raw, here
    readings_us = cells.time_us if not cells.missing.any() else cells.time_us[~cells.missing]
    steps = stamps.steps(readings_us)
    longest_gap_us = _longest_gap_us(steps.period_us, rules)
    samples = samples_of(cells, rules, steps.period_us)
    if samples.time_us is not readings_us:
        steps = steps.with_period(samples.time_us)
    noted = {"backward_time": n_put_back}
    if not rules.sampling.on_change:
        noted["jitter"] = steps.n_jittered(samples.time_us)
    n_carried = 0
    if early is not None and night_start_us is not None:
        carried = carried_over(early, rules, night_start_us - longest_gap_us)
        n_carried = len(carried.time_us)
        if n_carried:
            samples = RawChannel.joined([carried, samples])
            steps = steps.with_period(samples.time_us)
    time, value, masks = _judged_alone(samples, rules, longest_gap_us)
    if time is not samples.time_us:
        steps = steps.with_period(time)
    gaps = steps.longer_than(longest_gap_us, time)
    credible = ~reduce(np.logical_or, masks.values())
    course = _course(time, value, credible, gaps, longest_gap_us, rules, steps.period_us, rests)
    masks |= {reason: _within(credible, rule(course)) for reason, rule in CHANNEL_RULES.items()}
    refused = reduce(np.logical_or, masks.values())
    counts = {reason: int(np.count_nonzero(mask[n_carried:])) for reason, mask in masks.items()}
    counts |= {"backward_time": n_backward, "duplicate_time": n_duplicate}
    out_of_order = n_backward + n_duplicate
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        steps=steps,
        longest_gap_us=longest_gap_us,
        gaps=gaps,
        counts=counts | {"any": int(np.count_nonzero(refused[n_carried:])) + out_of_order},
        n_samples=len(time) - n_carried + out_of_order,
        noted=noted,
        sampling=rules.sampling,
        ends=_ends(masks) if rules.sampling.on_change else None,
        n_carried=n_carried,
    )


def _ends(masks: Mapping[str, Mask]) -> Mask:
    """Return samples that say that there is no value from there on."""
    found: Mask = masks["missing"] | masks["not_finite"]
    return found | masks["bad_quality"] if "bad_quality" in masks else found


def _judged_alone(
    samples: RawChannel, rules: ChannelRules, longest_gap_us: float
) -> tuple[Times, Values, dict[str, Mask]]:
    """Return times and values, of a counter as a flow, and what each value is refused for alone."""
    time, value, sampling = samples.time_us, samples.value, rules.sampling
    masks = {"missing": samples.missing, "not_finite": ~(samples.missing | np.isfinite(value))}
    if samples.bad_quality is not None:
        masks["bad_quality"] = samples.bad_quality
    if sampling.counts is not None:
        trusted = (
            value if samples.bad_quality is None else np.where(samples.bad_quality, np.nan, value)
        )
        counted = flow_from_counts(time, trusted, longest_gap_us, sampling)
        time, value = counted.time_us, counted.flow_l_per_min
        masks |= {"no_interval": counted.no_interval, "counter_reset": counted.counter_reset}
    masks |= {
        "out_of_range": out_of_range(value, rules.valid_range),
        "at_maximum": at_maximum(value, rules.sensor_maximum, rules.resolution),
    }
    return time, value, masks


def _within(chosen: Mask, flags: Mask) -> Mask:
    """Return flags of the chosen samples laid back among all of them."""
    mask = np.zeros(len(chosen), dtype=np.bool_)
    if flags.any():
        mask[chosen] = flags
    return mask


@dataclass(frozen=True, slots=True)
class Course:
    """Credible samples of a channel, as the rules for one channel judge them."""

    # time_us, value: shape (n,).
    time_us: Times
    value: Values
    borders: Places  # first samples after a gap, in which nobody saw the sensor
    rules: ChannelRules  # the channel's limits
    # Step of the readings: stated, of a counter's periods, or as the readings show it.
    resolution: float
    rests: Rests = NO_RESTS


def _course(
    time_us: Times,
    value: Values,
    credible: Mask,
    gaps: Places,
    longest_gap_us: float,
    rules: ChannelRules,
    period_us: float | None,
    rests: Rests,
) -> Course:
    """Return the credible samples with the gaps between them and their resolution."""
    rows = chosen_rows(credible)
    kept_us, readings = time_us[rows], value[rows]
    borders = _borders(kept_us, gaps, np.flatnonzero(~credible), longest_gap_us)
    stated = max(rules.resolution, rules.sampling.resolution_l_per_min(period_us))
    return Course(kept_us, readings, borders, rules, stated or step_of_readings(readings), rests)


def _borders(time_us: Times, long_steps: Places, refused: Places, longest_gap_us: float) -> Places:
    """Return first of the credible samples after a gap; the other places are among all samples."""
    behind = np.append(long_steps, refused) + 1
    first: Places = np.unique(behind - np.searchsorted(refused, behind))
    first = first[(first > 0) & (first < len(time_us))]
    after_gap: Mask = time_us[first] - time_us[first - 1] > longest_gap_us
    return first[after_gap]


def _spikes(course: Course) -> Mask:
    """Spikes among the samples between two gaps: what was before a gap is no neighbourhood."""
    rules = course.rules
    # A compressed archive holds only what differs from its neighbourhood.
    if rules.sampling.on_change:
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
        counts = rules.sampling.counts
        still = course.value[stuck]
        stuck[stuck] = (still == 0.0) if counts else np.abs(still) >= at_rest_below
        stuck &= ~course.rests.hold(course.time_us)
    return stuck


# Rules for the credible samples of one channel, by their reason in `quality`. Each gives a mask
# of the samples that it refuses; `QUALITY_REASONS` has the words.
CHANNEL_RULES: dict[str, Callable[[Course], Mask]] = {"spike": _spikes, "frozen": _stuck}


def _longest_gap_us(period_us: float | None, rules: ChannelRules) -> float:
    if rules.longest_gap_s is not None:
        return rules.longest_gap_s * SECOND_US
    return max(GAP_SAMPLE_PERIODS * (period_us or 0.0), rules.shortest_gap_s * SECOND_US)

"""Which samples are refused: each rule a pure function that returns a mask and changes nothing.

Channels are cleaned on their own samples, before the time base: one bad temperature sample,
interpolated to 10 Hz, would spoil nineteen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pipeline.clocks import (
    backward_time,
    duplicate_time,
    jittered,
    stray_time,
    typical_period_us,
    written_late,
)
from pipeline.config import Channel, Cleaning
from pipeline.config.motors import FALLBACK_VALID_RANGE
from pipeline.ingest import RawChannel
from pipeline.sampling import PERIODIC, Sampling, flow_from_counts, step_of_readings

Values = NDArray[np.float64]
Times = NDArray[np.int64]
Mask = NDArray[np.bool_]

SECOND_US = 1_000_000
# 1 / the standard normal's third quartile: the MAD of normal noise times this is its sd.
MAD_TO_SD = 1.482602218505602
TEMPERATURE_FROZEN_AFTER_S = 900.0
# Windows compared at a time by the Hampel filter: bounds its memory, changes no figure.
HAMPEL_CHUNK = 65_536
# A limit is not crossed by less than this share of it: a conversion of units leaves that much.
ROUNDING = 1e-6
# Nor is a distance in steps of the sensor by less than this share of one.
STEP_ROUNDING = 0.01
# A sample that comes within this share of a period after it was due is late, not missing.
LATE_SHARE = 0.75


@dataclass(frozen=True, slots=True)
class ChannelRules:
    """The rules of one channel, resolved from the motor's and the fleet's config.

    Attributes
    ----------
    valid_range
        Lowest and highest plausible value [bar, °C, rpm or l/min].
    sensor_maximum
        Highest value the sensor gives, or None.
    resolution
        Smallest step of the sensor.
    hampel_window, hampel_threshold
        Samples in the window; limit in scaled MAD.
    frozen_after_s
        Longest credible time without a change [s].
    gap_sample_periods, longest_gap_s
        Silence that is a gap: in sample periods, unless stated in seconds.
    at_rest_below
        Values smaller in magnitude never count as frozen: a halted motor's speed stays 0.
    sampling
        What the samples are.
    puts_in_order
        Samples written late are put back in their place, not refused.
    """

    valid_range: tuple[float, float]
    sensor_maximum: float | None
    resolution: float
    hampel_window: int
    hampel_threshold: float
    frozen_after_s: float
    gap_sample_periods: float
    longest_gap_s: float | None
    at_rest_below: float = 0.0
    sampling: Sampling = PERIODIC
    puts_in_order: bool = True

    @classmethod
    def of(cls, name: str, channel: Channel, cleaning: Cleaning) -> ChannelRules:
        """The rules of a channel: its own keys where stated, else the fleet's."""
        is_temperature = name == "oil_temperature"
        fallback = TEMPERATURE_FROZEN_AFTER_S if is_temperature else cleaning.frozen_after_s
        # A value that did not change was not sent: silence is no sign of a frozen sensor.
        silence_s = channel.longest_silence_s or 0.0
        fallback = max(fallback, silence_s) if channel.sampling == "on_change" else fallback
        temperature_gap_s = max(
            cleaning.temperature_gap_s, cleaning.gap_sample_periods * (channel.mean_of_s or 0.0)
        )
        return cls(
            valid_range=channel.valid_range or FALLBACK_VALID_RANGE[name],
            sensor_maximum=channel.sensor_maximum,
            resolution=channel.resolution,
            hampel_window=cleaning.hampel_window,
            hampel_threshold=cleaning.hampel_threshold,
            frozen_after_s=channel.frozen_after_s or fallback,
            gap_sample_periods=cleaning.gap_sample_periods,
            longest_gap_s=silence_s or (temperature_gap_s if is_temperature else None),
            at_rest_below=cleaning.standstill_rpm if name == "speed" else 0.0,
            sampling=Sampling.of(channel),
            puts_in_order=cleaning.out_of_order == "sort",
        )


@dataclass(frozen=True, slots=True)
class CleanChannel:
    """A channel's samples in order of time, the refused ones marked.

    Attributes
    ----------
    time_us
        UTC microseconds, strictly increasing, shape (n,).
    value
        In the unit of the tables, shape (n,).
    refused
        Samples that a rule refused, shape (n,).
    at_maximum
        Samples at which the sensor was at its maximum, shape (n,).
    period_us
        Typical distance of two samples; None for fewer than two.
    longest_gap_us
        Longer silence than this is a gap.
    counts
        Refused samples by reason, and ``any`` for those refused at all.
    n_samples
        Samples that the rules looked at.
    noted
        Samples by reason that were kept although it applies: `backward_time` for those put back
        in order, `jitter` for those that came off their period.
    sampling
        What the samples are.
    """

    time_us: Times
    value: Values
    refused: Mask
    at_maximum: Mask
    period_us: float | None
    longest_gap_us: float
    counts: Mapping[str, int]
    n_samples: int
    noted: Mapping[str, int] = field(default_factory=dict)
    sampling: Sampling = PERIODIC


def clean_channel(raw: RawChannel, rules: ChannelRules) -> CleanChannel:
    """Apply every rule of a channel to its own samples.

    Parameters
    ----------
    raw
        Samples as read, in the order of the log.
    rules
        The channel's rules.

    Returns
    -------
    CleanChannel
        Sorted, with blank cells that are no sample left out and all others judged.
    """
    time, value, blank, disorder = _in_order(raw, rules)
    sampling = rules.sampling
    period = typical_period_us(time[~blank])
    longest_gap_us = _longest_gap_us(period, rules)
    missing = blank & False if sampling.on_change else missing_sample(time, blank, period)
    sample = ~blank | missing
    time, value, missing = time[sample], value[sample], missing[sample]
    noted = {"backward_time": disorder.n_put_back}
    if not sampling.on_change:
        noted["jitter"] = int(jittered(time, period).sum())
    masks = {"missing": missing, "not_finite": ~missing & ~np.isfinite(value)}
    if sampling.counts is not None:
        counted = flow_from_counts(time, value, longest_gap_us, sampling)
        time, value = counted.time_us, counted.flow_l_per_min
        masks |= {"no_interval": counted.no_interval, "counter_reset": counted.counter_reset}
    masks |= {
        "out_of_range": out_of_range(value, rules.valid_range),
        "at_maximum": at_maximum(value, rules.sensor_maximum, rules.resolution),
    }
    credible = ~np.logical_or.reduce(list(masks.values()))
    resolution = max(rules.resolution, sampling.resolution_l_per_min(period))
    resolution = resolution or step_of_readings(value[credible])
    # A compressed archive holds only what differs from its neighbourhood.
    stands_out = (
        np.zeros(int(credible.sum()), dtype=np.bool_)
        if sampling.on_change
        else _spike_between_gaps(
            time[credible],
            value[credible],
            longest_gap_us,
            replace(rules, resolution=resolution),
        )
    )
    masks["spike"] = _within(credible, stands_out)
    masks["frozen"] = _within(
        credible, _frozen_in_sight(time[credible], value[credible], longest_gap_us, rules)
    )
    refused = np.logical_or.reduce(list(masks.values()))
    counts = {reason: int(mask.sum()) for reason, mask in masks.items()}
    counts |= {"backward_time": disorder.n_backward, "duplicate_time": disorder.n_duplicate}
    out_of_order = disorder.n_backward + disorder.n_duplicate
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        period_us=period,
        longest_gap_us=longest_gap_us,
        counts=counts | {"any": int(refused.sum()) + out_of_order},
        n_samples=len(time) + out_of_order,
        noted=noted,
        sampling=sampling,
    )


@dataclass(frozen=True, slots=True)
class _Disorder:
    """Samples, blank cells aside, that were out of order."""

    n_put_back: int
    n_backward: int
    n_duplicate: int


def _in_order(raw: RawChannel, rules: ChannelRules) -> tuple[Times, Values, Mask, _Disorder]:
    """Cells in strict order of their corrected time, and what it took."""
    backward = backward_time(raw.time_us)
    late = np.zeros(len(backward), dtype=np.bool_)
    if rules.puts_in_order:
        late = written_late(raw.time_us, backward)
    backward = (backward & ~late) | stray_time(raw.time_us, late)
    rows = np.flatnonzero(~backward)
    if late.any():
        rows = rows[np.argsort(raw.time_us[rows], kind="stable")]
    repeated = duplicate_time(raw.time_us[rows], np.zeros(len(rows), dtype=np.bool_))
    disorder = _Disorder(
        int((late & ~raw.missing).sum()),
        int((backward & ~raw.missing).sum()),
        int((repeated & ~raw.missing[rows]).sum()),
    )
    rows = rows[~repeated]
    time = raw.time_us[rows] + rules.sampling.shift_us
    return time, raw.value[rows], raw.missing[rows], disorder


def _within(chosen: Mask, flags: Mask) -> Mask:
    """Flags of the chosen samples laid back among all of them."""
    mask = np.zeros(len(chosen), dtype=np.bool_)
    mask[chosen] = flags
    return mask


def _spike_between_gaps(
    time_us: Times, value: Values, longest_gap_us: float, rules: ChannelRules
) -> Mask:
    """Spikes among the samples between two gaps: what was before a gap is no neighbourhood."""
    borders = np.flatnonzero(np.diff(time_us) > longest_gap_us) + 1
    parts = np.split(value, borders)
    return np.concatenate([spike(part, rules) for part in parts])


def _frozen_in_sight(
    time_us: Times, value: Values, longest_gap_us: float, rules: ChannelRules
) -> Mask:
    """Frozen values; a gap, in which nobody saw the sensor, adds no time to a stretch."""
    steps = np.diff(time_us, prepend=time_us[:1])
    seen_us = np.cumsum(np.where(steps > longest_gap_us, 0, steps))
    stuck = frozen(seen_us, value, rules.resolution, rules.frozen_after_s * SECOND_US)
    # As many counts in each period are a steady flow; none for long is a counter that stopped.
    at_rest_below = (1.0 - ROUNDING) * rules.at_rest_below
    counting = (value != 0.0) if rules.sampling.counts else np.abs(value) < at_rest_below
    mask: Mask = stuck & ~counting
    return mask


def _longest_gap_us(period_us: float | None, rules: ChannelRules) -> float:
    if rules.longest_gap_s is not None:
        return rules.longest_gap_s * SECOND_US
    return rules.gap_sample_periods * (period_us or 0.0)


def missing_sample(time_us: Times, blank: Mask, period_us: float | None) -> Mask:
    """Blank cells at which the channel should have had a sample.

    In a log whose rows are those of the fastest channel, a slower one is blank in most of them: a
    blank cell is a missing sample only where the channel's own period, counted from its last
    sample, says that one is due, and none comes a little late.

    Parameters
    ----------
    time_us
        Times of the cells, increasing, shape (n,).
    blank
        Cells without a value, shape (n,).
    period_us
        The channel's own period; None: every blank is missing.

    Returns
    -------
    ndarray of bool
        Shape (n,).
    """
    if period_us is None or not blank.any():
        return blank.copy()
    row = np.arange(len(time_us))
    last = np.maximum.accumulate(np.where(blank, -1, row))
    known = last >= 0
    since = np.where(known, time_us - time_us[np.maximum(last, 0)], 0)
    row_us = typical_period_us(time_us) or period_us
    off = np.abs(since - np.maximum(np.round(since / period_us), 1.0) * period_us)
    due: Mask = blank & (off < row_us / 2)
    following = np.minimum.accumulate(np.where(blank, len(row), row)[::-1])[::-1]
    comes = following < len(row)
    late_us = time_us[np.where(comes, following, 0)] - time_us
    due &= ~comes | (late_us > LATE_SHARE * period_us)
    # Before the first sample there is nothing to count from: only a fast channel is missing there.
    due[~known] = blank[~known] & (period_us < 1.5 * row_us)
    return due


def out_of_range(value: Values, valid_range: tuple[float, float]) -> Mask:
    """Values outside the valid range; NaN is not, it has its own reason."""
    low, high = valid_range
    mask: Mask = (value < low - ROUNDING * abs(low)) | (value > high + ROUNDING * abs(high))
    return mask


def at_maximum(value: Values, sensor_maximum: float | None, resolution: float) -> Mask:
    """Values at which the sensor is at its maximum, to half of its resolution."""
    if sensor_maximum is None:
        return np.zeros(len(value), dtype=np.bool_)
    mask: Mask = value >= sensor_maximum - max(resolution / 2, 1e-9 * abs(sensor_maximum))
    return mask


def spike(value: Values, rules: ChannelRules) -> Mask:
    """Hampel filter: values too far from the median of their neighbourhood.

    The scale is the median absolute deviation within the window, as a standard deviation, and never
    below the sensor's resolution: a coarse signal has a deviation of 0 and would lose its steps.

    Parameters
    ----------
    value
        Finite values in order of time, shape (n,).
    rules
        Window, threshold and resolution.

    Returns
    -------
    ndarray of bool
        Shape (n,).

    References
    ----------
    .. [1] R. K. Pearson, "Outliers in process modeling and identification", *IEEE Transactions on
       Control Systems Technology*, 10(1), 2002.
    """
    mask = np.zeros(len(value), dtype=np.bool_)
    half = rules.hampel_window // 2
    if len(value) < rules.hampel_window:
        return mask
    padded = np.pad(value, half, mode="reflect")
    windows = sliding_window_view(padded, rules.hampel_window)
    floor = (rules.hampel_threshold + STEP_ROUNDING) * rules.resolution
    for begin in range(0, len(value), HAMPEL_CHUNK):
        part = windows[begin : begin + HAMPEL_CHUNK]
        middle = np.partition(part, half, axis=1)[:, half]
        distance = np.abs(value[begin : begin + HAMPEL_CHUNK] - middle)
        # Only what exceeds the floor can be a spike: few windows need their deviation.
        far = np.flatnonzero(distance > floor)
        deviation = np.median(np.abs(part[far] - middle[far, None]), axis=1)
        limit = rules.hampel_threshold * MAD_TO_SD * deviation
        mask[begin + far] = distance[far] > limit
    return mask


def frozen(time_us: Times, value: Values, resolution: float, frozen_after_us: float) -> Mask:
    """Values that stay within one step of the sensor for too long.

    Readings of the sensor's steps are told apart; noise of less than half a step between them, as a
    conversion of units leaves it, is no change, wherever it lies.

    Parameters
    ----------
    time_us, value
        Samples in order of time, shape (n,).
    resolution
        Step of the sensor; 0: values must be equal.
    frozen_after_us
        Longest credible time without a change [µs].

    Returns
    -------
    ndarray of bool
        All samples of each stretch that lasts longer, shape (n,).
    """
    if not len(value):
        return np.zeros(0, dtype=np.bool_)
    if resolution <= 0:
        return _unchanged(time_us, value, frozen_after_us)
    # Half a step between the borders of the two grids: less noise than that crosses only one.
    steps = value / resolution
    low, high = np.floor(steps + 0.25), np.floor(steps + 0.75)
    mask: Mask = _unchanged(time_us, low, frozen_after_us) | _unchanged(
        time_us, high, frozen_after_us
    )
    return mask


def _unchanged(time_us: Times, step: Values, frozen_after_us: float) -> Mask:
    """Samples of each stretch of equal steps that lasts too long."""
    begins = np.flatnonzero(np.concatenate([[True], step[1:] != step[:-1]]))
    ends = np.append(begins[1:], len(step)) - 1
    too_long = time_us[ends] - time_us[begins] > frozen_after_us
    mask: Mask = np.repeat(too_long, ends - begins + 1)
    return mask


def near(events_us: Times, time_us: Times, before_us: float, after_us: float) -> Mask:
    """Times within a guard time before or after any event.

    Parameters
    ----------
    events_us
        Times of the events, sorted, shape (m,).
    time_us
        Times to judge, shape (n,).
    before_us, after_us
        Guard times [µs].

    Returns
    -------
    ndarray of bool
        Shape (n,).
    """
    first = np.searchsorted(events_us, time_us - after_us, side="left")
    last = np.searchsorted(events_us, time_us + before_us, side="right")
    mask: Mask = last > first
    return mask


def transient(value: Values, present: Mask, period_s: float, limit_per_s: float) -> Mask:
    """Samples of the time base at which a channel changes faster than a limit.

    Parameters
    ----------
    value
        On the time base, shape (n,); only `present` ones are looked at.
    present
        Samples of the time base that have a value, shape (n,).
    period_s
        Period of the time base [s].
    limit_per_s
        Largest credible steady change per second.

    Returns
    -------
    ndarray of bool
        Both ends of each fast change, shape (n,).
    """
    pairs = present[1:] & present[:-1]
    rate = np.zeros(len(pairs))
    rate[pairs] = np.abs(np.diff(value)[pairs]) / period_s
    fast = rate > (1.0 + ROUNDING) * limit_per_s
    mask = np.zeros(len(value), dtype=np.bool_)
    mask[1:] |= fast
    mask[:-1] |= fast
    return mask

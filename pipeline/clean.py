"""Which samples are refused: each rule a pure function that returns a mask and changes nothing.

Channels are cleaned on their own samples, before the time base: one bad temperature sample,
interpolated to 10 Hz, would spoil nineteen.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning
from pipeline.config.motors import FALLBACK_VALID_RANGE
from pipeline.ingest import RawChannel

Values = NDArray[np.float64]
Times = NDArray[np.int64]
Mask = NDArray[np.bool_]

SECOND_US = 1_000_000
# 1 / the standard normal's third quartile: the MAD of normal noise times this is its sd.
MAD_TO_SD = 1.482602218505602
TEMPERATURE_FROZEN_AFTER_S = 900.0
# Windows compared at a time by the Hampel filter: bounds its memory, changes no figure.
HAMPEL_CHUNK = 65_536
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

    @classmethod
    def of(cls, name: str, channel: Channel, cleaning: Cleaning) -> ChannelRules:
        """The rules of a channel: its own keys where stated, else the fleet's."""
        is_temperature = name == "oil_temperature"
        fallback = TEMPERATURE_FROZEN_AFTER_S if is_temperature else cleaning.frozen_after_s
        return cls(
            valid_range=channel.valid_range or FALLBACK_VALID_RANGE[name],
            sensor_maximum=channel.sensor_maximum,
            resolution=channel.resolution,
            hampel_window=cleaning.hampel_window,
            hampel_threshold=cleaning.hampel_threshold,
            frozen_after_s=channel.frozen_after_s or fallback,
            gap_sample_periods=cleaning.gap_sample_periods,
            longest_gap_s=cleaning.temperature_gap_s if is_temperature else None,
            at_rest_below=cleaning.standstill_rpm if name == "speed" else 0.0,
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
    """

    time_us: Times
    value: Values
    refused: Mask
    at_maximum: Mask
    period_us: float | None
    longest_gap_us: float
    counts: Mapping[str, int]
    n_samples: int


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
    backward = backward_time(raw.time_us)
    duplicate = duplicate_time(raw.time_us, backward)
    in_order = ~(backward | duplicate)
    time, value, blank = raw.time_us[in_order], raw.value[in_order], raw.missing[in_order]
    period = typical_period_us(time[~blank])
    longest_gap_us = _longest_gap_us(period, rules)
    missing = missing_sample(time, blank, period)
    sample = ~blank | missing
    time, value, missing = time[sample], value[sample], missing[sample]
    masks = {
        "missing": missing,
        "not_finite": ~missing & ~np.isfinite(value),
        "out_of_range": out_of_range(value, rules.valid_range),
        "at_maximum": at_maximum(value, rules.sensor_maximum, rules.resolution),
    }
    credible = ~np.logical_or.reduce(list(masks.values()))
    masks["spike"] = _within(credible, spike(value[credible], rules))
    masks["frozen"] = _within(
        credible, _frozen_in_sight(time[credible], value[credible], longest_gap_us, rules)
    )
    refused = np.logical_or.reduce(list(masks.values()))
    counts = {reason: int(mask.sum()) for reason, mask in masks.items()}
    counts |= {
        "backward_time": int((backward & ~raw.missing).sum()),
        "duplicate_time": int((duplicate & ~raw.missing).sum()),
    }
    out_of_order = counts["backward_time"] + counts["duplicate_time"]
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        period_us=period,
        longest_gap_us=longest_gap_us,
        counts=counts | {"any": int(refused.sum()) + out_of_order},
        n_samples=len(time) + out_of_order,
    )


def _within(chosen: Mask, flags: Mask) -> Mask:
    """Flags of the chosen samples laid back among all of them."""
    mask = np.zeros(len(chosen), dtype=np.bool_)
    mask[chosen] = flags
    return mask


def _frozen_in_sight(
    time_us: Times, value: Values, longest_gap_us: float, rules: ChannelRules
) -> Mask:
    """Frozen values; a gap, in which nobody saw the sensor, adds no time to a stretch."""
    steps = np.diff(time_us, prepend=time_us[:1])
    seen_us = np.cumsum(np.where(steps > longest_gap_us, 0, steps))
    stuck = frozen(seen_us, value, rules.resolution, rules.frozen_after_s * SECOND_US)
    mask: Mask = stuck & (np.abs(value) >= rules.at_rest_below)
    return mask


def _longest_gap_us(period_us: float | None, rules: ChannelRules) -> float:
    if rules.longest_gap_s is not None:
        return rules.longest_gap_s * SECOND_US
    return rules.gap_sample_periods * (period_us or 0.0)


def typical_period_us(time_us: Times) -> float | None:
    """Median distance of consecutive samples [µs]; None for fewer than two."""
    return float(np.median(np.diff(time_us))) if len(time_us) > 1 else None


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


def backward_time(time_us: Times) -> Mask:
    """Samples whose time does not fit an increasing clock.

    The fewest possible are named (all but a longest non-decreasing subsequence), so that a single
    stamp in the future does not refuse all that follow it.
    """
    mask = np.zeros(len(time_us), dtype=np.bool_)
    if len(time_us) < 2 or bool((np.diff(time_us) >= 0).all()):
        return mask
    latest_before = np.maximum.accumulate(time_us)
    earliest_after = np.minimum.accumulate(time_us[::-1])[::-1]
    # A stamp in order with all others belongs to any longest subsequence: few are left to search.
    doubtful = np.flatnonzero((time_us < latest_before) | (time_us > earliest_after))
    mask[doubtful] = True
    mask[doubtful[_longest_increasing(time_us[doubtful].tolist())]] = False
    return mask


def _longest_increasing(stamps: list[int]) -> list[int]:
    """Places of a longest non-decreasing subsequence (patience sorting)."""
    tails: list[int] = []
    ends: list[int] = []
    previous: list[int] = []
    for index, stamp in enumerate(stamps):
        pile = bisect_right(tails, stamp)
        previous.append(ends[pile - 1] if pile else -1)
        tails[pile : pile + 1] = [stamp]
        ends[pile : pile + 1] = [index]
    places: list[int] = []
    index = ends[-1]
    while index >= 0:
        places.append(index)
        index = previous[index]
    return places[::-1]


def duplicate_time(time_us: Times, backward: Mask) -> Mask:
    """Samples, among those that are not backward, that repeat the time of the one before."""
    mask = np.zeros(len(time_us), dtype=np.bool_)
    kept = np.flatnonzero(~backward)
    mask[kept[1:]] = np.diff(time_us[kept]) == 0
    return mask


def out_of_range(value: Values, valid_range: tuple[float, float]) -> Mask:
    """Values outside the valid range; NaN is not, it has its own reason."""
    mask: Mask = (value < valid_range[0]) | (value > valid_range[1])
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
    floor = rules.hampel_threshold * rules.resolution
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
    fast = rate > limit_per_s
    mask = np.zeros(len(value), dtype=np.bool_)
    mask[1:] |= fast
    mask[:-1] |= fast
    return mask

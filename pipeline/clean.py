"""Which samples are refused: each rule a pure function that returns a mask and changes nothing.

Channels are cleaned on their own samples, before the time base: one bad temperature sample,
interpolated to 10 Hz, would spoil nineteen.
"""

from __future__ import annotations

from bisect import bisect_left
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
    """

    valid_range: tuple[float, float]
    sensor_maximum: float | None
    resolution: float
    hampel_window: int
    hampel_threshold: float
    frozen_after_s: float
    gap_sample_periods: float
    longest_gap_s: float | None

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
    backward, duplicate = backward_time(raw.time_us), duplicate_time(raw.time_us)
    in_order = ~(backward | duplicate)
    time, value, blank = raw.time_us[in_order], raw.value[in_order], raw.missing[in_order]
    period = typical_period_us(time[~blank])
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
    frozen_after_us = rules.frozen_after_s * SECOND_US
    masks["frozen"] = _within(
        credible, frozen(time[credible], value[credible], rules.resolution, frozen_after_us)
    )
    refused = np.logical_or.reduce(list(masks.values()))
    counts = {reason: int(mask.sum()) for reason, mask in masks.items()}
    counts |= {"backward_time": int(backward.sum()), "duplicate_time": int(duplicate.sum())}
    out_of_order = counts["backward_time"] + counts["duplicate_time"]
    return CleanChannel(
        time_us=time,
        value=value,
        refused=refused,
        at_maximum=masks["at_maximum"],
        period_us=period,
        longest_gap_us=_longest_gap_us(period, rules),
        counts=counts | {"any": int(refused.sum()) + out_of_order},
        n_samples=len(time) + out_of_order,
    )


def _within(chosen: Mask, flags: Mask) -> Mask:
    """Flags of the chosen samples laid back among all of them."""
    mask = np.zeros(len(chosen), dtype=np.bool_)
    mask[chosen] = flags
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
    sample, says that one is due.

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
    # Before the first sample there is nothing to count from: only a fast channel is missing there.
    due[~known] = blank[~known] & (period_us < 1.5 * row_us)
    return due


def backward_time(time_us: Times) -> Mask:
    """Samples whose time does not fit an increasing clock.

    The fewest possible are named (all but a longest non-decreasing subsequence), so that a single
    stamp in the future does not refuse all that follow it.
    """
    n = len(time_us)
    if n < 2 or bool((np.diff(time_us) >= 0).all()):
        return np.zeros(n, dtype=np.bool_)
    tails: list[int] = []
    ends: list[int] = []
    previous = np.full(n, -1, dtype=np.int64)
    for index, stamp in enumerate(time_us.tolist()):
        place = bisect_left(tails, stamp + 1)
        if place:
            previous[index] = ends[place - 1]
        if place == len(tails):
            tails.append(stamp)
            ends.append(index)
        else:
            tails[place], ends[place] = stamp, index
    mask = np.ones(n, dtype=np.bool_)
    index = ends[-1]
    while index >= 0:
        mask[index] = False
        index = int(previous[index])
    return mask


def duplicate_time(time_us: Times) -> Mask:
    """Samples, among those in order, that repeat the time of the one before."""
    mask = np.zeros(len(time_us), dtype=np.bool_)
    kept = np.flatnonzero(~backward_time(time_us))
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
    step = np.round(value / resolution) if resolution > 0 else value
    begins = np.flatnonzero(np.concatenate([[True], step[1:] != step[:-1]]))
    ends = np.append(begins[1:], len(value)) - 1
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

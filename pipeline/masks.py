"""Which samples a rule refuses: each a pure function that returns a mask and changes nothing."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pipeline.arrays import Mask, Times, Values
from pipeline.clocks import typical_period_us

# 1 / the standard normal's third quartile: the MAD of normal noise times this is its sd.
MAD_TO_SD = 1.482602218505602
# Windows compared at a time by the Hampel filter: bounds its memory, changes no figure.
HAMPEL_CHUNK = 65_536
# A sample that comes within this share of a period after it was due is late, not missing.
LATE_SHARE = 0.75
# A limit is not crossed by less than this share of it: a conversion of units leaves that much.
ROUNDING = 1e-6
# Nor is a distance in steps of the sensor by less than this share of one.
STEP_ROUNDING = 0.01


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


def spike(value: Values, window: int, threshold: float, resolution: float) -> Mask:
    """Hampel filter: values too far from the median of their neighbourhood.

    The scale is the median absolute deviation within the window, as a standard deviation, and never
    below the sensor's resolution: a coarse signal has a deviation of 0 and would lose its steps.

    Parameters
    ----------
    value
        Finite values in order of time, shape (n,).
    window
        Samples in the window, an odd number; of fewer samples none is a spike.
    threshold
        Limit in scaled MAD.
    resolution
        Smallest step of the sensor.

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
    half = window // 2
    if len(value) < window:
        return mask
    padded = np.pad(value, half, mode="reflect")
    windows = sliding_window_view(padded, window)
    floor = (threshold + STEP_ROUNDING) * resolution
    for begin in range(0, len(value), HAMPEL_CHUNK):
        part = windows[begin : begin + HAMPEL_CHUNK]
        middle = np.partition(part, half, axis=1)[:, half]
        distance = np.abs(value[begin : begin + HAMPEL_CHUNK] - middle)
        # Only what exceeds the floor can be a spike: few windows need their deviation.
        far = np.flatnonzero(distance > floor)
        deviation = np.median(np.abs(part[far] - middle[far, None]), axis=1)
        limit = threshold * MAD_TO_SD * deviation
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

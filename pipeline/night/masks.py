"""Masks of the samples that a rule refuses, and what readings say of themselves: pure functions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Mask, Times, Values

# 1 / the standard normal's third quartile: the MAD of normal noise times this is its sd.
MAD_TO_SD = 1.482602218505602
# Samples, and windows of the Hampel filter, that are worked on at a time: what is computed from
# them stays in the cache.
CACHED, WINDOWS = 32_768, 4096
NO_BORDERS = np.empty(0, dtype=np.intp)
# Samples of a possible stretch of frozen values that are looked at before all of them are.
LOOKED_AT_A_STRETCH = 16
# A sample that comes within this share of a period after it was due is late, not missing.
LATE_SHARE = 0.75
# A limit is not crossed by less than this share of it: a conversion of units leaves that much.
ROUNDING = 1e-6
# Nor is a distance in steps of the sensor by less than this share of a step.
STEP_ROUNDING = 0.01
# cm³/µs -> l/min.
CM3_PER_US_TO_L_PER_MIN = 60.0 * SECOND_US / 1000.0
# A change is a step of the sensor if this share of all pairs makes it, and so many at least.
STEP_SHARE = 0.05
FEWEST_STEPS = 3
PAIRS_LOOKED_AT = 50_000


def stretches(mask: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return first places of the stretches in which a mask is set, and the places behind them.

    Examples
    --------
    >>> stretches(np.array([True, False, True, True]))
    (array([0, 2]), array([1, 4]))
    """
    framed = np.zeros(len(mask) + 2, dtype=np.bool_)
    framed[1:-1] = mask
    edges = np.flatnonzero(framed[1:] != framed[:-1])
    return edges[::2], edges[1::2]


def steps_where(holds: Callable[[Times], Mask], time_us: Times) -> NDArray[np.intp]:
    """Return places of the steps, from each time to the next, of which something holds."""
    return np.flatnonzero(holds(np.diff(time_us)))


def missing_sample(
    time_us: Times, blank: Mask, period_us: float | None, row_us: float | None
) -> Mask:
    """Return blank cells at which the channel should have had a sample.

    A slower channel is blank in most rows of a log: a sample is missing only where the channel's
    own period, counted from its last sample, says that one is due, and none comes a little late.
    """
    if period_us is None or not blank.any():
        return blank.copy()
    row_us = row_us or period_us
    due = np.zeros(len(time_us), dtype=np.bool_)
    # Stretches of blank cells, each with the sample before it and the next.
    begins, ends = stretches(blank)
    begins = begins - 1
    if begins[0] < 0:
        # Nothing to count from: only a fast channel is missing there.
        due[: ends[0]] = period_us < 1.5 * row_us
        begins, ends = begins[1:], ends[1:]
    # Where the next sample comes in time, none is due between the two.
    slow = time_us[ends - 1] - time_us[begins] > period_us - 0.75 * row_us
    begins, ends = begins[slow], ends[slow]
    lengths = ends - begins - 1
    first = np.repeat(begins, lengths)
    cells = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    since = time_us[cells] - time_us[first]
    off = np.abs(since - np.maximum(np.round(since / period_us), 1.0) * period_us)
    following = np.repeat(ends, lengths)
    comes = following < len(time_us)
    late_us = time_us[np.where(comes, following, 0)] - time_us[cells]
    due[cells] = (off < row_us / 2) & (~comes | (late_us > LATE_SHARE * period_us))
    return due


def out_of_range(value: Values, valid_range: tuple[float, float]) -> Mask:
    """Return values outside the valid range; NaN is not, it has its own reason."""
    low, high = valid_range
    mask: Mask = value < low - ROUNDING * abs(low)
    mask |= value > high + ROUNDING * abs(high)
    return mask


def at_maximum(value: Values, sensor_maximum: float | None, resolution: float) -> Mask:
    """Return values at which the sensor is at its maximum, to half of its resolution."""
    if sensor_maximum is None:
        return np.zeros(len(value), dtype=np.bool_)
    mask: Mask = value >= sensor_maximum - max(resolution / 2, 1e-9 * abs(sensor_maximum))
    return mask


def spike(
    value: Values,
    window: int,
    threshold: float,
    resolution: float,
    borders: NDArray[np.intp] = NO_BORDERS,
) -> Mask:
    """Return values too far from the median of their neighbourhood, by Hampel's filter.

    The scale is the median absolute deviation within the window, as a standard deviation, and never
    below the sensor's resolution: a coarse signal would lose its steps. The window is odd, and
    mirrored at `borders`, the first samples behind a gap. R. K. Pearson, "Outliers in process
    modeling and identification", IEEE Transactions on Control Systems Technology 10(1), 2002.
    """
    mask = np.zeros(len(value), dtype=np.bool_)
    half = window // 2
    if len(value) < window:
        return mask
    floor = (threshold + STEP_ROUNDING) * resolution
    # Only what is farther away than the floor can be a spike: few windows need their deviation,
    # which also judges what is on the floor but for rounding.
    far = np.flatnonzero(_far_from_median(value, half, (1.0 - ROUNDING) * floor))
    windows = sliding_window_view(value, window)
    mask[half + far] = _stands_out(windows, far, threshold, floor)
    # Beside the ends of each stretch windows are mirrored.
    edges = np.concatenate([[0], borders, [len(value)]])
    lengths = np.diff(edges)
    long = lengths >= window
    for begin, end in zip(edges[:-1][~long].tolist(), edges[1:][~long].tolist(), strict=True):
        mask[begin:end] = False
    first, last = edges[:-1][long, None], edges[1:][long, None] - 1
    beside = np.arange(half)
    inward = np.abs(beside[:, None] + np.arange(-half, half + 1))
    rows = np.concatenate([first + beside, last - beside]).ravel()
    places = np.concatenate([first[:, None] + inward, last[:, None] - inward])
    windows = value[places].reshape(-1, window)
    mask[rows] = _stands_out(windows, np.arange(len(rows)), threshold, floor)
    return mask


def _stands_out(windows: Values, rows: NDArray[np.intp], threshold: float, floor: float) -> Mask:
    """Return some of the windows whose middle value is too far from their median."""
    apart, half = np.empty(len(rows), dtype=np.bool_), windows.shape[1] // 2
    for chunk in range(0, len(rows), WINDOWS):
        part = windows[rows[chunk : chunk + WINDOWS]]
        distance = np.abs(part - np.partition(part, half, axis=1)[:, half, None])
        deviation = np.partition(distance, half, axis=1)[:, half]
        limit = np.maximum(floor, threshold * MAD_TO_SD * deviation)
        apart[chunk : chunk + WINDOWS] = distance[:, half] > limit
    return apart


def _far_from_median(value: Values, half: int, floor: float) -> Mask:
    """Return values more than a floor from the median of `half` values on either side and itself.

    The median is at most so far below where half of the others are, and likewise above.
    """
    n = len(value) - 2 * half
    far = np.empty(n, dtype=np.bool_)
    for begin in range(0, n, CACHED):
        part = value[begin : begin + CACHED + 2 * half]
        high, low = part + floor, part - floor
        not_below, not_above = np.zeros((2, len(part)), dtype=np.min_scalar_type(2 * half))
        for lag in range(1, half + 1):
            rises = (part[lag:] <= high[:-lag]).view(np.uint8)
            falls = (part[lag:] >= low[:-lag]).view(np.uint8)
            not_below[lag:] += rises
            not_below[:-lag] += falls
            not_above[lag:] += falls
            not_above[:-lag] += rises
        inner = slice(half, len(part) - half)
        far[begin : begin + CACHED] = np.minimum(not_below[inner], not_above[inner]) < half
    return far


def frozen(
    time_us: Times,
    value: Values,
    resolution: float,
    frozen_after_us: float,
    borders: NDArray[np.intp] = NO_BORDERS,
) -> Mask:
    """Return values that stay within a step of the sensor for too long, gaps before borders aside.

    Noise of less than half a step, as a conversion of units leaves it, is no change.
    """
    mask = np.zeros(len(value), dtype=np.bool_)
    gaps_us = np.append(0, np.cumsum(time_us[borders] - time_us[borders - 1]))

    def seen_us(rows: NDArray[np.intp]) -> Times:
        seen: Times = time_us[rows] - gaps_us[np.searchsorted(borders, rows, side="right")]
        return seen

    for part in _suspects(time_us, value, resolution, frozen_after_us):
        for step in _steps(value[part], resolution):
            begins = part.start + np.append(0, np.flatnonzero(step[1:] != step[:-1]) + 1)
            ends = np.append(begins[1:], part.stop)
            too_long = seen_us(ends - 1) - seen_us(begins) > frozen_after_us
            for begin, end in zip(begins[too_long], ends[too_long], strict=True):
                mask[begin:end] = True
    return mask


def _steps(value: Values, resolution: float) -> tuple[Values, ...]:
    """Return the steps of the sensor that values lie on, on each of two grids."""
    if resolution <= 0:
        return (value,)
    # Half a step between the borders of the two grids: less noise than that crosses only one.
    steps = value / resolution
    return np.floor(steps + 0.25), np.floor(steps + 0.75)


def _suspects(
    time_us: Times, value: Values, resolution: float, frozen_after_us: float
) -> list[slice]:
    """Return parts of the samples in which all stretches that last too long lie as a whole.

    Of marks half of such a time apart a stretch covers two in a row: few samples tell where it
    cannot.
    """
    n = len(value)
    span_us = int(time_us[-1] - time_us[0]) if n else 0
    if span_us <= frozen_after_us:
        return []
    half_us = int(frozen_after_us // 2)
    if span_us >= half_us * (n // LOOKED_AT_A_STRETCH):
        return [slice(0, n)]
    marks = np.arange(int(time_us[0]), int(time_us[-1]) + half_us, half_us)
    places = np.searchsorted(time_us, marks[1:])
    places = places[places < n]
    first, last = places[:-1] - 1, places[1:]
    alike = _alike(value, first, last, resolution, 2)
    alike[alike] = _alike(value, first[alike], last[alike], resolution, LOOKED_AT_A_STRETCH)
    pairs = stretches(alike)
    borders = [0, *places.tolist(), n]
    # From the mark before the first of a row of such pairs until that after the last.
    return [slice(borders[begin], borders[end + 2]) for begin, end in np.transpose(pairs).tolist()]


def _alike(
    value: Values,
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    resolution: float,
    looks: int,
) -> Mask:
    """Return pairs of places from the first to the second of which some samples lie on one step."""
    shares = np.arange(looks)[:, None]
    looked_at = value[first + (last - first) * shares // (looks - 1)]
    alike = np.zeros(len(first), dtype=np.bool_)
    for step in _steps(looked_at, resolution):
        alike |= (step == step[0]).all(axis=0)
    return alike


def near(events_us: Times, time_us: Times, before_us: float, after_us: float) -> Mask:
    """Return times within a guard time before or after any event; both increase."""
    # In whole microseconds, as the times are: others would have all of them converted.
    first = np.searchsorted(time_us, events_us - int(before_us), side="left")
    end = np.searchsorted(time_us, events_us + int(after_us), side="right")
    # Events whose guard times meet are a single stretch.
    apart = first[1:] > end[:-1]
    first = first[np.append(True, apart)[: len(first)]]
    end = end[np.append(apart, True)[: len(end)]]
    mask = np.zeros(len(time_us), dtype=np.bool_)
    for begin, stop in zip(first.tolist(), end.tolist(), strict=True):
        mask[begin:stop] = True
    return mask


def transient(value: Values, present: Mask, period_s: float, limit_per_s: float) -> Mask:
    """Return both ends of each change of a channel on the time base that is faster than a limit."""
    pairs = present[1:] & present[:-1]
    rate = np.zeros(len(pairs))
    rate[pairs] = np.abs(np.diff(value)[pairs]) / period_s
    fast = rate > (1.0 + ROUNDING) * limit_per_s
    mask = np.zeros(len(value), dtype=np.bool_)
    mask[1:] |= fast
    mask[:-1] |= fast
    return mask


# A count may be infinite, and two of them further apart than float64 reaches.
@np.errstate(over="ignore", invalid="ignore")
def flow_from_counts(
    time_us: Times,
    count: Values,
    longest_gap_us: float,
    volume_per_count_cm3: float,
    *,
    is_total: bool,
) -> tuple[Times, Values, dict[str, Mask]]:
    """Return times and flow [l/min] of a counter since each sample before, and masks by reason.

    `no_interval`: there is no known sample before; `counter_reset`: a total fell, reset or
    rolled over, which costs a sample. The flow is nan there.
    """
    steps = np.diff(time_us, prepend=time_us[:1])
    fresh, reset = count.astype(np.float64), np.zeros(len(count), dtype=np.bool_)
    unknown = steps > longest_gap_us
    unknown[:1] = True
    if is_total:
        fresh = np.diff(count, prepend=np.nan)
        reset = ~unknown & (fresh < 0)
        unknown |= np.isfinite(count) & np.isnan(fresh)
    known = ~(unknown | reset)
    flow = np.full(len(count), np.nan)
    flow[known] = fresh[known] * volume_per_count_cm3 / steps[known]
    middle = np.where(unknown, time_us, time_us - steps // 2)
    masks = {"no_interval": unknown, "counter_reset": reset}
    return middle, flow * CM3_PER_US_TO_L_PER_MIN, masks


def step_of_readings(value: Values) -> float:
    """Return the commonest change between neighbours, if it is common enough for a step; else 0."""
    apart = max(1, len(value) // PAIRS_LOOKED_AT)
    pairs = np.abs(value[1::apart] - value[:-1:apart])
    changes = pairs[pairs > 0]
    if not len(changes):
        return 0.0
    # Rounded to six digits: a conversion of units leaves some noise on equal steps.
    digits = 10.0 ** (np.floor(np.log10(changes)) - 5)
    steps, counts = np.unique(np.round(changes / digits) * digits, return_counts=True)
    commonest = int(np.argmax(counts))
    is_a_step = counts[commonest] >= max(STEP_SHARE * len(pairs), FEWEST_STEPS)
    return float(steps[commonest]) if is_a_step else 0.0

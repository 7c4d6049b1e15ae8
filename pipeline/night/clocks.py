"""Clocks of channels: offsets, jitter, and samples that were written out of their order.

A sample written late has the right stamp in the wrong row; a clock that was set back has the wrong
stamp. The two are told apart by whether the stamp falls into a free place among the others.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Mask, Times
from pipeline.night.masks import steps_where, stretches

# A place is free where no other sample lies nearer than this share of a period, and belongs to the
# log where one lies within this many periods.
FREE_SHARE = 0.75
NEAR_PERIODS = 5.0
# A step further than this share of a period from a whole number of periods is jitter.
JITTER_SHARE = 0.25
# Steps that a first guess at their median is made from.
LOOKED_AT = 1000


def typical_period_us(
    time_us: Times, left_out: Mask | None = None, found: tuple[float | None, int] | None = None
) -> float | None:
    """Median distance of consecutive samples [µs]; None for fewer than two.

    Of those not left out, where these are named; `found` as `period_and_alike` has it of all.
    """
    period, n_alike = found or period_and_alike(time_us)
    n_left_out = 0 if left_out is None else np.count_nonzero(left_out)
    if left_out is None or not n_left_out:
        return period
    # One left out takes two steps away and leaves one: it stays the median of a majority.
    if 2 * (n_alike - 2 * n_left_out) > len(time_us) - 1 - n_left_out:
        return period
    return period_and_alike(time_us[~left_out])[0]


def period_and_alike(time_us: Times) -> tuple[float | None, int]:
    """Typical period, and the number of steps of just that length.

    Most steps are alike: some tell which length that is, and a count proves it.
    """
    n = len(time_us) - 1
    if n < 1:
        return None, 0
    apart = max(1, n // LOOKED_AT)
    likely = int(np.median(time_us[1::apart] - time_us[:-1:apart]))
    n_alike = n - len(steps_where(lambda steps: steps != likely, time_us))
    if 2 * n_alike > n:
        return float(likely), n_alike
    steps = np.diff(time_us)
    period = _median(steps)
    return period, int(np.count_nonzero(steps == period))


def _median(steps: Times) -> float:
    """Exactly `numpy.median`, without its sorting of a million steps.

    Some of the steps tell between which two values the median should lie, and counts prove it.
    """
    n = len(steps)
    some = np.sort(steps[:: max(1, n // LOOKED_AT)])
    low, high = some[len(some) * 2 // 5], some[len(some) * 3 // 5]
    below, up_to = np.count_nonzero(steps < low), np.count_nonzero(steps <= high)
    middle = np.array([(n - 1) // 2, n // 2])
    if not below <= middle[0] <= middle[1] < up_to:
        return float(np.median(steps))
    between = steps[(steps >= low) & (steps <= high)]
    return float(np.partition(between, middle - below)[middle - below].mean())


def backward_time(time_us: Times) -> Mask:
    """Samples whose time does not fit an increasing clock.

    The fewest possible are named (all but a longest non-decreasing subsequence), so that a single
    stamp in the future does not refuse all that follow it.
    """
    mask = np.zeros(len(time_us), dtype=np.bool_)
    falls = steps_where(lambda steps: steps < 0, time_us) + 1
    if not len(falls):
        return mask
    # Between two falls stamps are in order: the latest before, and the earliest after each fall.
    latest = np.maximum.accumulate(time_us[falls - 1])
    earliest = np.minimum.accumulate(time_us[falls][::-1])[::-1]
    # A stamp in order with all others belongs to any longest subsequence: few are left to search.
    edges = [0, *falls.tolist(), len(time_us)]
    for begin, end, high in zip(edges[1:-1], edges[2:], latest, strict=True):
        mask[begin : begin + time_us[begin:end].searchsorted(high)] = True
    for begin, end, low in zip(edges[:-2], edges[1:-1], earliest, strict=True):
        mask[begin + time_us[begin:end].searchsorted(low, "right") : end] = True
    doubtful = np.flatnonzero(mask)
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
    mask, forward = np.zeros(len(time_us), dtype=np.bool_), ~backward
    again = steps_where(lambda steps: steps == 0, time_us[forward]) + 1
    if len(again):
        mask[np.flatnonzero(forward)[again]] = True
    return mask


def written_late(time_us: Times, backward: Mask) -> Mask:
    """Backward samples whose place among the others is free: they can be put back in order.

    Such are rows that a logger flushed late, and files whose names do not sort as their times do.
    A clock that was set back runs over times that are taken, and a row of samples of which one
    does so is no late one; a lone wrong stamp lies near nothing. Neither is restored.

    Examples
    --------
    >>> time = np.array([0, 10, 20, 40, 50, 30])
    >>> written_late(time, backward_time(time)).tolist()
    [False, False, False, False, False, True]
    """
    mask = np.zeros(len(time_us), dtype=np.bool_)
    period = typical_period_us(time_us, backward) if backward.any() else None
    if period is None:
        return mask
    rows = np.flatnonzero(backward)
    nearest = _distance_of_nearest(time_us, rows)
    mask[rows] = (nearest >= FREE_SHARE * period) & (nearest <= NEAR_PERIODS * period)
    for begin, end in zip(*stretches(backward), strict=True):
        mask[begin:end] = mask[begin:end].all()
    return mask


def stray_time(time_us: Times, late: Mask) -> Mask:
    """Rows that only seemed in order: beside one that goes back in its place, far from all others.

    Of two rows that contradict each other either may be named backward; where the other one goes
    back in order and this one lies near nothing, this one has the wrong stamp.
    """
    stray = np.zeros(len(time_us), dtype=np.bool_)
    period = typical_period_us(time_us, late) if late.any() else None
    if period is None:
        return stray
    beside = np.append(late[1:], False) | np.append(False, late[:-1])
    rows = np.flatnonzero(~late & beside)
    stray[rows] = _distance_of_nearest(time_us, rows) > NEAR_PERIODS * period
    return stray


def _distance_of_nearest(time_us: Times, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Distance of some stamps from the nearest of all others."""
    # Stable: the sort that is quick where most are in order.
    ordered, stamps = np.sort(time_us, kind="stable"), time_us[rows]
    before = np.searchsorted(ordered, stamps, side="left") - 1
    after = np.searchsorted(ordered, stamps, side="right")
    last = len(ordered) - 1
    earlier_us = np.where(before < 0, np.inf, stamps - ordered[np.maximum(before, 0)])
    later_us = np.where(after > last, np.inf, ordered[np.minimum(after, last)] - stamps)
    return np.where(after - before > 2, 0.0, np.minimum(earlier_us, later_us))


def jittered(time_us: Times, period_us: float | None) -> Mask:
    """Samples that come neither one nor several periods after the one before."""
    mask = np.zeros(len(time_us), dtype=np.bool_)
    if not period_us:
        return mask
    # Nearly all steps are of one period: only the others are worth a division.
    other = steps_where(lambda steps: steps != int(period_us), time_us)
    steps = time_us[other + 1] - time_us[other]
    whole = np.maximum(np.round(steps / period_us), 1.0)
    mask[other + 1] = np.abs(steps - whole * period_us) > JITTER_SHARE * period_us
    return mask

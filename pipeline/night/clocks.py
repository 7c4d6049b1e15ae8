"""Clocks of channels: offsets, jitter, and samples that were written out of their order.

A sample written late has the right stamp in the wrong row; a clock that was set back has the wrong
stamp. The two are told apart by whether the stamp falls into a free place among the others.
"""

from __future__ import annotations

from bisect import bisect_right
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Mask, Times
from pipeline.night.masks import steps_where

# A place is free where no other sample lies nearer than this share of a period, and belongs to the
# log where one lies within this many periods.
FREE_SHARE = 0.75
NEAR_PERIODS = 5.0
# A step further than this share of a period from a whole number of periods is jitter.
JITTER_SHARE = 0.25
# Steps that a first guess at their median is made from.
LOOKED_AT = 1000

# A step between stamps [µs], and the places of those of another length if these are not most.
LikelyStep = tuple[int, NDArray[np.intp] | None]


def typical_period_us(
    time_us: Times, left_out: Mask | None = None, likely: LikelyStep | None = None
) -> float | None:
    """Median distance of consecutive samples [µs]; None for fewer than two.

    Of those not left out, where these are named; `likely` as `likely_step` has it of all.
    """
    n_left_out = 0 if left_out is None else int(np.count_nonzero(left_out))
    n = len(time_us) - 1 - n_left_out
    if n < 1:
        return None
    step, others = likely or likely_step(time_us)
    # One left out takes two steps away and leaves one: it stays the median of a majority.
    if others is not None and 2 * (len(others) + n_left_out) < n:
        return float(step)
    steps = np.diff(time_us if left_out is None or not n_left_out else time_us[~left_out])
    # With one place, NumPy parts integers several times as fast as with the two of its median.
    steps.partition(n // 2)
    upper = float(steps[n // 2])
    return upper if n % 2 else (float(steps[: n // 2].max()) + upper) / 2


def likely_step(time_us: Times) -> LikelyStep:
    """Median of some of the steps, and the places of all others; None where these may be most.

    No median of all is needed where most are alike, which is where it takes longest.
    """
    n = len(time_us) - 1
    apart = max(1, n // LOOKED_AT)
    some = time_us[1::apart] - time_us[:-1:apart]
    step = int(np.median(some)) if n > 0 else 0
    if 2 * np.count_nonzero(some == step) <= len(some):
        return step, None
    return step, steps_where(lambda steps: steps != step, time_us)


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


def written_late(
    time_us: Times, backward: Mask, in_order: Times
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Backward samples that can be put back in order, and rows that only seemed to be in it.

    Those are put back whose place among the others is free: rows that a logger flushed late, and
    files whose names do not sort as their times do. A clock that was set back runs over times that
    are taken, and a row of samples of which one does so is no late one; a lone wrong stamp lies
    near nothing. Neither is restored. `in_order` are the stamps of all samples but the backward.
    """
    rows = np.flatnonzero(backward)
    period = typical_period_us(in_order) if len(rows) else None
    if period is None:
        return rows[:0], rows[:0]
    out_of_order = np.sort(time_us[rows])
    nearest = np.minimum(
        _distance_of_nearest(in_order, time_us[rows], own=0),
        _distance_of_nearest(out_of_order, time_us[rows], own=1),
    )
    fits = (nearest >= FREE_SHARE * period) & (nearest <= NEAR_PERIODS * period)
    first = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
    fits = np.logical_and.reduceat(fits, first).repeat(np.diff(first, append=len(rows)))
    late = rows[fits]
    # Of two rows that contradict each other either may be named backward; where that one goes back
    # in order and the one beside it lies near nothing, the latter has the wrong stamp.
    beside = np.union1d(late - 1, late + 1)
    beside = beside[(beside >= 0) & (beside < len(time_us))]
    beside = beside[~backward[beside]]
    nearest = np.minimum(
        _distance_of_nearest(in_order, time_us[beside], own=1),
        _distance_of_nearest(out_of_order, time_us[beside], own=0),
    )
    return late, beside[nearest > NEAR_PERIODS * period]


def _distance_of_nearest(ordered: Times, stamps: Times, *, own: int) -> NDArray[np.float64]:
    """Distance of some stamps from the nearest of others, among which each is `own` times."""
    before = np.searchsorted(ordered, stamps, side="left") - 1
    after = np.searchsorted(ordered, stamps, side="right")
    last = len(ordered) - 1
    earlier_us = np.where(before < 0, np.inf, stamps - ordered[np.maximum(before, 0)])
    later_us = np.where(after > last, np.inf, ordered[np.minimum(after, last)] - stamps)
    return np.where(after - before > 1 + own, 0.0, np.minimum(earlier_us, later_us))


def n_jittered(
    time_us: Times, period_us: float | None, others: NDArray[np.intp] | None = None
) -> int:
    """Number of samples that come neither one nor several periods after the one before.

    `others` are the places of all steps that are not one period long, where these are known.
    """
    if not period_us:
        return 0
    limit = JITTER_SHARE * period_us
    if others is None:
        # Nearly all come after one period: only the others are worth a division.
        low, high = ceil(period_us - limit), floor(period_us + limit)
        others = steps_where(lambda steps: (steps < low) | (steps > high), time_us)
    steps = time_us[others + 1] - time_us[others]
    whole = np.maximum(np.round(steps / period_us), 1.0)
    return int(np.count_nonzero(np.abs(steps - whole * period_us) > limit))

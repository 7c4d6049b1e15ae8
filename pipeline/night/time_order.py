"""Cells of a channel in the order of time, and how regular they are.

A sample written late has the right stamp in the wrong row; a clock that was set back has the wrong
stamp. The two are distinguished by whether the stamp falls into a free place among the others.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Mask, Times
from pipeline.night.masks import NO_BORDERS, steps_where

# A place is free where no other sample lies nearer than this share of a period, and belongs to the
# log where any lies within this many periods.
FREE_SHARE = 0.75
NEAR_PERIODS = 5.0
# A step further than this share of a period from a whole number of periods is jitter.
JITTER_SHARE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """Rows in strict order of time."""

    rows: NDArray[np.intp] | slice  # those that are kept, in order
    time_us: Times  # their stamps
    # late, backward, repeated: rows put back in order, and those left out as backward and as
    # duplicates.
    late: NDArray[np.intp]
    backward: NDArray[np.intp]
    repeated: NDArray[np.intp]


def order_of(time_us: Times) -> Order:
    """Order rows strictly by time.

    Examples
    --------
    >>> order = order_of(np.array([0, 10, 20, 40, 50, 30, 50]))
    >>> order.rows.tolist(), order.late.tolist(), order.repeated.tolist()
    ([0, 1, 2, 5, 3, 4], [5], [6])
    """
    late = np.empty(0, dtype=np.intp)
    if not len(steps_where(lambda steps_us: steps_us <= 0, time_us)):
        return Order(slice(None), time_us, late, late, late)
    chosen = ~backward_time(time_us)
    late, stray = written_late(time_us, ~chosen, time_us[chosen])
    chosen[late], chosen[stray] = True, False
    rows = np.flatnonzero(chosen)
    if len(late):
        rows = rows[np.argsort(time_us[rows], kind="stable")]
    again = steps_where(lambda steps_us: steps_us == 0, time_us[rows]) + 1
    once = np.delete(rows, again)
    return Order(once, time_us[once], late, np.flatnonzero(~chosen), rows[again])


def order_once() -> Callable[[Times], Order]:
    """Return `order_of` that remembers the stamps before: channels of a table have the same.

    A clock that was set back takes a day at 10 Hz 20 ms, and an array of its own.
    """
    last: list[tuple[Times, Order]] = []

    def order(time_us: Times) -> Order:
        if not last or not np.array_equal(last[0][0], time_us):
            last[:] = [(time_us, order_of(time_us))]
        return last[0][1]

    return order


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Distances of consecutive stamps, most of which are alike."""

    period_us: float | None  # their median [µs]; None for fewer than two stamps
    uneven: NDArray[np.intp]  # places of the steps of another length

    @classmethod
    def of(cls, time_us: Times) -> Steps:
        """Return the steps of increasing stamps, shape (n,)."""
        if len(time_us) < 2:
            return cls(None, NO_BORDERS)
        median = float(np.median(np.diff(time_us)))
        return cls(median, steps_where(lambda steps_us: steps_us != median, time_us))

    def with_period(self, time_us: Times) -> Steps:
        """Return the steps of other stamps beside the same period."""
        if self.period_us is None:
            return replace(self, uneven=np.arange(len(time_us) - 1))
        return replace(
            self, uneven=steps_where(lambda steps_us: steps_us != self.period_us, time_us)
        )

    def longer_than(self, limit_us: float, time_us: Times) -> NDArray[np.intp]:
        """Return the places of the steps beyond a limit [µs]; the stamps are those of the steps."""
        if self.period_us is not None and self.period_us > limit_us:
            return steps_where(lambda steps_us: steps_us > limit_us, time_us)
        long: Mask = time_us[self.uneven + 1] - time_us[self.uneven] > limit_us
        return self.uneven[long]

    def n_jittered(self, time_us: Times) -> int:
        """Return how many samples come neither one nor several periods after that before."""
        if not self.period_us:
            return 0
        steps = time_us[self.uneven + 1] - time_us[self.uneven]
        whole = np.maximum(np.round(steps / self.period_us), 1.0)
        jitter = np.abs(steps - whole * self.period_us) > JITTER_SHARE * self.period_us
        return int(np.count_nonzero(jitter))


def backward_time(time_us: Times) -> Mask:
    """Return the fewest samples without which the clock increases."""
    mask = np.zeros(len(time_us), dtype=np.bool_)
    falls = steps_where(lambda steps_us: steps_us < 0, time_us) + 1
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
    """Return places of a longest non-decreasing subsequence (patience sorting)."""
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
    """Return backward samples that go back in order, and rows that only seemed to be in it.

    A row that a logger flushed late has a free place among the others. A clock that was set back
    runs over times that are taken, and a row of samples of which any does so is not late; a lone
    wrong stamp lies near nothing.
    """
    rows = np.flatnonzero(backward)
    period = Steps.of(in_order).period_us if len(rows) else None
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
    """Return distance of some stamps from the nearest of others, each there `own` times."""
    before = np.searchsorted(ordered, stamps, side="left") - 1
    after = np.searchsorted(ordered, stamps, side="right")
    last = len(ordered) - 1
    earlier_us = np.where(before < 0, np.inf, stamps - ordered[np.maximum(before, 0)])
    later_us = np.where(after > last, np.inf, ordered[np.minimum(after, last)] - stamps)
    return np.where(after - before > 1 + own, 0.0, np.minimum(earlier_us, later_us))

"""Cells of a channel in the order of time, and which of them are samples."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Mask, Times
from pipeline.ingest import RawChannel
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.clocks import (
    LikelyStep,
    backward_time,
    likely_step,
    n_jittered,
    typical_period_us,
    written_late,
)
from pipeline.night.masks import missing_sample, steps_where

Found = TypeVar("Found")
LATEST_US = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True)
class Disorder:
    """Samples, blank cells aside, that were out of order."""

    n_put_back: int
    n_backward: int
    n_duplicate: int


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """Rows in strict order of time."""

    time_us: Times  # stamps of the rows that are kept, in order
    rows: NDArray[np.intp] | Mask | None  # which these are; None: all, as they are
    # late, backward, repeated: rows put back in order, and those left out as backward and as
    # duplicates.
    late: NDArray[np.intp]
    backward: NDArray[np.intp]
    repeated: NDArray[np.intp]


class Stamps:
    """Findings about arrays of stamps: channels of one table share one, looked through once.

    Nobody changes an array that it was asked of.
    """

    def __init__(self) -> None:
        # With the stamps themselves: while they are here, nothing else has their address.
        self._known: dict[Hashable, tuple[Times, object]] = {}

    def order(self, time_us: Times, *, puts_in_order: bool) -> Order:
        """As `order_of`."""
        return self.once(
            time_us, puts_in_order, lambda: order_of(time_us, puts_in_order=puts_in_order)
        )

    def earliest_us(self, time_us: Times) -> int:
        """The smallest stamp; the largest number there is where there is none."""
        return self.once(time_us, "earliest", lambda: int(time_us.min(initial=LATEST_US)))

    def period_us(self, time_us: Times, blank: Mask | None = None) -> float | None:
        """As `typical_period_us`, of the stamps whose cells are not blank."""
        likely = self._likely_step(time_us)
        if blank is not None and blank.any():
            return typical_period_us(time_us, blank, likely)
        return self.once(time_us, "period", lambda: typical_period_us(time_us, None, likely))

    def other_steps(self, time_us: Times, period_us: float | None) -> NDArray[np.intp] | None:
        """Places of the steps that are not one period long; None where these may be most."""
        step, others = self._likely_step(time_us)
        return others if step == period_us else None

    def n_jittered(self, time_us: Times, period_us: float | None) -> int:
        """As `n_jittered`."""
        others = self.other_steps(time_us, period_us)
        return self.once(
            time_us, ("jitter", period_us), lambda: n_jittered(time_us, period_us, others)
        )

    def _likely_step(self, time_us: Times) -> LikelyStep:
        return self.once(time_us, "likely step", lambda: likely_step(time_us))

    def steps_over(self, time_us: Times, limit_us: float) -> NDArray[np.intp]:
        """Places of the steps that are longer than a limit."""
        # In whole microseconds, as the steps are: else all of them would be converted.
        whole = int(limit_us)
        return self.once(
            time_us, ("over", whole), lambda: steps_where(lambda steps: steps > whole, time_us)
        )

    def once(self, time_us: Times, what: Hashable, find: Callable[[], Found]) -> Found:
        """Result of `find` for some stamps, under a name; `find` is called once."""
        key = (time_us.ctypes.data, len(time_us), what)
        if key not in self._known:
            self._known[key] = time_us, find()
        return cast(Found, self._known[key][1])


def order_of(time_us: Times, *, puts_in_order: bool) -> Order:
    """Order rows strictly by time.

    Examples
    --------
    >>> found = order_of(np.array([0, 10, 20, 40, 50, 30, 50]), puts_in_order=True)
    >>> found.rows.tolist(), found.late.tolist(), found.repeated.tolist()
    ([0, 1, 2, 5, 3, 4], [5], [6])
    """
    if bool((time_us[1:] > time_us[:-1]).all()):
        return Order(time_us, None, *[np.empty(0, dtype=np.intp)] * 3)
    chosen = ~backward_time(time_us)
    rows, ordered = np.flatnonzero(chosen), time_us[chosen]
    late = np.empty(0, dtype=np.intp)
    if puts_in_order:
        late, stray = written_late(time_us, ~chosen, ordered)
    if len(late):
        chosen[late], chosen[stray] = True, False
        rows = np.flatnonzero(chosen)
        rows = rows[np.argsort(time_us[rows], kind="stable")]
        ordered = time_us[rows]
    backward = np.flatnonzero(~chosen)
    again = steps_where(lambda steps: steps == 0, ordered) + 1
    repeated = rows[again]
    # As marks where they may be, which take an eighth of the memory.
    chosen[repeated] = False
    kept = np.delete(rows, again) if len(late) else chosen
    return Order(np.delete(ordered, again), kept, late, backward, repeated)


def in_order(raw: RawChannel, rules: ChannelRules, stamps: Stamps) -> tuple[RawChannel, Disorder]:
    """Cells in strict order of their corrected time, and what it took."""
    order = stamps.order(raw.time_us, puts_in_order=rules.puts_in_order)
    disorder = Disorder(
        *(
            int(np.count_nonzero(~raw.missing[rows]))
            for rows in (order.late, order.backward, order.repeated)
        )
    )
    cells = raw if order.rows is None else raw.rows(order.rows, order.time_us)
    return _corrected(cells, rules), disorder


def _corrected(raw: RawChannel, rules: ChannelRules) -> RawChannel:
    """Samples at the times at which they hold."""
    if not rules.sampling.shift_us:
        return raw
    return replace(raw, time_us=raw.time_us + rules.sampling.shift_us)


def samples_of(
    cells: RawChannel, rules: ChannelRules, period_us: float | None, stamps: Stamps
) -> RawChannel:
    """Cells in order without the blank ones that are no sample."""
    if rules.sampling.on_change:
        samples = _says_something(cells, rules)
    elif cells.missing.any():
        row_us = stamps.period_us(cells.time_us)
        samples = ~cells.missing
        samples |= missing_sample(cells.time_us, cells.missing, period_us, row_us)
    else:
        return cells
    return cells if samples.all() else cells.rows(samples)


def _says_something(cells: RawChannel, rules: ChannelRules) -> Mask:
    """Cells of an on-change channel that hold a value, or say that there is none."""
    if rules.has_rows_of_its_own:
        return np.ones(len(cells.time_us), dtype=np.bool_)
    says: Mask = ~cells.missing
    return says if cells.bad_quality is None else says | cells.bad_quality


def carried_over(early: RawChannel, rules: ChannelRules, earliest_us: float) -> RawChannel:
    """The last sample of an on-change channel before the night, if it may hold into it; or none."""
    says = _says_something(early, rules) & (early.time_us >= earliest_us)
    rows = np.flatnonzero(says) if rules.sampling.on_change else np.empty(0, np.intp)
    # Of two at one time the first one counts, as within the night.
    last = rows[[np.argmax(early.time_us[rows])]] if len(rows) else rows
    return _corrected(early.rows(last), rules)

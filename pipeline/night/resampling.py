"""A channel's values on the time base.

Slower channels are interpolated linearly, never across a gap or a refused sample; faster ones are
averaged over a cell of the grid.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Mask, Times, Values
from pipeline.night.cleaning import CleanChannel
from pipeline.night.masks import CACHED, steps_where

# A channel with more than this many samples a cell of the grid is averaged, not interpolated.
AVERAGE_ABOVE = 1.5
# Share of a cell's samples that must be kept for its average.
CELL_SHARE = 0.5
# A mean stands for this share of its period on either side; half, and some for jitter.
MEAN_REACH = 0.6
# Times of the grid from which on samples in equal steps are worth a look of their own.
EVEN_PLACES = 1000


class OnGrid(NamedTuple):
    """A channel on the time base: values, where it has one, and where it is silent; (n,) each."""

    value: Values
    present: Mask
    silent: Mask


def on_grid(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """A channel on an even grid."""
    n = len(grid_us)
    if not n or not len(channel.time_us):
        return OnGrid(np.full(n, np.nan), np.zeros(n, np.bool_), np.ones(n, np.bool_))
    if channel.sampling.hold:
        return _held(channel, grid_us)
    if channel.sampling.mean_us > 0:
        return _mean_of_its_period(channel, grid_us)
    on_change = channel.sampling.on_change
    if channel.period_us and not on_change and channel.period_us * AVERAGE_ABOVE < period_us:
        return _averaged(channel, grid_us, period_us)
    return _interpolated(channel, grid_us, period_us)


# A refused value may be infinite.
@np.errstate(over="ignore", invalid="ignore")
def _interpolated(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """Samples as they are at their own times, and lines between them; not beside a refused one."""
    n, time = len(grid_us), channel.time_us
    # A zero has no sign here, at samples as between them.
    known = channel.value + 0.0
    known[channel.refused] = np.nan
    value = np.empty(n)
    stretches = _even_stretches(channel, grid_us, period_us)
    for even in stretches:
        _fill_even(value, known, even)
    begins = [0, *(even.place + even.n * even.apart for even in stretches)]
    ends = [*(even.place for even in stretches), n]
    for begin, end in zip(begins, ends, strict=True):
        for first in range(begin, end, CACHED):
            some = slice(first, min(first + CACHED, end))
            left, right = time.searchsorted(grid_us[[some.start, some.stop - 1]]).tolist()
            around = slice(max(left - 1, 0), right + 1)
            value[some] = np.interp(
                grid_us[some], time[around], known[around], left=np.nan, right=np.nan
            )
    silent = np.zeros(n, np.bool_)
    for begin, end in _silences(channel, grid_us):
        value[begin:end], silent[begin:end] = np.nan, True
    return OnGrid(value, np.isfinite(value), silent)


def _silences(channel: CleanChannel, grid_us: Times) -> Iterator[tuple[int, int]]:
    """Times before the first sample, within gaps between two, and after the last."""
    time, others, longest_gap_us = channel.time_us, channel.other_steps, channel.longest_gap_us
    if others is None or (channel.period_us or 0) > longest_gap_us:
        gaps = steps_where(lambda steps: steps > longest_gap_us, time)
    else:
        gaps = others[time[others + 1] - time[others] > longest_gap_us]
    if channel.ends is not None:
        gaps = np.union1d(gaps, np.flatnonzero(channel.ends[:-1]))
    begins = grid_us.searchsorted([*time[gaps], time[-1]], "right").tolist()
    ends = grid_us.searchsorted([time[0], *time[gaps + 1]]).tolist()
    return zip([0, *begins], [*ends, len(grid_us)], strict=True)


class _Even(NamedTuple):
    """Samples in equal steps, each at a time of the grid."""

    first: int  # the first sample
    n: int  # steps from it to the last
    place: int  # of the first sample on the grid
    apart: int  # places to the next one


def _even_stretches(channel: CleanChannel, grid_us: Times, period_us: int) -> list[_Even]:
    """Long stretches of a channel whose typical step is one of the grid's or several; in order."""
    time, step = channel.time_us, int(channel.period_us or 0)
    apart, beside = divmod(step, period_us)
    others, within = channel.other_steps, step <= channel.longest_gap_us
    if others is None or not apart or beside or not within or channel.ends is not None:
        return []
    edges = np.concatenate([[-1], others, [len(time) - 1]])
    found = []
    for run in np.flatnonzero(apart * np.diff(edges) > EVEN_PLACES).tolist():
        first, last = int(edges[run]) + 1, int(edges[run + 1])
        place, beside = divmod(int(time[first] - grid_us[0]), period_us)
        before = max(0, -(place // apart))
        n = min(last - first, (len(grid_us) - place) // apart) - before
        if not beside and n > 0:
            found.append(_Even(first + before, n, place + before * apart, apart))
    return found


def _fill_even(found: Values, known: Values, even: _Even) -> None:
    """From the first sample of a stretch until before the last."""
    first, n, place, apart = even
    value = found[place : place + n * apart].reshape(n, apart)
    left, right = known[first : first + n], known[first + 1 : first + n + 1]
    if apart > 1:
        # Lines some at a time, and their points by shares: the array's own rows are short.
        shares = np.arange(apart)[:, None] / apart
        for begin in range(0, n, CACHED // apart + 1):
            some = slice(begin, begin + CACHED // apart + 1)
            value[some] = (left[some] + shares * (right[some] - left[some])).T
    value[:, 0] = left


def _held(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """The last sample, while it is not older than the longest silence; none after a refused one."""
    last = np.searchsorted(channel.time_us, grid_us, side="right") - 1
    known, last = last >= 0, np.maximum(last, 0)
    silent = ~known | (grid_us - channel.time_us[last] > channel.longest_gap_us)
    if channel.ends is not None:
        silent |= channel.ends[last] & (channel.time_us[last] < grid_us)
    present = ~silent & ~channel.refused[last]
    return OnGrid(np.where(present, channel.value[last], np.nan), present, silent)


def _mean_of_its_period(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """The mean in whose period a time lies: interpolated means would be averaged once more."""
    time = channel.time_us
    right = np.minimum(np.searchsorted(time, grid_us), len(time) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(grid_us - time[left] < time[right] - grid_us, left, right)
    reach = MEAN_REACH * channel.sampling.mean_us
    silent = np.abs(grid_us - time[nearest]) > reach
    present = ~silent & ~channel.refused[nearest]
    return OnGrid(np.where(present, channel.value[nearest], np.nan), present, silent)


def _averaged(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    n = len(grid_us)
    cell = (channel.time_us - grid_us[0] + period_us // 2) // period_us
    within = (cell >= 0) & (cell < n)
    chosen = within & ~channel.refused
    kept = np.bincount(cell[chosen], minlength=n)
    total = np.bincount(cell[chosen], weights=channel.value[chosen], minlength=n)
    assert channel.period_us is not None
    present = kept >= CELL_SHARE * period_us / channel.period_us
    result = np.full(n, np.nan)
    result[present] = total[present] / kept[present]
    silent = np.bincount(cell[within], minlength=n) == 0
    return OnGrid(result, present, silent)

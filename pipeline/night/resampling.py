"""A channel's values on the time base.

Slower channels are interpolated linearly, never across a gap or a refused sample; faster ones are
averaged over a cell of the grid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Mask, Times, Values
from pipeline.night.cleaning import CleanChannel
from pipeline.night.masks import CACHED

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


# A refused value may be infinite, and after the last sample there is no distance.
@np.errstate(over="ignore", invalid="ignore")
def _interpolated(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """Samples as they are at their own times, and lines between them; not beside a refused one."""
    n, kept, time = len(grid_us), ~channel.refused, channel.time_us
    found = OnGrid(np.empty(n), np.zeros(n, np.bool_), np.ones(n, np.bool_))
    begin, end = int(grid_us.searchsorted(time[0])), int(grid_us.searchsorted(time[-1], "right"))
    found.silent[begin:end] = False
    stretches = _even_stretches(channel, grid_us, period_us)
    if not stretches:
        for first in range(begin, end, CACHED):
            some = slice(first, min(first + CACHED, end))
            left = _counted(time, grid_us[some], period_us)
            _fill(found, some, channel, kept, grid_us[some], left)
    else:
        for even in stretches:
            _fill_even(found, channel, kept, even)
        begins = [begin, *(even.place + even.n * even.apart for even in stretches)]
        ends = [*(even.place for even in stretches), end]
        rest = np.concatenate([np.arange(*pair) for pair in zip(begins, ends, strict=True)])
        for first in range(0, len(rest), CACHED):
            places = rest[first : first + CACHED]
            left = time.searchsorted(grid_us[places], "right") - 1
            _fill(found, places, channel, kept, grid_us[places], left)
    found.value[~found.present] = np.nan
    return found


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


def _fill_even(found: OnGrid, channel: CleanChannel, kept: Mask, even: _Even) -> None:
    """From the first sample of a stretch until before the last."""
    first, n, place, apart = even
    value, present, _ = (part[place : place + n * apart].reshape(n, apart) for part in found)
    left, right = channel.value[first : first + n], channel.value[first + 1 : first + n + 1]
    if apart > 1:
        # Lines some at a time, and their points by shares: the array's own rows are short.
        shares = np.arange(apart)[:, None] / apart
        for begin in range(0, n, CACHED // apart + 1):
            some = slice(begin, begin + CACHED // apart + 1)
            value[some] = (left[some] + shares * (right[some] - left[some])).T
        present[:] = (kept[first : first + n] & kept[first + 1 : first + n + 1])[:, None]
    # A zero has no sign here, as between two samples.
    np.add(left, 0.0, out=value[:, 0])
    present[:, 0] = kept[first : first + n]


def _counted(time_us: Times, grid_us: Times, period_us: int) -> NDArray[np.intp]:
    """The last sample at or before each of some times in a row, none before the first sample."""
    first, last = time_us.searchsorted(grid_us[[0, -1]], "right").tolist()
    due = -((grid_us[0] - time_us[first:last]) // period_us)
    passed = np.bincount(due, minlength=len(grid_us))
    passed[0] = first - 1
    return np.cumsum(passed)


def _fill(
    found: OnGrid,
    some: slice | NDArray[np.intp],
    channel: CleanChannel,
    kept: Mask,
    grid_us: Times,
    left: NDArray[np.intp],
) -> None:
    """Some times, each with the last sample at or before it."""
    right = np.minimum(left + 1, len(channel.time_us) - 1)
    before, value = channel.time_us[left], channel.value[left]
    since_us, distance_us = grid_us - before, channel.time_us[right] - before
    asleep = distance_us > channel.longest_gap_us
    if channel.ends is not None:
        asleep |= channel.ends[left]
    line = value + since_us / distance_us * (channel.value[right] - value)
    present = kept[left] & kept[right] & ~asleep
    at = np.flatnonzero(since_us == 0)
    line[at], present[at], asleep[at] = value[at] + 0.0, kept[left[at]], False
    found.value[some], found.present[some], found.silent[some] = line, present, asleep


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

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
from pipeline.night.masks import CACHED, steps_where

# A channel with more than this many samples a cell of the grid is averaged, not interpolated.
AVERAGE_ABOVE = 1.5
# Share of a cell's samples that must be kept for its average.
CELL_SHARE = 0.5
# A mean stands for this share of its period on either side; half, and some for jitter.
MEAN_REACH = 0.6
# Times of the grid from which on samples in equal steps are worth a look of their own.
EVEN_PLACES = 4096


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
    n, kept = len(grid_us), ~channel.refused
    found = OnGrid(np.empty(n), np.empty(n, np.bool_), np.zeros(n, np.bool_))
    stretches = _even_stretches(channel, grid_us, period_us)
    for even in stretches:
        _fill_even(found, channel, kept, even)
    begins = [0, *(even.place + even.n * even.apart for even in stretches)]
    ends = [*(even.place for even in stretches), n]
    for begin, end in zip(begins, ends, strict=True):
        for first in range(begin, end, CACHED):
            some = slice(first, min(first + CACHED, end))
            piece = OnGrid(found.value[some], found.present[some], found.silent[some])
            _fill(piece, channel, kept, grid_us[some], period_us)
    found.value[~found.present] = np.nan
    return found


class _Even(NamedTuple):
    """Samples in equal steps, each at a time of the grid.

    Attributes
    ----------
    first, n
        The first sample, and steps from it to the last.
    place, apart
        Place of the first sample on the grid, and places to the next one.
    """

    first: int
    n: int
    place: int
    apart: int


def _even_stretches(channel: CleanChannel, grid_us: Times, period_us: int) -> list[_Even]:
    """Long stretches of a channel whose typical step is one of the grid's or several; in order."""
    time, step = channel.time_us, int(channel.period_us or 0)
    apart = step // period_us
    if not apart or step % period_us or step > channel.longest_gap_us or channel.ends is not None:
        return []
    others = steps_where(lambda steps: steps != step, time)
    if 2 * len(others) > len(time):
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
    left, right = slice(first, first + n), slice(first + 1, first + n + 1)
    # A zero has no sign here, as between two samples.
    np.add(channel.value[left], 0.0, out=value[:, 0])
    present[:, 0] = kept[left]
    if apart > 1:
        rise = channel.value[right] - channel.value[left]
        np.multiply(np.arange(1, apart) / apart, rise[:, None], out=value[:, 1:])
        value[:, 1:] += channel.value[left, None]
        present[:, 1:] = (kept[left] & kept[right])[:, None]


def _fill(found: OnGrid, channel: CleanChannel, kept: Mask, grid_us: Times, period_us: int) -> None:
    """Any part of the grid."""
    first, last = channel.time_us.searchsorted(grid_us[[0, -1]]).tolist()
    around = slice(max(first - 1, 0), last + 1)
    time, kept = channel.time_us[around], kept[around]
    value = np.where(kept, channel.value[around], 0.0)
    # Of each sample and the next one; there is none after the last.
    distance_us, rise = np.append(np.diff(time), 1), np.append(np.diff(value), 0.0)
    asleep = distance_us > channel.longest_gap_us
    if channel.ends is not None:
        asleep |= channel.ends[around]
    asleep[-1] = True
    both = kept & np.append(kept[1:], False) & ~asleep
    # The sample at or before each time; before the first one as after the last.
    due = np.clip(-((grid_us[0] - time) // period_us), 0, len(grid_us))
    left = np.cumsum(np.bincount(due, minlength=len(grid_us) + 1)[:-1]) - 1
    since_us = grid_us - time[left]
    at = np.flatnonzero(since_us == 0)
    found.value[:] = value[left] + since_us / distance_us[left] * rise[left]
    found.present[:], found.silent[:] = both[left], asleep[left]
    found.present[at], found.silent[at] = kept[left[at]], False


def _held(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """The last sample, while it is not older than the longest silence; none after a refused one."""
    last = np.searchsorted(channel.time_us, grid_us, side="right") - 1
    known, last = last >= 0, np.maximum(last, 0)
    silent = ~known | (grid_us - channel.time_us[last] > channel.longest_gap_us)
    silent |= _ended(channel, last, grid_us)
    present = ~silent & ~channel.refused[last]
    return OnGrid(np.where(present, channel.value[last], np.nan), present, silent)


def _ended(channel: CleanChannel, last: NDArray[np.intp], grid_us: Times) -> Mask:
    """Times behind a sample which says that there is no value from there on."""
    if channel.ends is None:
        return np.zeros(len(grid_us), dtype=np.bool_)
    ended: Mask = channel.ends[last] & (channel.time_us[last] < grid_us)
    return ended


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
    chosen = ~channel.refused & (cell >= 0) & (cell < n)
    kept = np.bincount(cell[chosen], minlength=n)
    total = np.bincount(cell[chosen], weights=channel.value[chosen], minlength=n)
    assert channel.period_us is not None
    present = kept >= CELL_SHARE * period_us / channel.period_us
    result = np.full(n, np.nan)
    result[present] = total[present] / kept[present]
    within = (cell >= 0) & (cell < n)
    silent = np.bincount(cell[within], minlength=n) == 0
    return OnGrid(result, present, silent)

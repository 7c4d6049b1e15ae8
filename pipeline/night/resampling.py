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
from pipeline.night.time_order import Stamps

# A channel with more than this many samples a cell of the grid is averaged, not interpolated.
AVERAGE_ABOVE = 1.5
# Share of a cell's samples that must be kept for its average.
CELL_SHARE = 0.5
# A mean stands for this share of its period on either side; half, and some for jitter.
MEAN_REACH = 0.6
# Equal steps in a row from which on they are worth a look of their own.
EVEN_STEPS = 256
# Samples are counted, not searched for, where more than one of so many times of the grid needs one.
COUNTED_ABOVE = 4


class OnGrid(NamedTuple):
    """A channel on the time base: values, where it has one, and where it is silent; (n,) each."""

    value: Values
    present: Mask
    silent: Mask


def on_grid(
    channel: CleanChannel, grid_us: Times, period_us: int, stamps: Stamps | None = None
) -> OnGrid:
    """A channel on an even grid; channels that share their stamps share `stamps`."""
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
    time = channel.time_us
    places = (stamps or Stamps()).once(time, "places", lambda: _Places.of(time, grid_us, period_us))
    return _interpolated(channel, grid_us, period_us, places)


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


class _Places(NamedTuple):
    """Places of samples on a grid.

    Attributes
    ----------
    even
        Stretches of samples in equal steps on the grid.
    others
        Times of the grid outside of these.
    left
        The sample at or before each of the others; -1 where there is none.
    """

    even: list[_Even]
    others: NDArray[np.intp]
    left: NDArray[np.intp]

    @classmethod
    def of(cls, time_us: Times, grid_us: Times, period_us: int) -> _Places:
        """Places of strictly increasing samples."""
        even = _even_stretches(time_us, grid_us, period_us)
        other = np.ones(len(grid_us), dtype=np.bool_)
        for one in even:
            other[one.place : one.place + one.n * one.apart + 1] = False
        others = np.flatnonzero(other)
        return cls(even, others, _at_or_before(time_us, grid_us, period_us, others))


def _at_or_before(
    time_us: Times, grid_us: Times, period_us: int, places: NDArray[np.intp]
) -> NDArray[np.intp]:
    """The last sample at or before some places of a grid; -1 where there is none."""
    if COUNTED_ABOVE * len(places) < len(grid_us):
        return np.searchsorted(time_us, grid_us[places], side="right") - 1
    due = np.clip(-((grid_us[0] - time_us) // period_us), 0, len(grid_us))
    found: NDArray[np.intp] = np.cumsum(np.bincount(due, minlength=len(grid_us)))[places] - 1
    return found


def _even_stretches(time_us: Times, grid_us: Times, period_us: int) -> list[_Even]:
    steps = np.diff(time_us)
    changes = np.flatnonzero(steps[1:] != steps[:-1]) + 1
    edges = np.concatenate([[0], changes, [len(steps)]])
    found = []
    for run in np.flatnonzero(np.diff(edges) >= EVEN_STEPS).tolist():
        first, end = int(edges[run]), int(edges[run + 1])
        apart, rest = divmod(int(steps[first]), period_us)
        place, beside = divmod(int(time_us[first] - grid_us[0]), period_us)
        if rest or beside:
            continue
        before = max(0, -(place // apart))
        n = min(end - first, (len(grid_us) - 1 - place) // apart) - before
        if n > 0:
            found.append(_Even(first + before, n, place + before * apart, apart))
    return found


# A refused value may be infinite.
@np.errstate(over="ignore", invalid="ignore")
def _interpolated(channel: CleanChannel, grid_us: Times, period_us: int, places: _Places) -> OnGrid:
    n, kept = len(grid_us), ~channel.refused
    found = OnGrid(np.empty(n), np.empty(n, np.bool_), np.zeros(n, np.bool_))
    for even in places.even:
        _fill_even(found, channel, kept, period_us, even)
    for begin in range(0, len(places.others), CACHED):
        some = slice(begin, begin + CACHED)
        _fill(found, channel, kept, grid_us, places.others[some], places.left[some])
    found.value[~found.present] = np.nan
    return found


def _fill_even(
    found: OnGrid, channel: CleanChannel, kept: Mask, period_us: int, even: _Even
) -> None:
    """Samples as they are at their places, and lines between them."""
    first, n, place, apart = even
    samples = slice(first, first + n + 1)
    at = slice(place, place + n * apart + 1, apart)
    np.add(channel.value[samples], 0.0, out=found.value[at])
    found.present[at] = kept[samples]
    if apart == 1:
        return
    left, right = slice(first, first + n), slice(first + 1, first + n + 1)
    value, present, silent = (
        part[place : place + n * apart].reshape(n, apart)[:, 1:] for part in found
    )
    rise = channel.value[right] - channel.value[left]
    np.multiply(np.arange(1, apart) / apart, rise[:, None], out=value)
    value += channel.value[left, None]
    asleep = np.full(n, apart * period_us > channel.longest_gap_us)
    if channel.ends is not None:
        asleep |= channel.ends[left]
    silent[:] = asleep[:, None]
    present[:] = (kept[left] & kept[right] & ~asleep)[:, None]


def _fill(
    found: OnGrid,
    channel: CleanChannel,
    kept: Mask,
    grid_us: Times,
    places: NDArray[np.intp],
    left: NDArray[np.intp],
) -> None:
    """Lines between the samples on either side of some places."""
    time, value, last = channel.time_us, channel.value, len(channel.time_us) - 1
    outside, left = left < 0, np.maximum(left, 0)
    since_us = grid_us[places] - time[left]
    between = since_us > 0
    # Outside of the samples there is nothing to hold.
    outside |= between & (left == last)
    right = np.minimum(left + between, last)
    distance_us = time[right] - time[left]
    asleep = outside | (distance_us > channel.longest_gap_us)
    if channel.ends is not None:
        asleep |= channel.ends[left] & between
    share = since_us / np.maximum(distance_us, 1)
    found.value[places] = value[left] + share * (value[right] - value[left])
    found.present[places] = kept[left] & kept[right] & ~asleep
    found.silent[places] = asleep


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

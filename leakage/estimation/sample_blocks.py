"""Blocks of samples on the clock, and which train or validate.

The split is decided on the short blocks, before neighbours are merged for storage; smoothing never
crosses a block's border, so blocks do not depend on the split.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Mask

Times = NDArray[np.int64]
Stretch: TypeAlias = tuple[int, int]

TRAINING, VALIDATION, GUARD = "training", "validation", "guard"
# Interleaved: this many blocks train and validate in turn (seven to three).
INTERLEAVED = (7, 3)
SECOND_US = 1_000_000


@dataclass(frozen=True, slots=True)
class Windows:
    """Blocks of a night and their split, as a fleet has them that states nothing else."""

    block_s: float = 120.0  # length of a short block [s]
    maximum_blocks: int = 96  # neighbours are merged until no more are left
    split: str = "chronological"  # or interleaved
    training_share: float = 0.8  # share of the samples that trains
    guard_blocks: int = 1  # left out at each border between training and validation


@dataclass(frozen=True, slots=True)
class ChosenPeriods:
    """Periods chosen by hand, in order of time; each begin and end, UTC microseconds, half open."""

    training: tuple[Stretch, ...] = ()
    validation: tuple[Stretch, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.training or self.validation)


NONE_CHOSEN = ChosenPeriods()


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive kept samples of one part of a night."""

    # first_row, end_row: rows of the kept samples, half open.
    first_row: int
    end_row: int
    # start_us, end_us: borders on the clock, half open, UTC microseconds.
    start_us: int
    end_us: int
    part: str  # training, validation or guard

    @property
    def n(self) -> int:
        """Kept samples."""
        return self.end_row - self.first_row


def split_into_blocks(
    time_us: Times,
    night_start_us: int,
    settings: Windows,
    chosen_periods: ChosenPeriods = NONE_CHOSEN,
) -> tuple[Block, ...]:
    """Return short blocks of the kept samples, counted from the night's start, with their parts."""
    length = round(settings.block_s * SECOND_US)
    if not len(time_us):
        return ()
    first, last = ((int(time_us[at]) - night_start_us) // length for at in (0, -1))
    numbers = np.arange(first, last + 1)
    starts = np.searchsorted(time_us, night_start_us + numbers * length)
    sizes = np.diff(starts, append=len(time_us))
    numbers, starts, sizes = (part[sizes > 0] for part in (numbers, starts, sizes))
    parts = _parts(numbers, sizes, settings)
    if chosen_periods:
        parts = _parts_as_chosen(time_us, starts, chosen_periods)
    return tuple(
        Block(first, first + size, begin_us, begin_us + length, part)
        for first, size, begin_us, part in zip(
            starts.tolist(),
            sizes.tolist(),
            (night_start_us + numbers * length).tolist(),
            parts,
            strict=True,
        )
    )


def _parts(numbers: NDArray[np.int64], sizes: NDArray[np.int64], settings: Windows) -> list[str]:
    if settings.split == "interleaved":
        return _interleaved(numbers, settings)
    before = np.cumsum(sizes) - sizes
    n_training = int((before < settings.training_share * sizes.sum()).sum())
    border = numbers[n_training - 1] + settings.guard_blocks
    late = [GUARD if number <= border else VALIDATION for number in numbers[n_training:]]
    return [TRAINING] * n_training + late


def _parts_as_chosen(
    time_us: Times, starts: NDArray[np.intp], chosen_periods: ChosenPeriods
) -> list[str]:
    periods = {TRAINING: chosen_periods.training, VALIDATION: chosen_periods.validation}
    whole = {
        part: np.logical_and.reduceat(within(time_us, stretches), starts)
        for part, stretches in periods.items()
    }
    found = np.select(list(whole.values()), list(whole), GUARD)
    return [str(part) for part in found]


def within(time_us: Times, stretches: Sequence[Stretch]) -> Mask:
    """Return samples that lie in one of some stretches, shape (n,)."""
    mask = np.zeros(len(time_us), dtype=np.bool_)
    for begin, end in stretches:
        mask |= (time_us >= begin) & (time_us < end)
    return mask


def _interleaved(numbers: NDArray[np.int64], settings: Windows) -> list[str]:
    guard = settings.guard_blocks
    # A night of many blocks takes longer turns: a cycle has four parts, which cannot be merged.
    cycles = settings.maximum_blocks // 4
    shortest = -(-int(numbers[-1] - numbers[0] + 1) // cycles)
    stretch = max(1, -(-(shortest - 2 * guard) // sum(INTERLEAVED)))
    training, validation = (count * stretch for count in INTERLEAVED)
    cycle = [TRAINING] * training + [GUARD] * guard + [VALIDATION] * validation + [GUARD] * guard
    return [cycle[int(number - numbers[0]) % len(cycle)] for number in numbers]


def merge_neighbours(blocks: tuple[Block, ...], maximum: int) -> tuple[Block, ...]:
    """Blocks for storage: neighbours of the same part merged until at most `maximum` are left."""
    runs = [list(run) for _, run in groupby(blocks, lambda block: block.part)]
    size = 1
    while sum(-(-len(run) // size) for run in runs) > maximum and size < len(blocks):
        size += 1
    merged = (run[at : at + size] for run in runs for at in range(0, len(run), size))
    return tuple(
        replace(group[0], end_row=group[-1].end_row, end_us=group[-1].end_us) for group in merged
    )


def places_on_clock(begins_us: Times, ends_us: Times) -> tuple[NDArray[np.int64], float]:
    """Places of blocks on the clock, counted from the first in their usual length, and that [s].

    Examples
    --------
    >>> begins, ends = np.array([[0, 120, 600, 720], [120, 240, 720, 780]]) * SECOND_US
    >>> places, length_s = places_on_clock(begins, ends)
    >>> places.tolist(), length_s
    ([0, 1, 5, 6], 120.0)
    """
    usual = float(np.median(ends_us - begins_us))
    return np.round((begins_us - begins_us[:1]) / usual).astype(np.int64), usual / SECOND_US


def numbers_of(blocks: Sequence[Block]) -> NDArray[np.int64]:
    """Return number of each sample's block, shape (n,)."""
    return np.repeat(np.arange(len(blocks)), [block.n for block in blocks])

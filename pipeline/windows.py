"""Blocks of a night, and which of them train, validate or stand guard between the two.

The split is decided on the short blocks, before neighbours are merged for storage; smoothing never
crosses a block's border, so blocks do not depend on the split.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.clean import SECOND_US, Times
from pipeline.config import Windows

TRAINING, VALIDATION, GUARD = "training", "validation", "guard"
# Interleaved: this many blocks train and validate in turn (seven to three).
INTERLEAVED = (7, 3)


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive kept samples of one part of a night.

    Attributes
    ----------
    first_row, end_row
        Rows of the kept samples, half open.
    start_us, end_us
        Borders on the clock, half open, UTC microseconds.
    part
        training, validation or guard.
    """

    first_row: int
    end_row: int
    start_us: int
    end_us: int
    part: str

    @property
    def n(self) -> int:
        """Kept samples."""
        return self.end_row - self.first_row


def split_into_blocks(time_us: Times, night_start_us: int, settings: Windows) -> tuple[Block, ...]:
    """Short blocks of the kept samples, counted from the night's start, with their parts.

    Parameters
    ----------
    time_us
        Times of the kept samples, increasing, shape (n,).
    night_start_us
        Start of the night.
    settings
        Length of a block, kind of split, shares.

    Returns
    -------
    tuple of Block
        In time order; blocks without a kept sample are left out.
    """
    length = round(settings.block_s * SECOND_US)
    if not len(time_us):
        return ()
    number = (time_us - night_start_us) // length
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    ends = np.append(starts[1:], len(time_us))
    numbers, sizes = number[starts], ends - starts
    parts = _parts(numbers, sizes, settings)
    return tuple(
        Block(
            int(first),
            int(end),
            night_start_us + int(k) * length,
            night_start_us + (int(k) + 1) * length,
            part,
        )
        for first, end, k, part in zip(starts, ends, numbers, parts, strict=True)
    )


def _parts(numbers: NDArray[np.int64], sizes: NDArray[np.int64], settings: Windows) -> list[str]:
    if settings.split == "interleaved":
        return _interleaved(numbers, settings)
    before = np.cumsum(sizes) - sizes
    n_training = int((before < settings.training_share * sizes.sum()).sum())
    border = numbers[n_training - 1] + settings.guard_blocks
    late = [GUARD if number <= border else VALIDATION for number in numbers[n_training:]]
    return [TRAINING] * n_training + late


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
    group = 1
    merged = blocks
    while len(merged) > maximum and group < len(blocks):
        group += 1
        merged = _merged_by(blocks, group)
    return merged


def _merged_by(blocks: tuple[Block, ...], group: int) -> tuple[Block, ...]:
    merged: list[Block] = []
    count = 0
    for block in blocks:
        if merged and merged[-1].part == block.part and count < group:
            last = merged[-1]
            merged[-1] = Block(
                last.first_row, block.end_row, last.start_us, block.end_us, block.part
            )
            count += 1
        else:
            merged.append(block)
            count = 1
    return tuple(merged)

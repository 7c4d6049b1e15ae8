"""The parts of a night that are good enough to fit, its blocks, and which train or validate.

Samples outside of every good part, or of the periods set by hand, are left out and counted.

The split is decided on the short blocks, before neighbours are merged for storage; smoothing never
crosses a block's border, so blocks do not depend on the split.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Times
from pipeline.config import Windows
from pipeline.config.periods import NONE_CHOSEN, ChosenPeriods, Stretch

Mask = NDArray[np.bool_]
TRAINING, VALIDATION, GUARD = "training", "validation", "guard"
# Interleaved: this many blocks train and validate in turn (seven to three).
INTERLEAVED = (7, 3)
# A spread goes from the one to the other: single samples make none.
SPREAD_PERCENTILES = (5.0, 95.0)


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


def left_out(
    time_us: Times,
    period_us: int,
    night_start_us: int,
    settings: Windows,
    chosen_periods: ChosenPeriods,
) -> dict[str, Mask]:
    """Kept samples that are in no part of the night good enough to fit, by rule."""
    if chosen_periods:
        inside = _within(time_us, chosen_periods.training + chosen_periods.validation)
        return {"outside_periods": ~inside}
    length = round(settings.block_s * SECOND_US)
    number = (time_us - night_start_us) // length
    _, place, sizes = np.unique(number, return_inverse=True, return_counts=True)
    thin = (sizes < settings.minimum_block_share * (length / period_us))[place]
    short = np.zeros(len(time_us), dtype=np.bool_)
    rest = np.flatnonzero(~thin)
    if settings.longest_gap_s is not None and len(rest):
        apart = np.diff(time_us[rest]) > settings.longest_gap_s * SECOND_US
        stretch = np.concatenate([[0], np.cumsum(apart)])
        minutes = np.bincount(stretch) * period_us / (60 * SECOND_US)
        short[rest] = (minutes < settings.minimum_stretch_minutes)[stretch]
    return {"thin_block": thin, "short_stretch": short}


def too_uniform(values: Mapping[str, NDArray[np.float64]], settings: Windows) -> str | None:
    """Channel that varies too little over the training samples to be fitted, in words; or None."""
    needed = {
        "pressure": (settings.minimum_pressure_spread_bar, "bar"),
        "speed": (settings.minimum_speed_spread_rpm, "rpm"),
        "temperature": (settings.minimum_temperature_spread_c, "°C"),
    }
    found = []
    for name, (limit, unit) in needed.items():
        if limit > 0 and len(values[name]):
            low, high = np.percentile(values[name], SPREAD_PERCENTILES)
            if high - low < limit:
                found.append(f"{name} spans {high - low:.3g} {unit}, {limit:g} are needed")
    return "; ".join(found) or None


def split_into_blocks(
    time_us: Times,
    night_start_us: int,
    settings: Windows,
    chosen_periods: ChosenPeriods = NONE_CHOSEN,
) -> tuple[Block, ...]:
    """Short blocks of the kept samples, counted from the night's start, with their parts."""
    length = round(settings.block_s * SECOND_US)
    if not len(time_us):
        return ()
    number = (time_us - night_start_us) // length
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    ends = np.append(starts[1:], len(time_us))
    numbers, sizes = number[starts], ends - starts
    parts = _parts(numbers, sizes, settings)
    if chosen_periods:
        parts = _parts_as_chosen(time_us, starts, chosen_periods)
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


def _parts_as_chosen(
    time_us: Times, starts: NDArray[np.intp], chosen_periods: ChosenPeriods
) -> list[str]:
    periods = {TRAINING: chosen_periods.training, VALIDATION: chosen_periods.validation}
    whole = {
        part: np.logical_and.reduceat(_within(time_us, stretches), starts)
        for part, stretches in periods.items()
    }
    found = np.select(list(whole.values()), list(whole), GUARD)
    return [str(part) for part in found]


def _within(time_us: Times, stretches: Sequence[Stretch]) -> Mask:
    """Samples that lie in one of some stretches, shape (n,)."""
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

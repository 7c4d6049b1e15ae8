"""The parts of a night that are good enough to fit, its blocks, and which train or validate.

Samples outside of every good part, or of the periods set by hand, are left out and counted.

The split is decided on the short blocks, before neighbours are merged for storage; smoothing never
crosses a block's border, so blocks do not depend on the split.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Times
from pipeline.config import Windows
from pipeline.config.motors import Periods
from pipeline.config.nights import Night

Mask = NDArray[np.bool_]

Stretch = tuple[int, int]
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


@dataclass(frozen=True, slots=True)
class HandSet:
    """Periods set by hand as far as they touch a night; UTC microseconds, half open."""

    training: tuple[tuple[int, int], ...] = ()
    validation: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, periods: Periods, night: Night) -> HandSet:
        """Those of a motor's periods that touch a night."""

        def touching(chosen: Iterable[tuple[dt.datetime, dt.datetime]]) -> tuple[Stretch, ...]:
            stretches = ((_microseconds(begin), _microseconds(end)) for begin, end in chosen)
            return tuple(
                sorted(
                    (begin, end)
                    for begin, end in stretches
                    if begin < night.end_us and end > night.start_us
                )
            )

        return cls(touching(periods.training), touching(periods.validation))

    def __bool__(self) -> bool:
        return bool(self.training or self.validation)

    def within(self, time_us: Times, part: str) -> Mask:
        """Which samples lie in a period of a part, shape (n,)."""
        mask = np.zeros(len(time_us), dtype=np.bool_)
        for begin, end in self.training if part == TRAINING else self.validation:
            mask |= (time_us >= begin) & (time_us < end)
        return mask


NONE_SET = HandSet()


def _microseconds(time: dt.datetime) -> int:
    return (time - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)) // dt.timedelta(microseconds=1)


def left_out(
    time_us: Times, period_us: int, night_start_us: int, settings: Windows, by_hand: HandSet
) -> dict[str, Mask]:
    """Kept samples that are in no part of the night good enough to fit, by rule.

    Parameters
    ----------
    time_us
        Times of the kept samples, increasing, shape (n,).
    period_us
        Period of the time base.
    night_start_us
        Start of the night; blocks count from it.
    settings
        Share a block must keep, longest gap, shortest stretch.
    by_hand
        Periods set by hand; where there are some, they alone decide.

    Returns
    -------
    dict of str to ndarray of bool
        Shape (n,) each: `outside_periods`, or `thin_block` and `short_stretch`. Stretches are
        those of the samples that are not in a thin block.
    """
    if by_hand:
        inside = by_hand.within(time_us, TRAINING) | by_hand.within(time_us, VALIDATION)
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
    """What varies too little over the training samples to be fitted, in words; None: nothing.

    Parameters
    ----------
    values
        |pressure difference| [bar], |speed| [rpm] and oil temperature [°C] of the training
        samples, by the names "pressure", "speed" and "temperature"; shape (n,) each.
    settings
        The spreads that are needed.
    """
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
    time_us: Times, night_start_us: int, settings: Windows, by_hand: HandSet = NONE_SET
) -> tuple[Block, ...]:
    """Short blocks of the kept samples, counted from the night's start, with their parts.

    Parameters
    ----------
    time_us
        Times of the kept samples, increasing, shape (n,).
    night_start_us
        Start of the night.
    settings
        Length of a block, kind of split, shares.
    by_hand
        Periods set by hand, which then decide the parts; a block that both touch is guard.

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
    if by_hand:
        parts = _parts_by_hand(time_us, starts, by_hand)
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


def _parts_by_hand(time_us: Times, starts: NDArray[np.intp], by_hand: HandSet) -> list[str]:
    whole = {
        part: np.logical_and.reduceat(by_hand.within(time_us, part), starts)
        for part in (TRAINING, VALIDATION)
    }
    found = np.select(list(whole.values()), list(whole), GUARD)
    return [str(part) for part in found]


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

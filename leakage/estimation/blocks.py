r"""Blocks of samples: their borders on the clock, which of them train, what a fit needs of them.

The samples enter the least squares criterion only through the columns of z: a regressor for each
path with a free coefficient, then 1, the known flow and the measured flow. With the QR
decomposition Z = QR of a block's samples,

.. math:: V(\theta) = \frac{1}{N} \lVert Z v(\theta) \rVert^2
                    = \frac{1}{N} \lVert R v(\theta) \rVert^2 ,\quad
          v(\theta) = (K_1, \dots, K_p, C_f, 1, -1)^T ,

exactly and at any parameters. Factors merge: R of two blocks is the R of the two R stacked. A
window of any length is therefore fitted from its blocks, without the samples, and blocks of many
nights merge. The decomposition is backward stable [1]_; the criterion is (20) of the thesis.

The split is decided on the short blocks, before neighbours are merged for storage; smoothing never
crosses a block's border, so blocks do not depend on the split. A moving average comes after the
regressors: the model is linear in the loss factors, so the same average on all columns leaves them
unbiased; an average of the measured flow alone (as in the thesis, 3.3.2) does not (model.md,
section 4).

References
----------
.. [1] G. H. Golub and C. F. Van Loan, *Matrix Computations*, 4th ed., section 5.3, 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.errors import StatisticsError


def factor(z: Array) -> Array:
    """Return triangular factor of a block of samples, shape (c, c), its diagonal not negative.

    `z` has the columns of n samples, shape (n, c): paths, 1, known, measured. n may be 0.

    Raises StatisticsError if `z` holds a value that is not finite.

    Examples
    --------
    >>> factor(np.array([[3.0, 1.0], [4.0, 1.0]])).round(6)
    array([[5. , 1.4],
           [0. , 0.2]])
    """
    only: Array = factors(z, np.array([0, len(z)]))[0]
    return only


def factors(z: Array, borders: NDArray[np.int64]) -> Array:
    """Return triangular factors of consecutive blocks of samples, (b, c, c), each as of `factor`.

    `borders` are the first row of each block and, last, the end; shape (b + 1,), not decreasing.
    """
    # Loaded with the first samples: commands that read tables alone do without it.
    from scipy.linalg.lapack import dgeqrf

    z = np.asarray(z, dtype=np.float64)
    columns = z.shape[1]
    triangles = np.zeros((len(borders) - 1, columns, columns))
    for block, begin, end in zip(triangles, borders[:-1], borders[1:], strict=True):
        if begin < end:
            r = dgeqrf(z[begin:end])[0][:columns]
            block[: len(r)] = r
    _require_finite("samples", triangles)
    return _positive(triangles)


def merge(factors_in_time_order: Array) -> Array:
    """Return factor of the union of blocks, from theirs of shape (b, c, c).

    Their order changes rounding only; keep it, so that runs agree to the bit.

    Raises StatisticsError if a factor holds a value that is not finite.
    """
    blocks, _, columns = factors_in_time_order.shape
    if blocks == 0:
        return np.zeros((columns, columns))
    _require_finite("factors", factors_in_time_order)
    merged: Array = _triangular(factors_in_time_order.reshape(1, -1, columns))[0]
    return merged


def with_free_known(factors: Array, place: int, coefficient: float) -> Array:
    """Return factors with the known flow as a path of its own, whose coefficient can be estimated.

    `factors`: Shape (b, c, c); those that are returned, in which nothing is known, (b, c + 1, c +
    1).
    `place, coefficient`: Of the new column among the paths, and with which the path is in the known
    flow.
    """
    moved = np.insert(factors, place, factors[:, :, -2] / coefficient, axis=2)
    moved[:, :, -2] = 0.0
    return _triangular(np.pad(moved, ((0, 0), (0, 1), (0, 0))))


def _require_finite(what: str, values: Array) -> None:
    if not np.isfinite(values).all():
        raise StatisticsError(
            "not_finite", f"{what} hold a value that is not finite; refuse it before"
        )


def _triangular(stacked: Array) -> Array:
    """Return r of each matrix of a stack."""
    return _positive(np.asarray(np.linalg.qr(stacked, mode="r")))


def _positive(decomposed: Array) -> Array:
    """Return upper triangles, with the signs that QR leaves open made positive."""
    signs = np.where(np.diagonal(decomposed, axis1=1, axis2=2) < 0, -1.0, 1.0)
    # Adding 0 turns -0 into 0: the same statistics have the same bytes.
    result: Array = np.triu(decomposed) * signs[:, :, None] + 0.0
    return result


def criterion(r: Array, coefficients: Array) -> float:
    """Mean squared prediction error V(θ), (20), from a factor [(l/min)²]; nan without samples."""
    n = sample_count(r)
    return float(squared_error(r, coefficients) / n) if n else float("nan")


def squared_error(r: Array, coefficients: Array) -> float:
    """Return sum of squared prediction errors ‖y − ŷ‖² [(l/min)²] from a factor."""
    residual = r @ np.concatenate([coefficients, (1.0, -1.0)])
    return float(residual @ residual)


def sample_count(r: Array) -> int:
    """Return number of samples behind a factor: the squared norm of the column of ones."""
    ones = r[:, -3]
    return round(float(ones @ ones))


Times = NDArray[np.int64]
Stretch: TypeAlias = tuple[int, int]

TRAINING, VALIDATION, GUARD = "training", "validation", "guard"
# Interleaved: this many blocks train and validate in turn (seven to three).
INTERLEAVED = (7, 3)
SECOND_US = 1_000_000
# Errors below this share of the flow are rounding, in every analysis of them.
ROUNDING = 1e-9


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
    """Consecutive kept samples of a part of a night."""

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
        return _interleave(numbers, settings)
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
    parts = np.select(list(whole.values()), list(whole), GUARD)
    return [str(part) for part in parts]


def within(time_us: Times, stretches: Sequence[Stretch]) -> Mask:
    """Return samples that lie in any of some stretches, shape (n,)."""
    mask = np.zeros(len(time_us), dtype=np.bool_)
    for begin, end in stretches:
        mask |= (time_us >= begin) & (time_us < end)
    return mask


def _interleave(numbers: NDArray[np.int64], settings: Windows) -> list[str]:
    guard = settings.guard_blocks
    # A night of many blocks takes longer turns: a cycle has four parts, which cannot be merged.
    cycles = settings.maximum_blocks // 4
    shortest = -(-int(numbers[-1] - numbers[0] + 1) // cycles)
    stretch = max(1, -(-(shortest - 2 * guard) // sum(INTERLEAVED)))
    training, validation = (count * stretch for count in INTERLEAVED)
    cycle = [TRAINING] * training + [GUARD] * guard + [VALIDATION] * validation + [GUARD] * guard
    return [cycle[int(number - numbers[0]) % len(cycle)] for number in numbers]


def merge_neighbours(blocks: tuple[Block, ...], maximum: int) -> tuple[Block, ...]:
    """Return blocks to store: neighbours of a part merged until at most `maximum` are left."""
    runs = [list(run) for _, run in groupby(blocks, lambda block: block.part)]
    size = 1
    while sum(-(-len(run) // size) for run in runs) > maximum and size < len(blocks):
        size += 1
    merged = (run[at : at + size] for run in runs for at in range(0, len(run), size))
    return tuple(
        replace(group[0], end_row=group[-1].end_row, end_us=group[-1].end_us) for group in merged
    )


def places_on_clock(begins_us: Times, ends_us: Times) -> tuple[NDArray[np.int64], float]:
    """Return places of blocks on the clock, counted in their usual length, and that [s].

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


def smooth(
    z: Array,
    index: Times,
    block: Times,
    period_us: int,
    window_s: float,
) -> Array:
    """Return the centred moving average of the columns over kept samples.

    `z, index, block`: Columns, shape (n, c), place on the time base and number of the block of each
    sample, (n,).
    `period_us, window_s`: Period of the time base [µs]; length of the average [s], 0: none.
    """
    half = round(window_s * SECOND_US) // (2 * period_us)
    if half == 0:
        return z
    row = np.arange(len(z))
    begins = np.flatnonzero(np.concatenate([[True], (np.diff(index) != 1) | (np.diff(block) != 0)]))
    segment = np.searchsorted(begins, row, side="right") - 1
    ends = np.append(begins[1:], len(z))
    first = np.maximum(row - half, begins[segment])
    last = np.minimum(row + half + 1, ends[segment])
    averaged = np.empty_like(z)
    for begin, end in zip(begins, ends, strict=True):
        # Sums run afresh in each segment: over a whole night they would lose digits.
        sums = np.vstack([np.zeros(z.shape[1]), np.cumsum(z[begin:end], axis=0)])
        part = slice(begin, end)
        width = (last[part] - first[part])[:, None]
        averaged[part] = (sums[last[part] - begin] - sums[first[part] - begin]) / width
    return averaged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompressedSamples:
    """Samples with their columns, and the statistics of their blocks."""

    z: Array  # their columns, smoothed where that was asked for; shape (n, c)
    unsmoothed: Array  # the same before smoothing; z itself where none was asked for
    blocks: tuple[Block, ...]  # blocks as they are stored
    factors: Array  # triangular factor of each, shape (b, c, c)

    def factor_of(self, part: str) -> Array:
        """Return the factor of the samples of a part."""
        chosen = [block.part == part for block in self.blocks]
        return merge(self.factors[np.array(chosen, dtype=bool)])

    def rows_of(self, part: str) -> Mask:
        """Return the mask of the samples of a part, shape (n,)."""
        chosen = np.array([block.part == part for block in self.blocks], dtype=np.bool_)
        return np.repeat(chosen, [block.n for block in self.blocks])

    def error_of(self, coefficients: Array) -> Array:
        """Return the prediction errors of the samples [l/min], shape (n,)."""
        error: Array = self.z @ -np.concatenate([coefficients, (1.0, -1.0)])
        return error


def compress(
    columns: Array,
    index: NDArray[np.int64],
    period_us: int,
    short: tuple[Block, ...],
    *,
    maximum_blocks: int,
    smoothing_s: float = 0.0,
) -> CompressedSamples:
    """Smooth and compress samples.

    `columns, index, period_us`: Columns as ``motor.columns``, shape (n, c), places on the time
    base, shape (n,), its period.
    `short, maximum_blocks`: Short blocks; neighbours are merged until no more are left.
    `smoothing_s`: Length of the moving average [s]; 0: none.
    """
    z = columns
    if smoothing_s:
        z = smooth(columns, index, numbers_of(short), period_us, smoothing_s)
    stored = merge_neighbours(short, maximum_blocks)
    borders = np.array([*(block.first_row for block in stored), len(z)])
    return CompressedSamples(z=z, unsmoothed=columns, blocks=stored, factors=factors(z, borders))

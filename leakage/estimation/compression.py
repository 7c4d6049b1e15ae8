"""Samples compressed to the statistics of their blocks: of a night, and of a frame.

A moving average comes after the regressors and within a block: the model is linear in the loss
factors, so the same average on all columns leaves them unbiased; one on the measured flow alone (as
in the thesis, 3.3.2) does not (model.md, section 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.estimation.block_statistics import factors, merge
from leakage.estimation.sample_blocks import Block, merge_neighbours, numbers_of

Ints = NDArray[np.int64]

SECOND_US = 1_000_000


def smooth(
    z: Array,
    index: Ints,
    block: Ints,
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
    # Blocks before neighbours are merged, whose borders no smoothing crosses.
    short: tuple[Block, ...]
    blocks: tuple[Block, ...]  # blocks as they are stored
    factors: Array  # triangular factor of each, shape (b, c, c)

    def factor_of(self, part: str | None = None) -> Array:
        """Return the factor of the samples of a part, or of all."""
        chosen = [part is None or block.part == part for block in self.blocks]
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
    return CompressedSamples(
        z=z, unsmoothed=columns, short=short, blocks=stored, factors=factors(z, borders)
    )

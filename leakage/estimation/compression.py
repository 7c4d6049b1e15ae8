"""Samples compressed to the statistics of their blocks: of a night, and of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import factors, merge
from leakage.estimation.robust import huber_weights, weight_inflation
from leakage.estimation.sample_blocks import Block, merge_neighbours, numbers_of
from leakage.estimation.smoothing import smooth

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompressedSamples:
    """Samples with their columns, and the statistics of their blocks."""

    z: Array  # their columns, smoothed where that was asked for; shape (n, c)
    unsmoothed: Array  # the same before smoothing; z itself where none was asked for
    # Blocks before neighbours are merged, whose borders no smoothing crosses.
    short: tuple[Block, ...]
    blocks: tuple[Block, ...]  # blocks as they are stored
    # Triangular factor of each, shape (b, c, c); of weighted samples under a robust loss.
    factors: Array
    plain_factors: Array  # the same without weights: what a fit is judged on
    inflation: float  # factor on standard errors that robust weights ask for; 1 without them

    def judged_on(self, part: str | None = None) -> Array:
        """Factor of the samples of a part as they are, or of all."""
        chosen = [part is None or block.part == part for block in self.blocks]
        return merge(self.plain_factors[np.array(chosen, dtype=bool)])

    def rows_of(self, part: str) -> NDArray[np.bool_]:
        """Mask of the samples of a part, shape (n,)."""
        chosen = np.array([block.part == part for block in self.blocks], dtype=np.bool_)
        return np.repeat(chosen, [block.n for block in self.blocks])

    def error_of(self, coefficients: Array) -> Array:
        """Prediction errors of the samples [l/min], shape (n,)."""
        error: Array = self.z @ -np.concatenate([coefficients, (1.0, -1.0)])
        return error


def compress(
    columns: Array,
    index: NDArray[np.int64],
    period_us: int,
    short: tuple[Block, ...],
    bounds: tuple[Array, Array],
    *,
    maximum_blocks: int,
    smoothing_s: float = 0.0,
    smoothing_of: Literal["all", "leakage"] = "all",
    loss: Literal["squared", "huber"] = "squared",
    weighted_parts: Sequence[str] | None = None,
) -> CompressedSamples:
    """Smooth, weight and compress samples.

    Parameters
    ----------
    columns, index, period_us
        Columns as ``motor.columns``, shape (n, c), places on the time base, shape (n,), its period.
    short, maximum_blocks
        Short blocks; neighbours are merged until no more are left.
    bounds
        Bounds of θ; the weights need them.
    smoothing_s, smoothing_of
        As of :func:`leakage.estimation.smoothing.smooth`.
    loss, weighted_parts
        ``squared``, or Huber's by weights on the samples, found by those of some parts, or of all.

    Raises
    ------
    EstimationError
        If Huber's weights are asked for and there are fewer samples than coefficients.
    """
    z = columns
    if smoothing_s:
        z = smooth(columns, index, numbers_of(short), period_us, smoothing_s, smoothing_of)
    stored = merge_neighbours(short, maximum_blocks)
    borders = np.array([*(block.first_row for block in stored), len(z)])
    plain = factors(z, borders)
    made, inflation = plain, 1.0
    if loss == "huber":
        chosen = [weighted_parts is None or block.part in weighted_parts for block in short]
        rows = np.array(chosen, dtype=np.bool_)[numbers_of(short)]
        weights = np.ones(len(z))
        weights[rows] = huber_weights(z[rows], *bounds)
        made = factors(z * np.sqrt(weights)[:, None], borders)
        inflation = weight_inflation(weights[rows])
    return CompressedSamples(
        z=z,
        unsmoothed=columns,
        short=short,
        blocks=stored,
        factors=made,
        plain_factors=plain,
        inflation=inflation,
    )

r"""Samples compressed to the statistics of their blocks: of a night, and of a frame.

A moving average comes after the regressors and within a block: the model is linear in the loss
factors, so the same average on all columns leaves them unbiased; one on the measured flow alone (as
in the thesis, 3.3.2) does not (model.md, section 4).

A triangular factor knows squares only, so Huber's loss is met by weights on the samples, found by
iteratively reweighted least squares [1]_: with errors e and their robust scale s,

.. math:: w_i = \min\left(1, \frac{k s}{|e_i|}\right), \qquad z_i \to \sqrt{w_i}\, z_i .

References
----------
.. [1] P. J. Huber and E. M. Ronchetti, *Robust Statistics*, 2nd ed., Wiley, 2009, section 7.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.estimation.block_statistics import factor, factors, merge
from leakage.estimation.proven_minimum import certify
from leakage.estimation.sample_blocks import Block, merge_neighbours, numbers_of

Ints = NDArray[np.int64]

SECOND_US = 1_000_000


def smooth(
    z: Array,
    index: Ints,
    block: Ints,
    period_us: int,
    window_s: float,
    apply_to: Literal["all", "leakage"] = "all",
) -> Array:
    """Centred moving average of the columns, of which the last is the flow, over kept samples.

    `z, index, block`: Columns, shape (n, c), place on the time base and number of the block of each
    sample, (n,).
    `period_us, window_s`: Period of the time base [µs]; length of the average [s], 0: none.
    `apply_to`: ``all`` columns, or the flow alone (``leakage``).
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
    columns = slice(None) if apply_to == "all" else slice(-1, None)
    # Sums run afresh in each segment: over a whole night they would lose digits.
    chosen = z[:, columns]
    averaged = np.empty_like(chosen)
    for begin, end in zip(begins, ends, strict=True):
        sums = np.vstack([np.zeros(chosen.shape[1]), np.cumsum(chosen[begin:end], axis=0)])
        part = slice(begin, end)
        width = (last[part] - first[part])[:, None]
        averaged[part] = (sums[last[part] - begin] - sums[first[part] - begin]) / width
    result = z.copy()
    result[:, columns] = averaged
    return result


# 95 % efficient under normal errors.
TUNING = 1.345
MAD_TO_SD = 1.482602218505602
MOST_ROUNDS = 50
SETTLED = 1e-8


def huber_weights(z: Array, lower: Array, upper: Array, tuning: float = TUNING) -> Array:
    """Weights of samples under Huber's loss."""
    weights = np.ones(len(z))
    before = np.inf
    for _ in range(MOST_ROUNDS):
        root = np.sqrt(weights)
        theta = certify(factor(z * root[:, None]), lower, upper).coefficients
        error = np.abs(z @ np.concatenate([theta, (1.0, -1.0)]))
        scale = MAD_TO_SD * float(np.median(error))
        if scale <= 0.0:
            return np.ones(len(z))
        weights = np.minimum(1.0, tuning * scale / np.maximum(error, 1e-300))
        loss = _loss(error / scale, tuning) * scale**2
        if abs(before - loss) <= SETTLED * loss:
            break
        before = loss
    return weights


def weight_inflation(weights: Array) -> float:
    r"""Factor, at least 1, by which standard errors that take the weights as known are too small.

    With ψ the slope of the loss, the estimate moves with :math:`(\sum \psi' x x^T)^{-1}`, and
    ψ' is 1 where a sample has its full weight and 0 elsewhere; weighted least squares uses the
    larger :math:`\sum w x x^T` in its place.
    """
    full = float(np.mean(weights >= 1.0)) if len(weights) else 1.0
    return max(float(np.mean(weights)) / full, 1.0) if full > 0 else float("inf")


def _loss(standardised: Array, tuning: float) -> float:
    """Mean Huber loss of errors in units of their scale."""
    within = np.minimum(standardised, tuning)
    return float(np.mean(within * (standardised - within / 2)))


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

    def rows_of(self, part: str) -> Mask:
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

    `columns, index, period_us`: Columns as ``motor.columns``, shape (n, c), places on the time
    base, shape (n,), its period.
    `short, maximum_blocks`: Short blocks; neighbours are merged until no more are left.
    `bounds`: Bounds of θ; the weights need them.
    `smoothing_s, smoothing_of`: As of :func:`leakage.estimation.compression.smooth`.
    `loss, weighted_parts`: ``squared``, or Huber's by weights on the samples, found by those of
    some parts, or of all.

    Raises EstimationError if Huber's weights are asked for and there are fewer samples than
    coefficients.
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

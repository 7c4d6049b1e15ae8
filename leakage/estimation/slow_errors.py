r"""Errors that remember for longer than a block: found by REML, and whitened away.

Errors of real machines drift over many minutes, and then neighbouring blocks tell the same story
twice. A block's factor splits into what its samples say of one another and what their mean says:
:math:`R_b^T R_b = W_b + n_b \bar z_b \bar z_b^T`. Errors within a block have the variance
:math:`\sigma^2` and, as neighbours correlate, act as :math:`\kappa` times that; the means have

.. math::
    \operatorname{Cov}(\bar e) = \sigma^2 \kappa
        \left(\operatorname{diag}(1/n_b) + \frac{\lambda}{\bar n} R_\rho\right) ,

:math:`R_\rho` a first-order autoregression over blocks on the clock. ρ and λ maximise the
restricted likelihood [1]_ over a grid: the inverse of :math:`R_\rho` is tridiagonal, and odd-even
reduction [2]_ takes all points at once. A Kalman filter whitens the means as a Cholesky factor
does [3]_. At λ = 0 the whitened factors are those of the samples.

A slow error larger than four times what the least squares' means show is left out of the grid:
it would throw away what the means say of the level, and doubled the error of the leakage.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to
   related problems", *Journal of the American Statistical Association*, 72(358), 1977.
.. [2] R. W. Hockney, "A fast direct solution of Poisson's equation using Fourier analysis",
   *Journal of the ACM*, 12(1), 1965.
.. [3] A. C. Harvey, *Forecasting, Structural Time Series Models and the Kalman Filter*, Cambridge
   University Press, 1989, section 3.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import merge

Array = NDArray[np.float64]

# Grid of the restricted likelihood: memory from block to block, and variance over that of a mean.
MEMORIES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995)
RATIOS = tuple(10.0 ** (half / 2) for half in range(-2, 10))
# −2 Δ log REML from which on slow errors are taken for real.
EVIDENCE = 4.0
# Factor on half-widths that makes up for ρ and λ being estimates.
WIDENING = 1.25
# Largest variance of a slow error, over that of the means' errors under least squares.
LARGEST_SLOW = 4.0
# Neighbouring samples act at most as one in three, or nothing within a block could tell.
LEAST_WITHIN = 3.0
# Errors below this share of the flow are rounding.
ROUNDING = 1e-9
# Relative size below which a column does not vary within blocks, or depends on others.
RANK_TOLERANCE = 1e-9
LEAST_BLOCKS = 5


@dataclass(frozen=True)  # without slots: their usual size is worked out once
class ShortBlocks:
    """Means over the short blocks that stored blocks are made of, in time order.

    Attributes
    ----------
    n
        Samples of each, shape (k,).
    means
        Means of the columns, shape (k, c).
    number
        Place of each on the clock, in short blocks, shape (k,).
    stored
        Stored block that each belongs to, shape (k,).
    """

    n: Array
    means: Array
    number: NDArray[np.int64]
    stored: NDArray[np.int64]

    @property
    def weights(self) -> Array:
        """Inverse of the variance of each mean without slow errors, shape (k,)."""
        return np.maximum(self.n, 0.5)

    @cached_property
    def usual_n(self) -> float:
        """Median number of samples."""
        return float(np.median(self.n))


@dataclass(frozen=True, slots=True)
class SlowErrors:
    """Correlation of the errors of a window from block to block.

    Attributes
    ----------
    memory
        ρ: correlation of neighbouring short blocks' slow errors.
    variance_ratio
        λ: variance of the slow error over that of a short block's mean without it.
    within
        κ: effective variance of the errors within a block, over their own.
    evidence
        −2 Δ log REML of λ = 0 against the best fit.
    """

    memory: float
    variance_ratio: float
    within: float
    evidence: float

    @property
    def are_slow(self) -> bool:
        """True if the errors are correlated beyond a block, so that the means must be whitened."""
        return self.memory > 0.0 and self.evidence >= EVIDENCE

    def memory_s(self, block_s: float) -> float:
        """Time over which the slow error forgets [s], from the length of a short block; 0: none."""
        return -block_s / math.log(self.memory) if self.are_slow else 0.0


NOT_SLOW = SlowErrors(0.0, 0.0, 1.0, 0.0)


def short_blocks(factors: Array, number: NDArray[np.int64]) -> ShortBlocks:
    """The short blocks of stored ones that were never merged, shape (b, c, c)."""
    ones = factors[:, :, -3]
    n = np.einsum("bi,bi->b", ones, ones)
    means = np.einsum("bi,bij->bj", ones, factors) / np.maximum(n, 0.5)[:, None]
    return ShortBlocks(n, means, number, np.arange(len(factors)))


def slow_errors(
    factors: Array,
    short: ShortBlocks,
    fixed: NDArray[np.bool_],
    values: Array,
    whole: Array | None = None,
) -> SlowErrors:
    """Memory and size of slow errors.

    Parameters
    ----------
    factors
        Triangular factors of the stored blocks, shape (b, c, c).
    short
        What they are made of.
    fixed, values
        Coefficients that are held, and the values they are held at; shape (p + 1,).
    whole
        The merged factor of the blocks, where it is known.

    Returns
    -------
    SlowErrors
        Without memory where nothing can be told of it.
    """
    whole = merge(factors) if whole is None else whole
    design = _design(whole, fixed, values)
    if design is None or len(short.n) < LEAST_BLOCKS:
        return NOT_SLOW
    rank = design.shape[1] - 1
    means = short.means @ design
    # About the means of the short blocks, by stored block.
    gram = _grams(factors @ design)
    np.subtract.at(gram, short.stored, _squares(means, short.n))
    variance, within = _within_errors(gram, short, rank)
    if not variance > ROUNDING**2 * float(np.mean(short.means[:, -1] ** 2)):
        return NOT_SLOW
    memories, ratios = (one.ravel() for one in np.meshgrid(MEMORIES, RATIOS))
    seen = float(np.average(means[:, rank] ** 2, weights=short.n))
    largest = LARGEST_SLOW * seen * short.usual_n / (variance * within)
    memories, ratios = memories[ratios <= largest], ratios[ratios <= largest]
    explained, log_variance = _explained_by_slow(means, short, memories, ratios)
    free = whole @ design
    information = free.T @ free - explained
    x, score = information[:, :rank, :rank], information[:, :rank, rank]
    fitted = np.einsum("gi,gi->g", score, np.linalg.solve(x, score[:, :, None])[:, :, 0])
    squares = (information[:, rank, rank] - fitted) / (variance * within)
    deviance = log_variance + np.linalg.slogdet(x)[1] + squares
    best = int(np.argmin(deviance))
    memory, ratio = ((0.0, *one.tolist())[best] for one in (memories, ratios))
    return SlowErrors(memory, ratio, within, float(deviance[0] - deviance[best]))


def whitened(factors: Array, short: ShortBlocks, errors: SlowErrors) -> Array:
    """Factors of samples whose slow errors are whitened; as they are where there are none.

    Parameters
    ----------
    factors, short
        As for :func:`slow_errors`.
    errors
        What was found.

    Returns
    -------
    ndarray
        Shape (b, c, c), not triangular; scaled so that the column of ones keeps its norm, and with
        it the number of samples.
    """
    if not errors.are_slow:
        return factors
    made = _whitened(factors, short, errors)
    ones, before = made[:, :, -3], factors[:, :, -3]
    result: Array = made * np.sqrt(np.sum(before**2) / np.sum(ones**2))
    return result


def _whitened(factors: Array, short: ShortBlocks, errors: SlowErrors) -> Array:
    """Each block's within part, with the whitened means in place of its own."""
    rows = _whitened_means(short, errors)
    ones = factors[:, :, -3]
    root = np.sqrt(np.maximum(np.einsum("bi,bi->b", ones, ones), 0.5))
    direction = ones / root[:, None]
    centred = factors - direction[:, :, None] * np.einsum("bi,bij->bj", direction, factors)[:, None]
    if len(short.n) == len(factors):
        same: Array = centred + direction[:, :, None] * rows[:, None]
        return same
    scale = np.sqrt(np.einsum("bij,bij->j", factors, factors))
    scale[scale == 0.0] = 1.0
    gram = np.einsum("bij,bik->bjk", factors / scale, factors / scale)
    np.add.at(gram, short.stored, _squares(rows / scale, np.ones(len(rows))))
    np.subtract.at(gram, short.stored, _squares(short.means / scale, short.n))
    values, vectors = np.linalg.eigh(gram)
    roots = np.sqrt(np.maximum(values, 0.0))
    result: Array = roots[:, :, None] * vectors.transpose(0, 2, 1) * scale
    return result


def _squares(rows: Array, weights: Array) -> Array:
    result: Array = np.einsum("k,ki,kj->kij", weights, rows, rows)
    return result


def _grams(factors: Array) -> Array:
    result: Array = factors.transpose(0, 2, 1) @ factors
    return result


def _design(whole: Array, fixed: NDArray[np.bool_], values: Array) -> Array | None:
    """Columns to an orthonormal basis of the free ones and to their least squares' errors."""
    free = np.flatnonzero(~fixed)
    scale = np.linalg.norm(whole[:, free], axis=0)
    scale[scale == 0.0] = 1.0
    left, size, rotation = np.linalg.svd(whole[:, free] / scale, full_matrices=False)
    kept = size > RANK_TOLERANCE * size.max(initial=0.0)
    if not kept.any():
        return None
    known = np.append(np.where(fixed, values, 0.0), (1.0, -1.0))
    to_basis = (rotation[kept] / size[kept, None] / scale).T
    design = np.zeros((whole.shape[1], int(kept.sum()) + 1))
    design[free, :-1] = to_basis
    design[:, -1] = -known
    design[:, -1] -= design[:, :-1] @ (left[:, kept].T @ (whole @ -known))
    return design


def _within_errors(gram: Array, short: ShortBlocks, rank: int) -> tuple[float, float]:
    """Variance of the errors within blocks, and κ: meat over bread of their scores."""
    whole = gram.sum(axis=0)
    size, vectors = np.linalg.eigh(whole[:rank, :rank])
    moving = size > RANK_TOLERANCE
    basis = vectors[:, moving] / np.sqrt(size[moving])
    estimate = basis @ (basis.T @ whole[:rank, rank])
    squares = float(whole[rank, rank] - estimate @ whole[:rank, rank])
    freedom = float(short.n.sum()) - len(short.n) - basis.shape[1]
    if freedom < 1.0 or squares <= 0.0:
        return 0.0, 1.0
    variance = squares / freedom
    leverage = basis.T @ gram[:, :rank, :rank] @ basis
    scores = (gram[:, :rank, rank] - gram[:, :rank, :rank] @ estimate) @ basis
    # Of independent errors, scores about an estimate scatter by this much less than rank.
    expected = basis.shape[1] - float(np.sum(leverage**2))
    if expected <= RANK_TOLERANCE:
        return variance, 1.0
    most = max(short.usual_n / LEAST_WITHIN, 1.0)
    within = float(np.sum(scores**2)) / (variance * expected)
    return variance, min(max(within, 1.0), most)


def _explained_by_slow(
    means: Array, short: ShortBlocks, memory: Array, ratio: Array
) -> tuple[Array, Array]:
    """Part of the means' weighted Gram that slow errors explain, and log |V| + log |W|.

    With W the weights of the means, V their covariance and Q the tridiagonal inverse of that of
    the slow errors, V⁻¹ = W − W (W + Q)⁻¹ W and |V| |W| = |W + Q| / |Q|. Each turn eliminates every
    other block of W + Q. The first point is that of no slow error; shapes (1 + g, c, c), (1 + g,).
    """
    weights, alone = short.weights[:, None], short.usual_n / ratio
    # Blocks of two nights may be rounded to one place.
    kept = memory ** np.maximum(np.diff(short.number), 1)[:, None]
    given_before = np.vstack([alone, alone / (1.0 - kept**2)])
    beside = -kept * given_before[1:]
    size = weights + given_before
    size[:-1] -= kept * beside
    right = (weights * means).T[:, :, None]
    log_size = -np.log(given_before).sum(axis=0)
    explained = np.zeros((len(ratio), len(right), len(right)))
    while len(size):
        log_size += np.log(size[::2]).sum(axis=0)
        scaled = (right[:, ::2] / np.sqrt(size[::2])).transpose(2, 0, 1)
        explained += scaled @ scaled.transpose(0, 2, 1)
        n, gone = len(size) // 2, right[:, ::2]
        before, behind = beside[::2] / size[::2][:n], beside[1::2] / size[2::2]
        right = right[:, 1::2] - before * gone[:, :n]
        right[:, : len(behind)] -= behind * gone[:, 1:]
        size = size[1::2] - before * beside[::2]
        size[: len(behind)] -= behind * beside[1::2]
        beside = -behind[: max(n - 1, 0)] * beside[2::2]
    return np.pad(explained, ((1, 0), (0, 0), (0, 0))), np.append(0.0, log_size)


def _whitened_means(short: ShortBlocks, errors: SlowErrors) -> Array:
    """Means whitened by a Kalman filter, shape (k, c)."""
    memory, size = np.array([errors.memory]), errors.variance_ratio / short.usual_n
    steps = np.diff(short.number, prepend=short.number[:1]).tolist()
    fading = {step: (memory**step).item() for step in set(steps)}
    noise = (1.0 / short.weights).tolist()
    rows = np.empty_like(short.means)
    state, after = np.zeros(short.means.shape[1]), size
    for step, one, mean, row in zip(steps, noise, short.means, rows, strict=True):
        faded = fading[step]
        spread = faded * faded * after + (1.0 - faded * faded) * size
        variance = spread + one
        after = spread * one / variance
        state *= faded
        np.subtract(mean, state, out=row)
        state += spread / variance * row
        row /= math.sqrt(variance)
    return rows

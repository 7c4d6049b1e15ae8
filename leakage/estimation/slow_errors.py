r"""Errors that remember for longer than a block: found by REML, and whitened away.

Errors of real machines drift over many minutes, and then neighbouring blocks tell the same story
twice. A slow error adds to the flow, as a meter's zero does, or scales it, as a temperature or a
gain does: in a block of samples it is a multiple of :math:`d_b`, which is 1 or the leakage of the
estimated paths over its mean. A block's factor splits into what lies along it and the rest,
:math:`R_b^T R_b = W_b + n_b \bar z_b \bar z_b^T` with :math:`n_b = \lVert d_b \rVert^2` and
:math:`\bar z_b = Z_b^T d_b / n_b`, the block's means where :math:`d_b` is 1. Errors about them have
the variance :math:`\sigma^2` and, as neighbours correlate, act as :math:`\kappa` times that; along
them they have

.. math::
    \operatorname{Cov}(\bar e) = \sigma^2 \kappa
        \left(\operatorname{diag}(1/n_b) + \frac{\lambda}{\bar n} R_\rho\right) ,

:math:`R_\rho` a first-order autoregression over blocks on the clock. ρ and λ maximise the
restricted likelihood [1]_ over a grid: the inverse of :math:`R_\rho` is tridiagonal, and odd-even
reduction [2]_ takes all points at once. Which of the two directions it is, the same likelihood
tells. An error that scales keeps the level of the flow, as that leakage lies in what the columns
span [4]_; an error that adds lets it go, and leaves the estimates to the slopes within blocks,
which a model that is not quite right does not describe. A Kalman filter whitens the means as a
Cholesky factor does [3]_. At λ = 0 the whitened factors are those of the samples.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to
   related problems", *Journal of the American Statistical Association*, 72(358), 1977.
.. [2] R. W. Hockney, "A fast direct solution of Poisson's equation using Fourier analysis",
   *Journal of the ACM*, 12(1), 1965.
.. [3] A. C. Harvey, *Forecasting, Structural Time Series Models and the Kalman Filter*, Cambridge
   University Press, 1989, section 3.4.
.. [4] W. Kruskal, "When are Gauss-Markov and least squares estimators identical? A coordinate-free
   approach", *Annals of Mathematical Statistics*, 39(1), 1968.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leakage.arrays import Array, Mask, Places
from leakage.estimation.blocks import ROUNDING, merge, sample_count

# Relative size below which a column does not vary within blocks, or depends on others.
RANK_TOLERANCE = 1e-9
# Grid of the restricted likelihood: memory from block to block, and variance over that of a mean.
MEMORIES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995)
RATIOS = tuple(10.0 ** (half / 2) for half in range(-2, 10))
# −2 Δ log REML from which on slow errors are taken for real: what AIC asks for two parameters.
EVIDENCE = 4.0
# Factor on half-widths that makes up for ρ and λ being estimates: simulated coverage.
WIDENING = 1.25
# Largest variance of a slow error, over that of the means' errors under least squares: more
# would throw away what the means say of the level, and doubled the error of the leakage.
LARGEST_SLOW = 4.0
# Neighbouring samples act at most as 1 in 3, or nothing within a block could tell.
LEAST_WITHIN = 3.0
# Fewer blocks tell nothing of a memory.
LEAST_BLOCKS = 5
# Degrees of freedom that a leakage needs: with 2, 94 to 97 % of intervals held.
LEAST_FREEDOM_LEAKAGE = 2.0


@dataclass(frozen=True, slots=True)
class SlowErrors:
    """Correlation of the errors of a window from block to block."""

    memory: float  # ρ: correlation of neighbouring blocks' slow errors
    variance_ratio: float  # λ: variance of the slow error over that of a block's mean without it
    within: float  # κ: effective variance of the errors within a block, over their own
    evidence: float  # −2 Δ log REML of λ = 0 against the best fit
    scales: bool  # the slow error scales the estimated leakage; otherwise it adds to the flow
    direction: Array  # weights of the columns whose sum it is a multiple of, shape (c,)

    @property
    def are_slow(self) -> bool:
        """True if the errors are correlated beyond a block, so that the means must be whitened."""
        return self.memory > 0.0 and self.evidence >= EVIDENCE

    @property
    def widening(self) -> float:
        """Factor on half-widths that makes up for memory and size being estimates."""
        return WIDENING if self.are_slow else 1.0

    def hides_level(self, number: Places) -> bool:
        """Return True if blocks at these places of the clock hold too few turns to tell a level.

        A mean knows as much of an error of memory τ as T / 2τ independent stretches.
        """
        duration = float(number[-1] - number[0] + 1)
        stretches = 2.0 * self.memory_s(1.0) * LEAST_FREEDOM_LEAKAGE
        return self.scales and stretches > duration

    def memory_s(self, block_s: float) -> float:
        """Return time in which the slow error forgets [s], from the length of a block; 0: none."""
        return -block_s / math.log(self.memory) if self.are_slow else 0.0


NOT_SLOW = SlowErrors(0.0, 0.0, 1.0, 0.0, False, np.empty(0))


class Means(NamedTuple):
    """Blocks along the direction of their slow errors."""

    n: Array  # squared norm of the direction, shape (b,): samples where the error adds
    usual_n: float  # their median
    values: Array  # means of the columns along it, shape (b, c)
    number: Places  # places of the blocks on the clock

    @classmethod
    def along(cls, factors: Array, direction: Array, number: Places) -> Means:
        """Return means of the factors of blocks, (b, c, c), along a sum of their columns."""
        along = factors @ direction
        n = np.einsum("bi,bi->b", along, along)
        # A block without flow has nothing that an error could scale.
        n = np.maximum(n, max(ROUNDING * float(n.mean()), np.finfo(np.float64).tiny))
        means = (along[:, None] @ factors)[:, 0] / n[:, None]
        return cls(n, float(np.median(n)), means, number)

    def of(self, design: Array) -> Means:
        """Return the same of combinations of the columns, shape (c, d)."""
        return self._replace(values=self.values @ design)

    def grams(self) -> Array:
        """Return what they say of the columns, shape (b, c, c)."""
        outer: Array = (self.n[:, None] * self.values)[:, :, None] * self.values[:, None]
        return outer


def slow_errors(
    factors: Array,
    number: Places,
    fixed: Mask,
    values: Array,
    whole: Array | None = None,
    scales: bool | None = None,
) -> SlowErrors:
    """Return memory, size and direction of slow errors; no memory where it cannot be estimated.

    `factors, number`: Triangular factors of the blocks in time order, shape (b, c, c), and the
    place of each on the clock, in blocks, shape (b,).
    `fixed, values`: Coefficients that are held, and the values they are held at; shape (p + 1,).
    `whole`: The merged factor of the blocks, where it is known.
    `scales`: Look at errors that scale, or that add, alone; None: at both.
    """
    whole = merge(factors) if whole is None else whole
    design = _design(whole, fixed, values)
    if design is None or len(number) < LEAST_BLOCKS:
        return NOT_SLOW
    ones = np.eye(len(whole))[-3]
    directions = {False: ones}
    expected = np.append(np.where(fixed, 0.0, -design[:-2, -1])[:-1], np.zeros(3))
    mean_leakage = float((whole @ ones) @ (whole @ expected)) / sample_count(whole)
    if mean_leakage > 0.0:
        directions[True] = expected / mean_leakage
    if scales in directions:
        directions = {scales: directions[scales]}
    blocks = {
        scales: Means.along(factors, direction, number).of(design)
        for scales, direction in directions.items()
    }
    seen = factors @ design
    grams = seen.transpose(0, 2, 1) @ seen
    errors = {
        scales: _within_errors(grams - block.grams(), block, sample_count(whole))
        for scales, block in blocks.items()
    }
    # Both are held against the same size of the errors: that of the direction that leaves less.
    variance, within = min(errors.values(), key=lambda error: error[0] * error[1])
    if not variance * sample_count(whole) > (ROUNDING * np.linalg.norm(whole[:, -1])) ** 2:
        return NOT_SLOW
    estimates = {
        scales: _most_likely(whole @ design, block, variance * within)
        for scales, block in blocks.items()
    }
    scales = max(sorted(estimates, reverse=True), key=lambda direction: estimates[direction][2])
    memory, ratio, evidence = estimates[scales]
    return SlowErrors(memory, ratio, within, evidence, scales, directions[scales])


def _most_likely(free: Array, means: Means, variance: float) -> tuple[float, float, float]:
    """Return ρ and λ of the grid by their restricted likelihood, and −2 Δ log REML of none.

    `free` has the design of the whole, `means` that of the blocks, and `variance` is σ²κ.
    """
    rank = free.shape[1] - 1
    memories, ratios = (values.ravel() for values in np.meshgrid(MEMORIES, RATIOS))
    seen = float(np.average(means.values[:, rank] ** 2, weights=means.n))
    possible = ratios <= LARGEST_SLOW * seen * means.usual_n / variance
    memories, ratios = memories[possible], ratios[possible]
    explained, log_variance = _explained_by_slow(means, memories, ratios)
    information = free.T @ free - explained
    x, score = information[:, :rank, :rank], information[:, :rank, rank]
    fitted = np.einsum("gi,gi->g", score, np.linalg.solve(x, score[:, :, None])[:, :, 0])
    squares = (information[:, rank, rank] - fitted) / variance
    deviance = log_variance + np.linalg.slogdet(x)[1] + squares
    best = int(np.argmin(deviance))
    memory, ratio = ((0.0, *values.tolist())[best] for values in (memories, ratios))
    return memory, ratio, float(deviance[0] - deviance[best])


def whiten(factors: Array, number: Places, errors: SlowErrors) -> Array:
    """Return factors of samples whose slow errors are whitened; as they are where there are none.

    Shape (b, c, c), not triangular: each block's rest, with the whitened means in place of its own;
    scaled so that the column of ones keeps its norm, and with it the number of samples.
    """
    if not errors.are_slow:
        return factors
    means = Means.along(factors, errors.direction, number)
    root = np.sqrt(means.n)[:, None]
    moved = _whiten_means(means, errors) - root * means.values
    unit = factors @ errors.direction / root
    made = factors + unit[:, :, None] * moved[:, None]
    ones, before = made[:, :, -3], factors[:, :, -3]
    result: Array = made * np.sqrt(np.sum(before**2) / np.sum(ones**2))
    return result


def with_level(factors: Array, number: Places, errors: SlowErrors) -> Array:
    """Return factor of all blocks, whitened but for the level; arguments as for :func:`whitened`.

    Off its bounds, an estimate keeps the level under errors that scale. On them it does not: the
    slopes ask for what no gap can do. So the mean of all blocks keeps its weight, and what each
    differs by is whitened.
    """
    means = Means.along(factors, errors.direction, number)
    level = np.average(means.values, axis=0, weights=means.n)
    root = np.sqrt(means.n)[:, None]
    apart = means._replace(values=means.values - level)
    moved = _whiten_means(apart, errors) - root * means.values
    unit = factors @ errors.direction / root
    made = factors + unit[:, :, None] * moved[:, None]
    whole = np.zeros_like(factors[:1])
    whole[0, 0] = math.sqrt(means.n.sum()) * level
    return merge(np.concatenate([made, whole]))


def _design(whole: Array, fixed: Mask, values: Array) -> Array | None:
    """Return what makes columns an orthonormal basis of the free ones and least squares' errors."""
    free = np.flatnonzero(~fixed)
    scale = np.linalg.norm(whole[:, free], axis=0)
    scale[scale == 0.0] = 1.0
    left, size, rotation = np.linalg.svd(whole[:, free] / scale, full_matrices=False)
    clear = size > RANK_TOLERANCE * size.max(initial=0.0)
    if not clear.any():
        return None
    known = np.append(np.where(fixed, values, 0.0), (1.0, -1.0))
    to_basis = (rotation[clear] / size[clear, None] / scale).T
    design = np.zeros((whole.shape[1], int(clear.sum()) + 1))
    design[free, :-1] = to_basis
    design[:, -1] = -known
    design[:, -1] -= design[:, :-1] @ (left[:, clear].T @ (whole @ -known))
    return design


def _within_errors(gram: Array, means: Means, n_samples: int) -> tuple[float, float]:
    """Return variance of the errors about the means, and κ: meat over bread of their scores.

    `gram` has what each block says of the design about its mean, shape (b, rank + 1, rank + 1).
    """
    whole, rank = gram.sum(axis=0), gram.shape[1] - 1
    size, vectors = np.linalg.eigh(whole[:rank, :rank])
    moving = size > RANK_TOLERANCE
    basis = vectors[:, moving] / np.sqrt(size[moving])
    estimate = basis @ (basis.T @ whole[:rank, rank])
    squares = float(whole[rank, rank] - estimate @ whole[:rank, rank])
    freedom = n_samples - len(gram) - basis.shape[1]
    if freedom < 1 or squares <= 0.0:
        return 0.0, 1.0
    variance = squares / freedom
    leverage = basis.T @ gram[:, :rank, :rank] @ basis
    scores = (gram[:, :rank, rank] - gram[:, :rank, :rank] @ estimate) @ basis
    # Of independent errors, scores about an estimate scatter by this much less than rank.
    expected = basis.shape[1] - float(np.sum(leverage**2))
    if expected <= RANK_TOLERANCE:
        return variance, 1.0
    most = max(means.usual_n / LEAST_WITHIN, 1.0)
    within = float(np.sum(scores**2)) / (variance * expected)
    return variance, min(max(within, 1.0), most)


def _explained_by_slow(means: Means, memory: Array, ratio: Array) -> tuple[Array, Array]:
    """Return part of the means' weighted Gram that slow errors explain, and log |V| + log |W|.

    With W the weights of the means, V their covariance and Q the tridiagonal inverse of that of
    the slow errors, V⁻¹ = W − W (W + Q)⁻¹ W and |V| |W| = |W + Q| / |Q|. Each turn eliminates every
    other block of W + Q. The first point is that of no slow error; shapes (1 + g, c, c), (1 + g,).
    """
    weights, alone = means.n[:, None], means.usual_n / ratio
    # Blocks of two nights may be rounded to the same place.
    memories = memory ** np.maximum(np.diff(means.number), 1)[:, None]
    given_before = np.vstack([alone, alone / (1.0 - memories**2)])
    beside = -memories * given_before[1:]
    size = weights + given_before
    size[:-1] -= memories * beside
    right = (weights * means.values).T[:, :, None]
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


def _whiten_means(means: Means, errors: SlowErrors) -> Array:
    """Return means whitened by a Kalman filter, shape (b, c)."""
    size = errors.variance_ratio / means.usual_n
    steps = np.diff(means.number, prepend=means.number[:1]).tolist()
    rows = np.empty_like(means.values)
    state, after = np.zeros(means.values.shape[1]), size
    for step, noise, mean, row in zip(
        steps, (1.0 / means.n).tolist(), means.values, rows, strict=True
    ):
        faded = errors.memory**step
        spread = faded * faded * after + (1.0 - faded * faded) * size
        variance = spread + noise
        after = spread * noise / variance
        state *= faded
        np.subtract(mean, state, out=row)
        state += spread / variance * row
        row /= math.sqrt(variance)
    return rows

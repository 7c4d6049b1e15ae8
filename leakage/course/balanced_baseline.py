r"""A baseline at the duty of now: its blocks, weighted until their conditions are those of now.

A wrong model gives other loss factors at another duty, although nothing has worn. So the blocks of
the baseline are weighted by entropy balancing [1]_: of all weights that give their features
:math:`m_b` the means :math:`\bar m` of now, those nearest to the numbers of samples :math:`n_b`,

.. math:: w_b \propto n_b \exp(\lambda^T m_b) , \qquad
    \lambda = \arg\min \; \log \sum_b n_b \exp\bigl(\lambda^T (m_b - \bar m)\bigr)
    + \tfrac{\varrho}{2} \lVert \lambda \rVert^2 ,

which is convex and takes a few steps of Newton's method. The features are the means of all products
of two of the columns (paths, one, known) over a block's samples, and P, T, W, P², PW, PT of its
mean pressure, temperature and speed, in standard deviations of the baseline's blocks.

References
----------
.. [1] J. Hainmueller, "Entropy balancing for causal effects", *Political Analysis*, 20(1), 2012.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import merge
from leakage.estimation.certificate import certify
from leakage.estimation.uncertainty import cluster_robust

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RIDGE = 3e-3
# Blocks of now outside these quantiles of the baseline's pressure, temperature or speed are left
# out.
OUTERMOST = 0.005
# Fewest blocks of now, fewest effective ones of the baseline, and largest difference that may be
# left of a feature, in standard deviations of the baseline's blocks.
LEAST_BLOCKS, LEAST_EFFECTIVE, LARGEST_IMBALANCE = 20, 30.0, 0.15
STEPS, CONVERGED = 50, 1e-9
# A rise is told above this, over ten nights and less so many standard errors.
LEAST_RISE, CERTAIN, NIGHTS_OF_NOW = 0.05, 2.5, 10
# Where fewer of the baseline's blocks are left than this share, the flow must have risen as well:
# by this part of what the rise means, and by so much.
FEW, CLOSED, LEAST_CLOSED = 0.5, 0.5, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class DutyBlocks:
    """Blocks of some nights, with their conditions.

    Attributes
    ----------
    factors
        Triangular factors, shape (m, c, c), columns: paths, one, known, measured.
    conditions
        Mean temperature [°C], pressure [bar] and speed [rpm] of each block, shape (m, 3).
    nights
        Label of the night of each block, shape (m,), increasing.
    """

    factors: Array
    conditions: Array
    nights: NDArray[np.int64]

    def features(self) -> Array:
        """Features of each block, shape (m, k)."""
        columns = self.factors[:, :, :-1]
        products = columns.swapaxes(1, 2) @ columns
        first, second = np.triu_indices(products.shape[1])
        means = products[:, first, second] / products[:, -2, -2][:, None]
        temperature, pressure, speed = self.conditions.T
        more = (pressure**2, pressure * speed, pressure * temperature)
        found: Array = np.column_stack([means, self.conditions, *more])
        return found

    @property
    def samples(self) -> Array:
        """Samples of each block, shape (m,)."""
        n: Array = np.einsum("bi,bi->b", self.factors[:, :, -3], self.factors[:, :, -3])
        return n

    def part(self, chosen: Mask) -> DutyBlocks:
        """Some of the blocks."""
        return DutyBlocks(self.factors[chosen], self.conditions[chosen], self.nights[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Weights of a baseline's blocks.

    Attributes
    ----------
    weights
        Shape (m,); they sum to 1.
    effective
        Number of blocks that equal weights would need to tell as much.
    imbalance
        Largest difference left of a feature, in standard deviations of the baseline's blocks.
    """

    weights: Array
    effective: float
    imbalance: float


def balance(features: Array, samples: Array, target: Array) -> Balance:
    """Weights that give features of blocks, shape (m, k), the means of now, the target, shape (k,).

    The nearest that there is where the means cannot be reached: see its imbalance.

    Examples
    --------
    >>> found = balance(np.array([[0.0], [1.0]]), np.ones(2), np.array([0.75]))
    >>> found.weights.round(2), round(found.effective, 2)
    (array([0.25, 0.75]), 1.6)
    """
    n = samples / samples.sum()
    centre = n @ features
    size = np.sqrt(n @ (features - centre) ** 2)
    told = size > 1e-9 * np.abs(centre)
    scaled = (features[:, told] - target[told]) / size[told]
    slope = np.zeros(scaled.shape[1])
    weights, value = _weights(scaled, n, slope)
    for _ in range(STEPS):
        gradient = weights @ scaled + RIDGE * slope
        if np.abs(gradient).max(initial=0.0) < CONVERGED:
            break
        about = scaled - weights @ scaled
        curvature = (weights[:, None] * about).T @ about + RIDGE * np.eye(len(slope))
        step = np.linalg.solve(curvature, gradient)
        length = 1.0
        while True:
            tried, lower = _weights(scaled, n, slope - length * step)
            if lower <= value - 1e-4 * length * float(gradient @ step) or length < 1e-6:
                break
            length /= 2.0
        slope, weights, value = slope - length * step, tried, lower
    left = float(np.abs(weights @ scaled).max(initial=0.0))
    beside = np.abs(centre - target)[~told] > 1e-6 * np.abs(centre[~told])
    return Balance(weights, 1.0 / float(weights @ weights), np.inf if beside.any() else left)


def _weights(scaled: Array, n: Array, slope: Array) -> tuple[Array, float]:
    """Weights of a slope λ, and the function that it minimises."""
    power = scaled @ slope
    highest = power.max()
    raised = n * np.exp(power - highest)
    total = float(raised.sum())
    return raised / total, float(np.log(total) + highest + RIDGE / 2.0 * (slope @ slope))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A period against the baseline at its own duty.

    Attributes
    ----------
    then, now
        θ of the weighted baseline, and of now's blocks within its range, shape (c − 2,).
    root
        U with U'U the covariance of `then`, its nights being the clusters, shape (c − 2, c − 2); 0
        for what is not estimated.
    log_ratio
        ln of the measured flow of those blocks over what `then` says of them, without flushing,
        less the same of the weighted baseline; nan where one of them is not positive.
    effective_share
        Effective blocks of the baseline over all of its blocks.
    """

    then: Array
    now: Array
    root: Array
    log_ratio: float
    effective_share: float


def compare(before: DutyBlocks, now: DutyBlocks, lower: Array, upper: Array) -> Comparison | None:
    """Fit the baseline at the duty of now, and now.

    Parameters
    ----------
    before, now
        Blocks of the baseline, and of now.
    lower, upper
        Bounds of θ, shape (c − 2,); equal ones fix a coefficient.

    Returns
    -------
    Comparison or None
        None where the baseline has not seen the duty of now: fewer than 20 of now's blocks lie
        within its range, fewer than 30 of its own would tell as much as the weighted ones, a
        feature differs by more than 0.15 standard deviations, or fewer than two nights are left.

    Raises
    ------
    EstimationError
        If bounds or factors cannot give a minimum.
    """
    lowest, highest = np.quantile(before.conditions, [OUTERMOST, 1.0 - OUTERMOST], axis=0)
    inside = (now.conditions >= lowest) & (now.conditions <= highest)
    now = now.part(inside.all(axis=1))
    if len(now.nights) < LEAST_BLOCKS:
        return None
    n = before.samples
    found = balance(before.features(), n, now.samples @ now.features() / now.samples.sum())
    if found.effective < LEAST_EFFECTIVE or found.imbalance > LARGEST_IMBALANCE:
        return None
    weights = found.weights * n.sum() / n
    weighted = before.factors * np.sqrt(weights)[:, None, None]
    nights = np.array([merge(weighted[before.nights == one]) for one in np.unique(before.nights)])
    then = certify(merge(nights), lower, upper).coefficients
    distribution = cluster_robust(nights, then, lower < upper)
    if distribution is None:
        return None
    root = np.zeros((len(then),) * 2)
    root[np.ix_(distribution.active, distribution.active)] = distribution.covariance_root()
    whole = merge(now.factors)
    ratios = [_flow_ratio(one, then) for one in (whole, merge(nights))]
    return Comparison(
        then,
        certify(whole, lower, upper).coefficients,
        root,
        float(np.log(ratios[0] / ratios[1])) if min(ratios) > 0.0 else float("nan"),
        found.effective / len(before.nights),
    )


def _flow_ratio(whole: Array, theta: Array) -> float:
    """Measured over expected flow of some samples, without flushing; 0 where it is not positive."""
    sums = whole[:, -3] @ whole
    measured = sums[-1] - theta[-1] * sums[-3]
    expected = sums[:-3] @ theta[:-1] + sums[-2]
    return float(measured / expected) if measured > 0.0 and expected > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Rises:
    """A figure in nights of another duty, relative to the baseline at their duty; shape (n,) each.

    Attributes
    ----------
    rise, error
        Its rise, and the standard error of the baseline's figure; nan where there is none.
    part
        Share of the flow that the figure stands for.
    flow
        Rise of the flow.
    share
        Effective blocks of the baseline over all of its blocks.
    """

    rise: Array
    error: Array
    part: Array
    flow: Array
    share: Array


def told_rises(found: Rises, baseline_nights: int) -> Array:
    """Rise of each night that is told, over up to ten nights to it, shape (n,).

    The rise where it is certain and the flow closes with it; no rise where there may be none; nan
    between the two. A night scatters as one of the baseline's nights does.
    """
    result = np.full(len(found.rise), np.nan)
    known = np.flatnonzero(np.isfinite(found.rise))
    rise, error, part, flow, share = (
        _recent(values[known])
        for values in (found.rise, found.error, found.part, found.flow, found.share)
    )
    n = np.minimum(np.arange(len(known)) + 1, NIGHTS_OF_NOW)
    error = error * np.sqrt(1.0 + baseline_nights / n)
    closed = (flow >= CLOSED * part * rise) & (flow > LEAST_CLOSED)
    certain = (rise - CERTAIN * error > LEAST_RISE) & (closed | (share >= FEW))
    none = rise <= LEAST_RISE + error
    night = found.rise[known]
    result[known] = np.where(certain, night, np.where(none, np.minimum(night, 0.0), np.nan))
    return result


def _recent(values: Array) -> Array:
    """Mean of up to ten values up to each."""
    sums = np.cumsum(np.append(0.0, values))
    end = np.arange(1, len(sums))
    begin = np.maximum(end - NIGHTS_OF_NOW, 0)
    means: Array = (sums[end] - sums[begin]) / (end - begin)
    return means

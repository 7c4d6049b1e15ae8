"""What a motor does by itself from night to night: each night has its own shift of the paths.

Q is the covariance of these shifts, by expectation maximisation over the nights with a prior. Their
memory is that of their common direction, by the likelihood of its levels beside a straight line in
time: slow wear is no memory. A part of the wander may forget at once (operating conditions, under a
wrong model) and hide a long memory from the correlation of neighbours, so both parts are weighed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from leakage.arrays import Array
from leakage.watch import choices

MOST_PASSES, CONVERGED = 60, 1e-3
# Weight of a path in the prior of the wander is at least this share of its own unit.
LEAST_WEIGHT = 0.3


# Memories that a motor may have: correlation of neighbouring nights of a part of its wander, and
# that part's share of the variance; what is left forgets from night to night.
CORRELATIONS = np.array([0.3, 0.6, 0.8, 0.9, 0.95])
SHARES = np.array([0.25, 0.5, 0.75, 1.0])
PHI, SHARE = (grid.ravel() for grid in np.meshgrid(CORRELATIONS, SHARES, indexing="ij"))
# How likely each is before any night, on the safe side: too short a memory raises false alarms.
USUAL_MEMORY = np.repeat([0.1, 0.2, 0.3, 0.25, 0.15], len(SHARES)) / len(SHARES)


@dataclass(frozen=True, slots=True)
class Wander:
    """Covariance Q of a night's shift of the paths, shape (p, p), and its memory.

    `memory` has the probabilities of the memories, shape (g,), of the part of Q that moves the flow
    as a whole, `common`.
    """

    spread: Array
    memory: Array
    common: Array

    @property
    def serial(self) -> float:
        """Serial correlation of neighbouring nights."""
        return float(self.memory @ (SHARE * PHI))

    def degrees_of_freedom(self, n_nights: int, n_since: Array) -> Array:
        """Return those of a change's evidence so many nights ago: Q is an estimate from `n_nights`.

        They are correlated, and of what lasts long they show few.
        """
        squared = self.serial**2
        of_nights = (1.0 - squared) / (1.0 + squared)
        of_stretches = choices.STRETCHES / self.inflation(n_since)
        freedom: Array = n_nights * np.minimum(of_nights, of_stretches) + choices.WANDER_NIGHTS
        return freedom

    def inflation(self, n_nights: Array) -> Array:
        """Return by what the variance of a mean of nights is larger, shape of `n_nights`."""
        phi, n = PHI[:, None], n_nights
        series = phi / (1.0 - phi) - phi * (1.0 - phi**n) / (n * (1.0 - phi) ** 2)
        inflation: Array = 1.0 + 2.0 * (self.memory * SHARE) @ series
        return inflation

    def share_of_short(self, n_nights: Array) -> Array:
        """Return weight of sums with Q itself among those with Q and Q of a long record.

        So weighted, the information of so many nights is exact where their shifts outweigh the
        errors within nights, and where they do not.
        """
        long = self.long_inflation
        share: Array = (1.0 / self.inflation(n_nights) - 1.0 / long) / (1.0 - 1.0 / long)
        return share

    @property
    def long_inflation(self) -> float:
        """The same of a long record."""
        return float(1.0 + 2.0 * (self.memory * SHARE) @ (PHI / (1.0 - PHI)))

    @property
    def long_spread(self) -> Array:
        """Q of the mean of a long record, times its nights."""
        long = self.long_inflation
        rest = min(long, choices.LONG_OF_PATHS)
        spread: Array = long * self.common + rest * (self.spread - self.common)
        return spread


@dataclass(frozen=True, slots=True)
class WanderPrior:
    """Size of the common wander and probabilities of its memories, before any night."""

    size: float = choices.WANDER_SIZE
    memory: Array = field(default_factory=USUAL_MEMORY.copy)


def effective(information: Array, score: Array, spread: Array) -> Array:
    """Return what nights say whose paths shift by N(0, Q): information and score, (n, q, q + 1)."""
    p = len(spread)
    inner = np.linalg.inv(spread) + information[:, :p, :p]
    columns = np.concatenate([information, score[:, :, None]], axis=2)
    left: Array = columns - information[:, :, :p] @ np.linalg.solve(inner, columns[:, :p])
    return left


def estimate_wander(
    information: Array,
    score: Array,
    days: NDArray[np.int64],
    all_paths: Array,
    prior_information: Array,
    prior: WanderPrior,
) -> Wander:
    """Return Q and φ of some nights, from their information, scores and days.

    All unknowns, and a line in time of each path, stand beside the shifts: slow wear is no wander.
    """
    n, p, q = len(information), len(all_paths), len(prior_information)
    usual = _usual_spread(all_paths, prior)
    spread = usual
    times = (days - days.mean()) / choices.RAMP_DAYS
    certain_before = block_diag(prior_information, np.eye(p) * choices.LINE_PRIOR**-2)
    for _ in range(MOST_PASSES):
        nights = effective(information, score, spread)
        by_power = np.tensordot(times ** np.arange(3)[:, None], nights, 1)
        level, line, square = by_power[..., :-1]
        whole = np.block([[level, line[:, :p]], [line[:p], square[:p, :p]]])
        certain = np.linalg.inv(whole + certain_before).astype(np.float64)
        start_and_slope = certain @ np.concatenate([by_power[0, :, -1], by_power[1, :p, -1]])
        mean = np.repeat(start_and_slope[None, :q], n, axis=0)
        mean[:, :p] += times[:, None] * start_and_slope[q:]
        shifts = _squared_shifts(information, score, spread, mean, times, certain)
        new = (shifts.sum(axis=0) + choices.WANDER_NIGHTS * usual) / (n + choices.WANDER_NIGHTS)
        moved = np.abs(new - spread).max() / np.abs(new).max()
        spread = new
        if moved < CONVERGED:
            break
    memory = _memory(nights, mean, days, all_paths, prior)
    spread = _correct_for_correlation(spread, usual, days, memory)
    # What nights tell of all paths together.
    of_night = nights[:, :p, :p].mean(axis=0) @ all_paths
    of_flow = spread @ of_night
    return Wander(spread, memory, np.outer(of_flow, of_flow) / (of_night @ of_flow))


def _correct_for_correlation(
    spread: Array, usual: Array, days: NDArray[np.int64], memory: Array
) -> Array:
    """Return Q of correlated nights, which scatter less about their own line than the true line."""
    n, prior = len(days), choices.WANDER_NIGHTS
    line = np.linalg.qr(np.column_stack([np.ones(n), days - days.mean()]))[0]
    alike = sum(
        part * of_memory for part, of_memory in zip(memory, _correlations(days), strict=True)
    )
    left = n - float(np.sum(line * (alike @ line)))
    more = (n - line.shape[1]) / max(left, (1.0 - choices.MOST_OF_LINE) * n)
    of_nights = (n + prior) * spread - prior * usual
    corrected: Array = (more * of_nights + prior * usual) / (n + prior)
    return corrected


def _correlations(days: NDArray[np.int64]) -> Iterator[Array]:
    """Yield correlations of nights by each memory of the grid, shape (n, n)."""
    apart = np.abs(days[:, None] - days).astype(float)
    for phi, share in zip(PHI, SHARE, strict=True):
        yield share * phi**apart + (1.0 - share) * np.eye(len(days))


def _usual_spread(all_paths: Array, prior: WanderPrior) -> Array:
    own = np.diag(np.maximum(all_paths, LEAST_WEIGHT) ** 2)
    common = np.outer(all_paths, all_paths)
    mixed = (1.0 - choices.WANDER_COMMON) * own + choices.WANDER_COMMON * common
    usual: Array = prior.size**2 * mixed
    return usual


def _squared_shifts(
    information: Array, score: Array, spread: Array, mean: Array, times: Array, certain: Array
) -> Array:
    """Return expected outer products of the nights' shifts, (n, p, p); the mean is uncertain."""
    p = len(spread)
    inner = np.linalg.inv(np.linalg.inv(spread) + information[:, :p, :p])
    rest = score[:, :p] - (information[:, :p] @ mean[:, :, None])[:, :, 0]
    shift = (inner @ rest[:, :, None])[:, :, 0]
    lever = inner @ information[:, :p]
    lever = np.concatenate([lever, times[:, None, None] * lever[:, :, :p]], axis=2)
    uncertain = inner + lever @ certain @ lever.swapaxes(1, 2)
    squared: Array = uncertain + shift[:, :, None] * shift[:, None, :]
    return squared


def _memory(
    nights: Array, mean: Array, days: NDArray[np.int64], all_paths: Array, prior: WanderPrior
) -> Array:
    """Return probabilities of the memories by the levels of the common direction, shape (g,).

    By restricted likelihood, the variance profiled out.
    """
    n, p = len(nights), len(all_paths)
    night_information, night_score = nights[..., :-1], nights[..., -1]
    weight = np.einsum("nij,i,j->n", night_information[:, :p, :p], all_paths, all_paths)
    root = np.sqrt(np.maximum(weight, 1e-12))
    level = (
        (night_score - (night_information @ mean[:, :, None])[:, :, 0])[:, :p] @ all_paths / root
    )
    line = np.column_stack([root, root * (days - days.mean()) / max(float(np.ptp(days)), 1.0)])
    if n <= line.shape[1] + 1:
        return prior.memory
    log_likelihood = np.array(
        [_restricted_likelihood(level, line, correlation) for correlation in _correlations(days)]
    )
    weights = prior.memory * np.exp(log_likelihood - log_likelihood.max())
    memory: Array = weights / weights.sum()
    return memory


def _restricted_likelihood(values: Array, line: Array, covariance: Array) -> float:
    """Return ln of the restricted likelihood of values about a line, up to a constant."""
    n, columns = line.shape
    factor = np.linalg.cholesky(covariance)
    rows = np.linalg.solve(factor, np.column_stack([line, values]))
    design, whitened = rows[:, :-1], rows[:, -1]
    normal = design.T @ design
    rest = whitened - design @ np.linalg.solve(normal, design.T @ whitened)
    log_det = 2.0 * float(np.log(np.diag(factor)).sum()) + float(np.linalg.slogdet(normal)[1])
    cost: float = log_det + (n - columns) * math.log(float(rest @ rest))
    return -0.5 * cost

"""Errors of a night's blocks: a slow part, σ_s² exp(−Δt/τ), and a part of each block, σ_e².

By maximum likelihood over the baseline's residuals; a part that is constant over the night stands
in for the wander from night to night while that is not known, and is left out afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from leakage.arrays import Array, Mask
from leakage.watch import choices

# Where the search begins and where it may go: ln of the three errors and of τ [s].
START = np.log([0.01, 0.005, 0.007, 600.0])
CENTRE, REACH = -5.0, 5.0
LEAST_LOG_S, MOST_LOG_S = 3.0, 10.0
# A slow part of 1 % is likelier than none or a large part, worth a hundredth of a piece.
USUAL_LOG, USUAL_WEIGHT = -4.6, 0.01


@dataclass(frozen=True, slots=True)
class BlockErrors:
    """Standard deviations of the slow part, of each block and of a whole night; τ [s]."""

    slow: float
    block: float
    night: float
    memory_s: float

    @classmethod
    def of(cls, logarithms: Array) -> BlockErrors:
        return cls(*np.exp(logarithms).tolist())

    @property
    def logarithms(self) -> Array:
        return np.log([self.slow, self.block, self.night, self.memory_s])

    def covariance(
        self, middle_s: Array, wider: Array | None = None, *, with_night: bool = False
    ) -> Array:
        """Return the residuals' covariance, shape (b, b); `wider` multiplies σ_e² by block."""
        apart = np.abs(middle_s[:, None] - middle_s)
        own = np.full(len(middle_s), self.block**2)
        covariance: Array = self.slow**2 * np.exp(-apart / self.memory_s)
        covariance[np.diag_indices_from(covariance)] += own if wider is None else own * wider
        return covariance + self.night**2 if with_night else covariance


def estimate_errors(
    nights: Sequence[tuple[Array, Array]], start: BlockErrors, tolerance: float = 0.01
) -> BlockErrors:
    """Return errors by maximum likelihood from times [s] and residuals of some nights.

    `tolerance` is that of the logarithms of the errors.
    """
    from scipy.optimize import minimize

    apart, products, is_real, number = _pieces(nights)
    each = np.arange(apart.shape[1])

    def likelihood(errors: BlockErrors) -> float:
        """Return −2 ln of it, up to a constant."""
        slow = errors.slow**2 * np.exp(-apart / errors.memory_s) + errors.night**2
        covariance = np.where(is_real, slow, 0.0)
        own = is_real[:, each, each]
        covariance[:, each, each] += np.where(own, errors.block**2, 1.0)
        log_det = 2.0 * np.log(np.linalg.cholesky(covariance)[:, each, each]).sum(axis=1)
        return float(number @ log_det + (np.linalg.inv(covariance) * products).sum())

    def cost(logarithms: Array) -> float:
        if np.any(np.abs(logarithms[:3] - CENTRE) > REACH):
            return np.inf
        if not LEAST_LOG_S < logarithms[3] < MOST_LOG_S:
            return np.inf
        usual = USUAL_WEIGHT * (logarithms[0] - USUAL_LOG) ** 2
        return float(usual) + likelihood(BlockErrors.of(logarithms))

    search = minimize(
        cost,
        start.logarithms,
        method="Nelder-Mead",
        options={"maxiter": 250, "xatol": tolerance, "fatol": tolerance},
    )
    return BlockErrors.of(search.x)


def _pieces(nights: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Mask, Array]:
    """Return pieces of nights of the same length, shorter filled up; of g rows of times.

    Times between blocks [s], products of their residuals, and what is not filled up, shape
    (g, b, b) each; how many pieces have these times, (g,).
    """
    every = np.concatenate([residuals for _, residuals in nights])
    spread = 1.4826 * np.median(np.abs(every - np.median(every)))
    most = choices.CLIP * spread + 1e-6
    pieces = [
        (middle_s[first:][: choices.PIECE_BLOCKS], residuals[first:][: choices.PIECE_BLOCKS])
        for middle_s, residuals in nights
        for first in range(0, len(middle_s), choices.PIECE_BLOCKS)
    ]
    if len(pieces) > choices.MOST_PIECES:
        taken = np.linspace(0, len(pieces) - 1, choices.MOST_PIECES).astype(int)
        pieces = [pieces[place] for place in taken]
    # Blocks of most nights have the same times: their products serve together.
    alike: dict[tuple[int, ...], list[Array]] = {}
    for middle_s, residuals in pieces:
        times = tuple(np.round((middle_s - middle_s[0]) / 10.0).astype(int).tolist())
        alike.setdefault(times, []).append(np.clip(residuals, -most, most))
    length = max(map(len, alike))
    apart, products = np.zeros((2, len(alike), length, length))
    is_real = np.zeros(apart.shape, dtype=np.bool_)
    for place, (times, values) in enumerate(alike.items()):
        own, at_s = slice(len(times)), 10.0 * np.array(times, dtype=float)
        apart[place, own, own] = np.abs(at_s[:, None] - at_s)
        products[place, own, own] = np.array(values).T @ np.array(values)
        is_real[place, own, own] = True
    number = np.array([len(values) for values in alike.values()], dtype=float)
    return apart, products, is_real, number


def night_information(
    design: Array, residuals: Array, middle_s: Array, errors: BlockErrors, n_paths: int
) -> tuple[Array, Array]:
    """Return information S'V⁻¹S, shape (q, q), and score S'V⁻¹r, shape (q,), of a night.

    Any rank will do. Blocks that the others of their night contradict, whatever its own paths do,
    count less.
    """
    wider = variance_factors(design[:, :n_paths], residuals, middle_s, errors)
    factor = cho_factor(errors.covariance(middle_s, wider), lower=True, check_finite=False)
    weighted = cho_solve(factor, np.column_stack([design, residuals]), check_finite=False)
    return design.T @ weighted[:, :-1], design.T @ weighted[:, -1]


def variance_factors(paths: Array, residuals: Array, middle_s: Array, errors: BlockErrors) -> Array:
    """Return factors on the variance of blocks that others of their night contradict, (b,)."""
    wider = np.ones(len(residuals))
    if len(residuals) < 5:
        return wider
    own = paths @ paths.T
    for _ in range(choices.ROBUST_PASSES):
        precision = np.linalg.inv(errors.covariance(middle_s, wider) + own)
        score = precision @ residuals / np.sqrt(np.diag(precision))
        new = wider * np.maximum(1.0, (score / choices.ROBUST) ** 2)
        if np.allclose(new, wider):
            break
        wider = new
    return wider


def unexplained_share(flow: Array, expected: Array, conditions: Array, least: float) -> float:
    """Return the share of a night's flow that its conditions do not explain; nan: too short.

    Of the mean flow, measured or expected, and of `least` [l/min] at least.

    Root mean square of what stays of the flow, shape (b,), beside any smooth function of the
    expected flow, shape (b,), and of temperature, pressure and speed, shape (b, 3): wear of any
    law, another oil and a meter's gain are none of it. A flow that hardly varies, where the
    expected does, has nothing explained.
    """
    spread = conditions.std(axis=0)
    varies = spread > choices.LEAST_SPREAD * np.abs(conditions).max(axis=0)
    terms = ((conditions - conditions.mean(axis=0)) / np.where(varies, spread, 1.0))[:, varies]
    rows, columns = np.triu_indices(terms.shape[1])
    design = np.column_stack(
        [np.ones(len(flow)), expected, terms, terms[:, rows] * terms[:, columns]]
    )
    if len(flow) < choices.BLOCKS_A_TERM * design.shape[1]:
        return math.nan
    fitted, _, rank, _ = np.linalg.lstsq(design, flow, rcond=choices.LEAST_SPREAD)
    left, freedom = flow - design @ fitted, len(flow) - int(rank)
    if flow.std() * expected.mean() < choices.LEAST_RESPONSE * expected.std() * flow.mean():
        left, freedom = flow - expected * (flow.mean() / expected.mean()), len(flow)
    scale = max(float(flow.mean()), float(expected.mean()), least)
    return math.sqrt(float(left @ left) / freedom) / scale

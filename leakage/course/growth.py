r"""Growth of each flow since the baseline, and of the flushing where that is estimated.

The blocks of the baseline (0) and of now (1) are each fitted with the loss factors and the scale of
the known flow, relative to their configured values, and

.. math:: \delta = \theta_1 / \theta_0 - 1, \qquad V = D (V_1 + \rho^2 V_0) D, \quad
          V_0 = B_0 \textstyle\sum u_0 u_0' B_0, \quad V_1 = n_1 B_1 M B_1

with the bias-reduced scores u of the nights, M their mean outer product over both periods, those
of the baseline times ρ² where the flow has grown,
:math:`D = \operatorname{diag}(1/\theta_0)` and ρ the ratio of the flows. Directions of θ that the
baseline does not tell within 1/8 are left out: where speed does not vary, that of the rollers
against the pistons, so that both together are the standard.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.errors import ShapeError

Array: TypeAlias = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Relative standard error of the baseline up to which a direction of θ is judged.
LEAST_KNOWN: Final = 1.0 / 8.0
# Nights of now from which on the change with temperature is estimated.
NIGHTS_OF_BETA: Final = 6
RANK_TOLERANCE: Final = 3e-5
LEAST_SIZE: Final = 0.1
UNKNOWN: Final = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks of the nights of a period.

    Attributes
    ----------
    factors
        Triangular factors, shape (m, c, c), columns: paths, one, known, measured.
    nights
        Label of the night of each block, shape (m,), increasing.
    temperature_c
        Mean temperature of each block, shape (m,); None where it is not known.
    """

    factors: Array
    nights: NDArray[np.int64]
    temperature_c: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """Change of the flow of the gaps and of the estimated flushing, at the conditions of now.

    Attributes
    ----------
    gaps, flushing
        Over the flow of the gaps before.
    covariance
        Of both, shape (2, 2).
    flow
        Of the gaps before, in the unit of the measured flow.
    """

    gaps: float
    flushing: float
    covariance: Array
    flow: float


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """Relative change of each flow since the baseline, in the directions that are known.

    Attributes
    ----------
    names
        Of the paths, and last of the known flow where there is one, k of them.
    has_standard
        Whether there is a known flow.
    change, covariance
        P'δ and P'VP, shapes (r,) and (r, r).
    directions
        P, orthonormal, shape (k, r).
    with_temperature
        Change of the common factor with temperature, and its standard error [1/K]; None where the
        nights do not tell it.
    shift
        Of the gaps and the flushing; None where the flushing is not estimated.
    """

    names: tuple[str, ...]
    has_standard: bool
    change: Array
    covariance: Array
    directions: Array
    with_temperature: tuple[float, float] | None = None
    shift: Shift | None = None


def growth(
    names: tuple[str, ...],
    before: Blocks,
    now: Blocks,
    configured: Array,
    free: Mask,
    standard: str = "known",
) -> Growth | None:
    """Relative change of each path's flow between two periods.

    Parameters
    ----------
    names
        Of the paths with a column, p of them.
    before, now
        Blocks of the baseline and of the nights since the change. Where K changes with temperature,
        their columns hold that.
    configured
        θ as configured, shape (p + 1,), positive for free paths.
    free
        Which of θ are estimated, shape (p + 1,); a path that is not counts to the known flow.
    standard
        Name of the known flow.

    Returns
    -------
    Growth or None
        None with fewer than two nights before or none now, or where nothing is known well enough.

    Raises
    ------
    ShapeError
        ``shape``.
    """
    p = len(names)
    for one in (before, now):
        if one.factors.shape[1:] != (p + 3, p + 3) or len(one.nights) != len(one.factors):
            raise ShapeError(
                "shape",
                f"{p} paths with blocks {one.factors.shape} of nights {one.nights.shape}; "
                f"expected (m, {p + 3}, {p + 3}) and (m,)",
            )
    if len(np.unique(before.nights)) < 2 or not len(now.nights):
        return None
    told = tuple(name for name, one in zip(names, free[:p], strict=True) if one)
    sides = [_columns(one.factors, configured, free) for one in (before, now)]
    has_standard = bool(np.any(sides[0][0][:, :, len(told)]))
    k = len(told) + has_standard
    kept = [*range(k), *([len(told) + 1] if free[p] else [])]
    start = np.where(np.arange(len(kept)) < k, 1.0, configured[p])
    with_temperature = len(np.unique(now.nights)) >= NIGHTS_OF_BETA and not any(
        one.temperature_c is None for one in (before, now)
    )
    theta = start[:k]
    if with_temperature:
        theta = _Fit.of(sides[0][0][:, :, kept], sides[0][1], before.nights, start).theta[:k]
    fits = []
    for period, (design, flow) in zip((before, now), sides, strict=True):
        columns: Array = design[:, :, kept]
        if with_temperature and period.temperature_c is not None:
            above = period.temperature_c - np.mean(period.temperature_c)
            warming = above[:, None] * (columns[:, :, :k] @ theta)
            columns = np.concatenate([columns, warming[:, :, None]], axis=2)
        padded = np.append(start, np.zeros(columns.shape[2] - len(kept)))
        fits.append(_Fit.of(columns, flow, period.nights, padded))
    names = told + (standard,) * has_standard
    found = _relative(names, has_standard, fits[0], fits[1], with_temperature)
    return replace(found, shift=_shift(k, *fits)) if found and free[p] else found


def _columns(factors: Array, configured: Array, free: Mask) -> tuple[Array, Array]:
    """Flows as configured: free paths, known, one; and the measured flow without the fixed one."""
    p = factors.shape[-1] - 3
    flows = factors[:, :, :p] * configured[:p]
    known = factors[:, :, -2] + flows[:, :, ~free[:p]].sum(axis=2)
    fixed = 0.0 if free[p] else configured[p]
    design = np.concatenate(
        [flows[:, :, free[:p]], known[:, :, None], factors[:, :, -3][:, :, None]], axis=2
    )
    return design, factors[:, :, -1] - fixed * factors[:, :, -3]


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Least squares of a period."""

    theta: Array
    root: Array  # L with LL' = (X'X)⁺, shape (q, r)
    unseen: Array  # the directions that X does not see
    errors: Array  # scores of the nights in the basis of L, shape (n, r)
    gram: Array  # X'X

    @classmethod
    def of(cls, columns: Array, flow: Array, nights: NDArray[np.int64], start: Array) -> _Fit:
        """The minimum nearest to `start` where X does not tell all of θ."""
        _, first = np.unique(nights, return_index=True)
        gram = np.einsum("bij,bik->jk", columns, columns)
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0.0] = 1.0
        # Not of the Gram, which has half the digits: a night may tell a direction all alone.
        whole = np.linalg.qr((columns / scale).reshape(-1, len(scale)), mode="r")
        _, values, vectors = np.linalg.svd(whole)
        seen = values > RANK_TOLERANCE * values[0]
        root = (vectors[seen] / values[seen, None] / scale).T
        basis = columns @ root
        theta = start + root @ np.einsum("bij,bi->j", basis, flow - columns @ start)
        inside = np.add.reduceat(np.einsum("bij,bik->bjk", basis, basis), first)
        scores = np.add.reduceat(np.einsum("bij,bi->bj", basis, flow - columns @ theta), first)
        left, turn = np.linalg.eigh(np.eye(inside.shape[-1]) - inside)
        adjust = (turn / np.sqrt(np.maximum(left, 1e-8))[:, None, :]) @ turn.transpose(0, 2, 1)
        errors = np.einsum("bij,bj->bi", adjust, scores)
        hidden = (vectors[~seen] / scale).T
        hidden = hidden / np.linalg.norm(hidden, axis=0)
        return cls(theta, root, hidden @ hidden.T, errors, gram)


def _relative(
    names: tuple[str, ...], has_standard: bool, before: _Fit, now: _Fit, with_temperature: bool
) -> Growth | None:
    k = len(names)
    then, since = before.theta[:k], now.theta[:k]
    ratio, known, error = _errors(k, before, now)
    base = (known + UNKNOWN * before.unseen)[:k, :k]
    # Pulled towards the configured values by as much as these are known: to within themselves.
    pulled = np.linalg.solve(np.eye(k) + base, before.theta[:k] - 1.0)
    theta = np.maximum(1.0 + pulled, LEAST_SIZE)
    inverse = 1.0 / np.outer(theta, theta)
    values, vectors = np.linalg.eigh(base * inverse)
    directions = vectors[:, values < LEAST_KNOWN**2]
    if not directions.shape[1]:
        return None
    whole = (error + ratio * known + UNKNOWN * now.unseen)[:k, :k] * inverse
    beta = None
    if with_temperature:
        beta = (
            float(now.theta[-1] - before.theta[-1]),
            math.sqrt(float(error[-1, -1] + known[-1, -1])),
        )
    return Growth(
        names,
        has_standard,
        directions.T @ ((since - then) / theta),
        directions.T @ whole @ directions,
        directions,
        beta,
    )


def _errors(k: int, before: _Fit, now: _Fit) -> tuple[float, Array, Array]:
    """Flow of the gaps now over before, and the covariances of θ before and now."""
    then, since = before.theta[:k], now.theta[:k]
    gram = now.gram[:k, :k]
    ratio = float((since @ gram @ since) / (then @ gram @ then))
    # What each night moves θ by; of the nights before, had they been of now. No product with
    # (X'X)⁺, whose rounding hides what is known well where paths look alike.
    own, new = (one.errors @ one.root.T for one in (before, now))
    moved = before.errors @ (before.gram @ before.root).T @ now.root @ now.root.T
    share = len(now.errors) / (len(before.errors) + len(now.errors))
    # Errors grow with the flow.
    return ratio, own.T @ own, share * (max(ratio, 1.0) * moved.T @ moved + new.T @ new)


def _shift(k: int, before: _Fit, now: _Fit) -> Shift | None:
    """Change of the flows of the gaps and the flushing, which is θ_k; None without a flow."""
    ratio, known, error = _errors(k, before, now)
    whole = (error + ratio * known + UNKNOWN * (now.unseen + before.unseen))[: k + 1, : k + 1]
    parts = np.zeros((2, k + 1))
    parts[0, :k], parts[1, k] = now.gram[k, :k] / now.gram[k, k], 1.0
    flow = float(parts[0, :k] @ before.theta[:k])
    if flow <= 0.0:
        return None
    parts /= flow
    gaps, flushing = (parts @ (now.theta - before.theta)[: k + 1]).tolist()
    return Shift(gaps, flushing, parts @ whole @ parts.T, flow)

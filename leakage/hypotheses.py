r"""A common factor of all flows, or growth of paths: the probability of each explanation.

Thinner oil, a temperature sensor that reads low and a meter's gain scale all flows by one factor;
wear lifts the flow of some paths. The known flow (the cam rollers) does not wear as gaps do, so
with a free scale it is the internal standard. The blocks of the baseline (0) and of now (1) are
each fitted with the loss factors and that scale, relative to their configured values, and

.. math:: \delta = \theta_1 / \theta_0 - 1, \qquad V = D (V_1 + \rho^2 V_0) D, \quad
          V_0 = B_0 \textstyle\sum u_0 u_0' B_0, \quad V_1 = n_1 B_1 M B_1

with the bias-reduced scores u of the nights, M their mean outer product over both periods, those
of the baseline times ρ² where the flow has grown,
:math:`D = \operatorname{diag}(1/\theta_0)` and ρ the ratio of the flows. Directions of θ that the
baseline does not tell within 1/8 are left out: where speed does not vary, that of the rollers
against the pistons, so that both together are the standard. For each explanation

.. math::
    S = V + 0.01^2 I + 0.012^2\, 11' + [\text{common}]\, \tau^2\, 11'
        + \sum_{\text{paths}} 0.4^2 e_i e_i' , \quad
    \ln L = -\tfrac12 \ln |S| - \tfrac{\nu + k}{2} \ln (1 + \delta' S^{-1} \delta / \nu)

with ν = 45, and :math:`2 \Phi` of mean over standard deviation of each path's growth, since wear
only grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from leakage.errors import ShapeError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Verdict: TypeAlias = Literal["path", "common", "no_change", "cannot_be_told"]

# Standard deviations of what the paths and all flows do by themselves, and of what changes.
PATH_WANDER: Final = 0.01
COMMON_WANDER: Final = 0.012
COMMON: Final = 0.2
GROWTH: Final = 0.4
FREEDOM: Final = 45.0
# Prior weights.
NO_CHANGE, ONE_PATH, MORE_PATHS, STANDARD, COMMON_ALONE = 0.2, 0.1, 0.02, 0.02, 0.3
COMMON_TOO: Final = 0.33
# In a circuit, of a factor that the other motors do not have, against one that they have.
OF_ITS_OWN: Final = 0.33
MOST_PATHS: Final = 3
# An explanation is told from this probability on.
PROBABLE: Final = 0.9
# A factor that differs from that of the other motors by more is the motor's own.
OWN_FACTOR: Final = 0.025
# Relative standard error of the baseline up to which a direction of θ is judged.
LEAST_KNOWN: Final = 1.0 / 8.0
# Part of a path that must lie in the directions that are judged.
LEAST_PART: Final = 0.1
# Nights of now from which on the change with temperature is estimated.
NIGHTS_OF_BETA: Final = 6
RANK_TOLERANCE: Final = 1e-9
LEAST_SIZE: Final = 0.1
UNKNOWN, ROUNDING = 1e3, 1e-12


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
    """

    names: tuple[str, ...]
    has_standard: bool
    change: Array
    covariance: Array
    directions: Array
    with_temperature: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class CommonFactor:
    """ln of the factor of all flows, with its standard deviation."""

    log: float
    sd: float


@dataclass(frozen=True, slots=True)
class Posterior:
    """Probability of the explanations of a change.

    Attributes
    ----------
    paths
        That a path, or the known flow by itself, has grown, by name.
    apart
        Those of them that the nights of the baseline tell apart from all others.
    unjudged
        Paths of which the nights of the baseline tell too little.
    any_path
        That any has grown.
    common
        That all flows have a common factor.
    factor
        That factor, if there is one.
    expected
        The same weighed with its probability: what other motors of the circuit hear.
    tank, own_sensor
        That there is a factor and it is that of the other motors of the circuit, and that it is
        another one; None without other motors.
    with_temperature
        As of `Growth`.
    has_standard
        Whether the known flow is told apart from all paths.
    """

    paths: dict[str, float]
    apart: tuple[str, ...]
    unjudged: tuple[str, ...]
    any_path: float
    common: float
    factor: CommonFactor
    expected: CommonFactor
    tank: float | None
    own_sensor: float | None
    with_temperature: tuple[float, float] | None
    has_standard: bool

    @property
    def named(self) -> tuple[str, ...]:
        """Paths that have probably grown; one that looks like others is never named alone."""
        return tuple(name for name in self.apart if self.paths[name] >= PROBABLE)

    @property
    def candidates(self) -> tuple[str, ...]:
        """Paths that may have grown, the likeliest first."""
        some = [name for name, one in self.paths.items() if one > 1.0 - PROBABLE]
        return tuple(sorted(some, key=lambda name: -self.paths[name]))

    @property
    def is_own(self) -> bool:
        """True if any path or a sensor of the motor itself explains the change."""
        return self.any_path >= PROBABLE or self.origin == "own_sensor"

    @property
    def is_of_tank(self) -> bool:
        """True if the other motors of the circuit have the same factor."""
        return self.tank is not None and self.tank >= PROBABLE

    @property
    def origin(self) -> Literal["tank", "own_sensor"] | None:
        """Origin of a common factor, as far as the other motors of the circuit show it."""
        if self.is_of_tank:
            return "tank"
        return "own_sensor" if (self.own_sensor or 0.0) >= PROBABLE else None

    def excludes(self, name: str) -> bool:
        """True if a path has probably not grown."""
        return name in self.paths and self.paths[name] <= 1.0 - PROBABLE

    @property
    def is_common(self) -> bool:
        """True if a common factor is probable, alone or beside paths."""
        return self.common >= PROBABLE

    @property
    def verdict(self) -> Verdict:
        """``path`` (see `named`), ``common``, ``no_change`` or ``cannot_be_told``."""
        if self.named:
            return "path"
        if self.any_path > 1.0 - PROBABLE:
            return "cannot_be_told"
        if self.is_common:
            return "common"
        return "cannot_be_told" if self.unjudged else "no_change"


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
    return _relative(names, has_standard, fits[0], fits[1], with_temperature)


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
    """Least squares of a period.

    θ, (X'X)⁺, the directions that X does not see, the nights' scores (n, q), and X'X.
    """

    theta: Array
    inverse: Array
    unseen: Array
    scores: Array
    gram: Array

    @classmethod
    def of(cls, columns: Array, flow: Array, nights: NDArray[np.int64], start: Array) -> _Fit:
        """The minimum nearest to `start` where X does not tell all of θ."""
        _, first = np.unique(nights, return_index=True)
        grams = np.add.reduceat(np.einsum("bij,bik->bjk", columns, columns), first)
        sums = np.add.reduceat(np.einsum("bij,bi->bj", columns, flow), first)
        gram = grams.sum(axis=0)
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0.0] = 1.0
        values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        seen = values > RANK_TOLERANCE * values[-1]
        root = vectors[:, seen] / np.sqrt(values[seen]) / scale[:, None]
        theta = start + root @ (root.T @ (sums.sum(axis=0) - gram @ start))
        inside = root.T @ grams @ root
        left, turn = np.linalg.eigh(np.eye(inside.shape[-1]) - inside)
        adjust = (turn / np.sqrt(np.maximum(left, 1e-8))[:, None, :]) @ turn.transpose(0, 2, 1)
        errors = np.einsum("bij,bj->bi", adjust, (sums - grams @ theta) @ root)
        hidden = vectors[:, ~seen] / scale[:, None]
        hidden = hidden / np.linalg.norm(hidden, axis=0)
        return cls(theta, root @ root.T, hidden @ hidden.T, errors @ (gram @ root).T, gram)


def _relative(
    names: tuple[str, ...], has_standard: bool, before: _Fit, now: _Fit, with_temperature: bool
) -> Growth | None:
    k, n_before, n_now = len(names), len(before.scores), len(now.scores)
    then, since = before.theta[:k], now.theta[:k]
    gram = now.gram[:k, :k]
    ratio = float((since @ gram @ since) / (then @ gram @ then))
    total = before.scores.T @ before.scores
    # Errors grow with the flow.
    mean = (max(ratio, 1.0) * total + now.scores.T @ now.scores) / (n_before + n_now)
    known = before.inverse @ total @ before.inverse
    error = n_now * now.inverse @ mean @ now.inverse
    base = (known + UNKNOWN * before.unseen)[:k, :k] + ROUNDING * np.eye(k)
    information = np.linalg.inv(base)
    pulled = np.linalg.solve(np.eye(k) + information, information @ (before.theta[:k] - 1.0))
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


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """One explanation of a change: the flows that have grown, and the kind of common factor."""

    weight: float
    grown: tuple[int, ...] = ()
    common: Literal["", "tank", "own"] = ""


def weigh(growth: Growth, others: CommonFactor | None = None) -> Posterior:
    """Probabilities of the explanations of a change.

    Parameters
    ----------
    growth
        From :func:`growth`.
    others
        The mean factor of the other motors of the oil circuit; None where none is known.

    Examples
    --------
    >>> names, one = ("ring", "piston", "sleeve", "roller"), np.ones(4)
    >>> thin = Growth(names, True, 0.25 * one, np.diag(1e-4 * one), np.eye(4))
    >>> found = weigh(thin)
    >>> found.verdict, round(float(np.exp(found.factor.log)), 2)
    ('common', 1.25)
    >>> worn = Growth(names, True, np.array([0.0, 0.0, 0.3, 0.0]), np.diag(1e-4 * one), np.eye(4))
    >>> weigh(worn).named
    ('sleeve',)
    """
    k = len(growth.names)
    n_paths = k - growth.has_standard
    told = np.sum(growth.directions**2, axis=1)
    paths = [one for one in range(n_paths) if told[one] >= LEAST_PART]
    hypotheses = _hypotheses(paths, range(n_paths, k), others is not None)
    one = growth.directions.T @ np.ones(k)
    base: Array = growth.covariance + PATH_WANDER**2 * np.eye(len(one))
    base = base + COMMON_WANDER**2 * np.outer(one, one)
    sides = GROWTH * growth.directions
    grown = np.array([[flow in this.grown for flow in range(k)] for this in hypotheses])
    priors = np.array([_common_prior(this, others) for this in hypotheses])
    mean, variance = priors[:, 0], priors[:, 1]
    spread = base + variance[:, None, None] * np.outer(one, one)
    inverse = np.linalg.inv(spread + np.einsum("hk,ki,kj->hij", grown.astype(float), sides, sides))
    rest = growth.change - mean[:, None] * one
    pull = np.einsum("hij,hj->hi", inverse, rest)
    square = np.sum(rest * pull, axis=1)
    logs = np.log([this.weight for this in hypotheses]) + np.linalg.slogdet(inverse)[1] / 2
    logs -= (FREEDOM + len(one)) / 2 * np.log1p(square / FREEDOM)
    # Of each path's growth: mean over standard deviation.
    left = np.sqrt(np.maximum(1.0 - np.einsum("ki,hij,kj->hk", sides, inverse, sides), 1e-12))
    is_growth = np.log(np.maximum(2.0 * ndtr(pull @ sides.T / left), 1e-300))[:, :n_paths]
    logs += np.sum(is_growth * grown[:, :n_paths], axis=1)
    is_common = np.array([bool(this.common) for this in hypotheses])
    shift = mean + variance * (pull @ one)
    known = variance * (1.0 - variance * np.einsum("i,hij,j->h", one, inverse, one))
    error = np.where(is_common, known, 0.0) + COMMON_WANDER**2
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    return _posterior(growth, hypotheses, weights, (shift, error), told, others)


def _hypotheses(
    paths: Sequence[int], standard: Sequence[int], has_others: bool
) -> list[_Hypothesis]:
    sets = [_Hypothesis(STANDARD, (one,)) for one in standard]
    for size in range(1, MOST_PATHS + 1):
        weight = ONE_PATH if size == 1 else MORE_PATHS
        sets += [_Hypothesis(weight, some) for some in combinations(paths, size)]
    with_path = [one for one in sets if one.grown[0] not in standard]
    kinds: tuple[tuple[Literal["tank", "own"], float], ...] = (("own", 1.0),)
    if has_others:
        kinds = ("tank", 1.0), ("own", OF_ITS_OWN)
    found = [_Hypothesis(NO_CHANGE), *sets]
    for kind, share in kinds:
        found.append(_Hypothesis(share * COMMON_ALONE, (), kind))
        found += [
            _Hypothesis(share * COMMON_TOO * one.weight, one.grown, kind) for one in with_path
        ]
    return found


def _common_prior(this: _Hypothesis, others: CommonFactor | None) -> tuple[float, float]:
    """Mean and variance of the relative change of all flows."""
    if this.common == "tank" and others is not None:
        return math.expm1(others.log), (math.exp(others.log) * others.sd) ** 2
    return 0.0, COMMON**2 if this.common else 0.0


def _posterior(
    growth: Growth,
    hypotheses: Sequence[_Hypothesis],
    weights: Array,
    common: tuple[Array, Array],
    told: Array,
    others: CommonFactor | None,
) -> Posterior:
    def probability(of: Array | list[bool]) -> float:
        return float(weights[np.asarray(of, dtype=np.bool_)].sum())

    factor = np.maximum(1.0 + common[0], LEAST_SIZE)
    log, sd = np.log(factor), np.sqrt(common[1]) / factor
    is_common = np.array([bool(one.common) for one in hypotheses])
    tank = own = None
    if others is not None:
        wide = np.hypot(sd, others.sd)
        apart = log - others.log
        same = ndtr((OWN_FACTOR - apart) / wide) - ndtr((-OWN_FACTOR - apart) / wide)
        same = np.where([one.common == "tank" for one in hypotheses], 1.0, same)
        tank = float(np.sum((weights * same)[is_common]))
        own = float(np.sum((weights * (1.0 - same))[is_common]))
    return Posterior(
        paths={
            name: probability([at in one.grown for one in hypotheses])
            for at, name in enumerate(growth.names)
            if told[at] >= LEAST_PART
        },
        apart=tuple(np.array(growth.names)[told >= PROBABLE].tolist()),
        unjudged=tuple(np.array(growth.names)[told < LEAST_PART].tolist()),
        any_path=probability([bool(one.grown) for one in hypotheses]),
        common=probability(is_common),
        factor=_mixture(weights * is_common, log, sd),
        expected=_mixture(weights, log, sd),
        tank=tank,
        own_sensor=own,
        with_temperature=growth.with_temperature,
        has_standard=growth.has_standard and bool(told[-1] >= PROBABLE),
    )


def _mixture(weights: Array, log: Array, sd: Array) -> CommonFactor:
    share = weights / max(float(weights.sum()), 1e-300)
    mean = float(share @ log)
    return CommonFactor(mean, math.sqrt(float(share @ (sd**2 + (log - mean) ** 2))))


def mean_factor(factors: Sequence[CommonFactor]) -> CommonFactor:
    """The factor of several motors together, which scatter by more than each one's error, maybe.

    Examples
    --------
    >>> mean_factor([CommonFactor(0.25, 0.02), CommonFactor(0.75, 0.02)])
    CommonFactor(log=0.5, sd=0.25)
    """
    n = len(factors)
    logs = np.array([one.log for one in factors])
    error = sum(one.sd**2 for one in factors) / n**2
    scatter = float(np.var(logs, ddof=1)) / n if n > 1 else 0.0
    return CommonFactor(float(np.mean(logs)), math.sqrt(max(error, scatter)))

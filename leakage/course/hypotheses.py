r"""A common factor of all flows, or growth of paths: the probability of each explanation.

Thinner oil, a temperature sensor that reads low and a meter's gain scale all flows by one factor;
wear lifts the flow of some paths. The known flow (the cam rollers) does not wear as gaps do, so
with a free scale it is the internal standard. With the growth δ of the flows and its covariance V
(:mod:`leakage.course.growth`), for each explanation

.. math::
    S = V + 0.01^2 I + 0.012^2\, 11' + [\text{common}]\, \tau^2\, 11'
        + \sum_{\text{paths}} 0.4^2 e_i e_i' , \quad
    \ln L = -\tfrac12 \ln |S| - \tfrac{\nu + k}{2} \ln (1 + \delta' S^{-1} \delta / \nu)

with ν = 45, and :math:`2 \Phi` of mean over standard deviation of each path's growth, since wear
only grows.

Oil moves the flow of all gaps and leaves the flushing where it is. Where the flushing is estimated,
a common factor is told only if the flushing did not take the change back, by the joint covariance
of both: where it moved against the factor, it was no common factor, nor where the whole flow did
not follow it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from leakage.course.growth import Growth, Shift

Array = NDArray[np.float64]
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
# The flushing took a common factor back: part of the gaps' change that it exceeds, and by how many
# standard deviations. A model that is somewhat off lets it move by less.
TAKEN_BACK, CERTAIN = 0.2, 2.0
# An explanation is told from this probability on.
PROBABLE: Final = 0.9
# A factor that differs from that of the other motors by more is the motor's own.
OWN_FACTOR: Final = 0.025
# Part of a path that must lie in the directions that are judged.
LEAST_PART: Final = 0.1
LEAST_SIZE: Final = 0.1


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
    taken_back
        The change of the gaps and the flushing, where a common factor is what the gaps say, and the
        flushing does not allow it; None otherwise.
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
    taken_back: Shift | None = None

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
        if self.taken_back or self.any_path > 1.0 - PROBABLE:
            return "cannot_be_told"
        if self.is_common:
            return "common"
        return "cannot_be_told" if self.unjudged else "no_change"


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
    found = Posterior(
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
    shift = growth.shift
    if shift is None or not _is_taken_back(found, shift):
        return found
    return replace(found, common=0.0, apart=(), tank=None, own_sensor=None, taken_back=shift)


def _is_taken_back(found: Posterior, shift: Shift) -> bool:
    """True if the flushing moved against a common factor, or the whole flow not with it.

    A path that has grown besides may hold the whole flow where it was, and what the other motors of
    the circuit have, too, is the oil.
    """
    if not found.is_common or found.is_of_tank:
        return False
    change = math.copysign(1.0, found.factor.log) * np.array([shift.gaps, shift.flushing])
    part, whole = np.array([TAKEN_BACK, 1.0]), np.ones(2)
    if -float(part @ change) > CERTAIN * math.sqrt(part @ shift.covariance @ part):
        return True
    wander = math.sqrt(COMMON_WANDER**2 + whole @ shift.covariance @ whole)
    return found.verdict == "common" and float(whole @ change) < CERTAIN * wander


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

"""Since when, how much and through what: a change at its most probable start."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.baseline import Baseline
from leakage.watch.causes import (
    ALL_FLOWS,
    ALL_GAPS,
    AND,
    BACK,
    COMMON,
    NO_LEAKAGE,
    NOT_IDENTIFIED,
    TEMPERATURE_EFFECT,
    Cause,
)
from leakage.watch.evidence import RAMP, SHAPES, STEP, Causes, Evidence, Places
from leakage.watch.nights import FLUSHING, SEVERAL, Estimate, Machine

# Causes below this probability are no candidates.
LEAST_PROBABILITY = 0.01
INTERVAL = (0.025, 0.5, 0.975)


@dataclass(frozen=True, slots=True)
class Attribution:
    """A change as the nights so far show it; `since` and `start` are numbers of days.

    `weights` are the causes' probabilities where every cause has its exact shape, shape (d,);
    `size` is that of the likeliest in its own units; `leakage` and `drain` are the relative changes
    of the leakage and of the drain flow, over all causes.
    """

    since: tuple[int, int, int]
    start: int
    shape: str
    weights: Array
    likeliest: int
    size: Estimate
    leakage: Estimate
    drain: float


@dataclass(frozen=True, slots=True)
class Name:
    """The cause that is detected, its probability, and all candidates.

    `alike` are the causes that the nights cannot tell from the likeliest, it among them.
    """

    cause: str
    probability: float
    candidates: Mapping[str, float]
    likeliest: Cause
    alike: tuple[str, ...]

    def opened(self) -> Name:
        """Return a name of which nothing is known."""
        return replace(self, cause=NOT_IDENTIFIED, probability=0.0, candidates={}, alike=())


def attribute(evidence: Evidence, baseline: Baseline, starts: Places) -> Attribution:
    """Return the change that begins at any of some starts in order, by the nights up to the newest.

    Neither other operating conditions nor odd nights move its start: with them it moved by 2 to 8
    nights.
    """
    by_start = evidence.of_starts(starts, by_operation=False)
    weights = np.exp(by_start.log_ratio - by_start.log_ratio.max())
    weights /= weights.sum()
    of_starts, of_causes = weights.sum(axis=(0, 2)), weights.sum(axis=(0, 1))
    likeliest = int(of_causes.argmax())
    days = evidence.window.days
    of_dates = np.exp(choices.DATES * (by_start.log_ratio - by_start.log_ratio.max())).sum(
        axis=(0, 2)
    )
    places = np.searchsorted(of_dates.cumsum() / of_dates.sum(), INTERVAL)
    since = days[starts[np.minimum(places, len(starts) - 1)]].tolist()
    # A size that the nights tell well is theirs, not the prior's.
    is_own = (by_start.second * by_start.size**2 > choices.OWN_SIZE) & evidence.causes.is_half[STEP]
    value = np.where(is_own, by_start.first / by_start.second, by_start.size)
    sd = np.where(is_own, 1.0 / np.sqrt(by_start.second), by_start.sd)
    rise = np.ones((len(SHAPES), len(starts), 1))
    rise[RAMP, :, 0] = evidence.risen(starts)
    value, sd = value * rise, sd * rise
    of_leakage, of_drain = np.array(
        [
            (share_of_leakage(cause, baseline), share_of_flow(cause, baseline))
            for cause in evidence.causes.every
        ]
    ).T
    # What did not begin in a night has a shape of its own.
    missed = choices.SIZE_BY_LACK * baseline.lack_of_fit
    missed += choices.SIZE_BY_SHAPE * (since[0] < since[2])
    size = _pool(weights[:, :, likeliest], value[:, :, likeliest], sd[:, :, likeliest], missed)
    return Attribution(
        (since[0], since[1], since[2]),
        # What began in the baseline is seen against all of it.
        int(days[max(int(starts[of_starts.argmax()]), evidence.first_step)]),
        SHAPES[RAMP if weights[RAMP].sum() > 0.5 else STEP],
        of_causes,
        likeliest,
        size,
        _pool(
            weights,
            value * of_leakage,
            sd * np.abs(of_leakage),
            math.hypot(missed, baseline.leakage_share_error),
        ),
        float((weights * value * of_drain).sum()),
    )


def share_of_flow(cause: Cause, baseline: Baseline) -> float:
    """Return the relative change of the drain flow by a cause of size 1.

    Of the effect of temperature, that in 10 K.
    """
    if cause.name == TEMPERATURE_EFFECT:
        return float(cause.direction[baseline.n_paths])
    return float(cause.direction @ baseline.own_row)


def share_of_leakage(cause: Cause, baseline: Baseline) -> float:
    """Return the relative change of the leakage by a cause of size 1 (model.md, 7c.3).

    A flushing and a zero are no leakage: theirs is that of the drain flow.
    """
    if cause.name in (TEMPERATURE_EFFECT, *NO_LEAKAGE):
        return share_of_flow(cause, baseline)
    return float(cause.direction @ baseline.leakage_row)


def _pool(weights: Array, value: Array, sd: Array, missed: float) -> Estimate:
    """Return a size over starts and shapes, with the share of it that may be missed."""
    weights = weights / weights.sum()
    mean = float((weights * value).sum())
    variance = float((weights * (sd**2 + value**2)).sum()) - mean**2
    return Estimate(mean, math.sqrt(max(variance, 0.0) + (missed * mean) ** 2))


def name_of(
    evidence: Evidence, machine: Machine, baseline: Baseline, start: int, flow: float
) -> Name:
    """Return the cause of a change, where every coordinate of its shape may err by the lack of fit.

    `start` is the number of its first day, `flow` the relative change of the drain flow.
    """
    causes = evidence.causes
    at = np.searchsorted(evidence.window.days, [start])
    change, score = _between(evidence, baseline, at, flow)
    # Under a wrong model several can do what another alone does.
    with_several = baseline.model_error <= choices.LACK_TO_IDENTIFY
    log_ratio = _log_ratios(evidence, causes, at, change, score, with_several=with_several)
    weights = np.exp(log_ratio - log_ratio.max())
    weights /= weights.sum()
    likeliest = int(log_ratio[: len(causes)].argmax())
    by_name: dict[str, float] = {}
    names = [*(cause.name for cause in causes.every), *([SEVERAL] if with_several else [])]
    for name, weight in zip(names, weights.tolist(), strict=True):
        by_name[name] = by_name.get(name, 0.0) + weight
    groups = _together(by_name, machine, baseline)
    cause, probability = _identify(groups, by_name, causes.every[likeliest].name)
    alike = _alike(causes, evidence.temper, at, change, score, likeliest, machine)
    known = {name: value for name, value in by_name.items() if value > LEAST_PROBABILITY}
    candidates = dict(sorted(known.items(), key=lambda candidate: -candidate[1]))
    return Name(cause, probability, candidates, causes.every[likeliest], alike)


def parts_of(name: str, gaps: Sequence[str]) -> frozenset[str]:
    """Return the causes that a name stands for: both of a pair, each of all gaps, else itself."""
    return frozenset(gaps if name == ALL_GAPS else name.split(AND))


def _alike(
    causes: Causes,
    tempered: Callable[[Array, Places], Array],
    at: Places,
    change: Array,
    score: Array,
    likeliest: int,
    machine: Machine,
) -> tuple[str, ...]:
    """Return causes that the nights cannot tell from the likeliest; empty where it stands alone.

    Two causes i and j of the size s are distinct by ½ s² T₂ᵢ (1 − ρᵢⱼ²) of ln likelihood in the
    mean, ρ their correlation in W, or by what the nights themselves say. Pairs and all gaps are
    their parts; a pair that is distinguished from each of its parts stands alone.
    """
    matrix = causes.directions.T @ change @ causes.directions
    second = np.maximum(np.diag(matrix), 1e-12)
    size = np.maximum(causes.directions.T @ score / second, 0.0)
    rho = matrix[likeliest] / np.sqrt(second[likeliest] * second)
    expected = 0.5 * size[likeliest] ** 2 * second[likeliest] * (1.0 - np.minimum(rho**2, 1.0))
    gain = 0.5 * tempered((size**2 * second)[None], at)[0]
    near = (rho > 0.0) & ((expected < choices.APART) | (gain.max() - gain < choices.APART))
    near[likeliest] = True
    names = {cause.name for cause, is_near in zip(causes.every, near, strict=True) if is_near}
    names.discard(BACK)
    if len(names) < 2 or causes.every[likeliest].name == BACK:
        return ()
    return tuple(sorted(frozenset().union(*(parts_of(name, machine.gaps) for name in names))))


def _between(
    evidence: Evidence, baseline: Baseline, at: Places, flow: float
) -> tuple[Array, Array]:
    """Return W, shape (q, q), and w, shape (q,), of a start; the change's shape is uncertain."""
    window, p = evidence.window, baseline.n_paths
    since = evidence.since(at)
    after, score = since.information[0], since.score[0]
    before, score_before = (part[0] for part in evidence.sums.before(at, window))
    error = choices.SHAPE_BY_LACK * baseline.model_error * abs(flow)
    variance = np.full(len(score), error**2)
    beyond = float(evidence.operating_beyond(at)[0])
    variance[:p] = (error / baseline.share) ** 2 + (beyond * baseline.operating_error) ** 2
    blurred = np.eye(len(score)) + after * variance
    after, score = np.linalg.solve(blurred, after), np.linalg.solve(blurred, score)
    rows = np.linalg.solve(before + after, np.column_stack([after, score_before + score]))
    return after - after @ rows[:, :-1], score - after @ rows[:, -1]


def _log_ratios(
    evidence: Evidence,
    causes: Causes,
    at: Places,
    change: Array,
    score: Array,
    *,
    with_several: bool,
) -> Array:
    """Return ln of the likelihood ratios of a step, by cause and of several, shape (d + 1,)."""
    first = causes.directions.T @ score
    matrix = causes.directions.T @ change @ causes.directions
    second = np.maximum(np.diag(matrix), 1e-12)
    mean, spread, is_half = causes.mean[STEP], causes.spread[STEP], causes.is_half[STEP]
    sd = 1.0 / np.sqrt(second + spread**-2)
    size = sd**2 * (first + mean / spread**2)
    gain = (size / sd) ** 2 - (mean / spread) ** 2
    width = np.log(sd / spread)
    width += np.where(is_half, math.log(2.0) + log_ndtr(size / sd), 0.0)
    if with_several:
        of_several, log_width = _several(causes, first, matrix)
        gain = np.append(gain, of_several)
        width = np.append(width, log_width + math.log(choices.SEVERAL_PRIOR))
    ratio: Array = 0.5 * evidence.temper(gain[None], at)[0] + width
    return ratio


def _several(causes: Causes, first: Array, matrix: Array) -> tuple[float, float]:
    """Return twice the gain of ln likelihood of several causes at once, and ln of their width."""
    # Each that has two signs, by half of its prior's variance in either.
    each = np.where(causes.is_half[STEP], causes.spread[STEP] / math.sqrt(2.0), 0.0)
    inner = np.eye(len(each)) + each[:, None] * matrix * each
    gain = float((each * first) @ np.linalg.solve(inner, each * first))
    return gain, -0.5 * float(np.linalg.slogdet(inner)[1])


def _together(
    by_name: Mapping[str, float], machine: Machine, baseline: Baseline
) -> dict[frozenset[str], float]:
    """Return probabilities of the names that can be identified: some stand for several causes."""
    groups: dict[str, frozenset[str]] = {}
    free = sum(name in machine.gaps for name in machine.paths)
    if baseline.model_error > choices.LACK_TO_IDENTIFY or free < 2:
        groups |= dict.fromkeys(COMMON, frozenset(COMMON))
    if not baseline.identifies_gaps:
        # What is taken as known is distinguished from gaps by pressures, too.
        parts = {*machine.paths, ALL_GAPS} - {FLUSHING}
        alike = frozenset(other for other in by_name if parts.issuperset(other.split(AND)))
        groups |= dict.fromkeys(alike, alike)
    if not baseline.identifies_speed:
        alike = groups.get(ALL_GAPS, frozenset((ALL_GAPS,))) | groups.get(
            ALL_FLOWS, frozenset((ALL_FLOWS,))
        )
        groups |= dict.fromkeys(alike, alike)
    shared: dict[frozenset[str], float] = {}
    for name, probability in by_name.items():
        group = groups.get(name, frozenset((name,)))
        shared[group] = shared.get(group, 0.0) + probability
    return shared


def _identify(
    groups: Mapping[frozenset[str], float], by_name: Mapping[str, float], likeliest: str
) -> tuple[str, float]:
    """Return the likeliest group's name, or that it cannot be identified, and its probability."""
    if by_name.get(TEMPERATURE_EFFECT, 0.0) >= choices.NAMED:
        return TEMPERATURE_EFFECT, by_name[TEMPERATURE_EFFECT]
    group, probability = max(groups.items(), key=lambda entry: entry[1])
    if probability < choices.NAMED or SEVERAL in group:
        return NOT_IDENTIFIED, probability
    if len(group) == 1:
        return next(iter(group)), probability
    if group <= frozenset(COMMON):
        # What is the temperature's alone is no change of the flow at a given temperature.
        is_warmth = likeliest == TEMPERATURE_EFFECT
        return (TEMPERATURE_EFFECT if is_warmth else ALL_FLOWS), probability
    # One gap or all, or all gaps or all flows.
    return NOT_IDENTIFIED, probability

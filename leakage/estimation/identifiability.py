"""Identifiability of each coefficient from the samples of a window, with reasons in words.

The thesis's parameters enter through a few products only, and whether these can be distinguished
depends on the pressures, temperatures and speeds that the motor saw. A figure without a verdict
would mislead: a coefficient that is not identified never gets an interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from leakage.arrays import Array
from leakage.estimation.proven_minimum import Fit
from leakage.estimation.slow_errors import LEAST_FREEDOM_LEAKAGE, NOT_SLOW, SlowErrors
from leakage.estimation.uncertainty import ClusterRobust, Interval, cluster_robust
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import regressors
from leakage.physics.paths import Law

Verdict: TypeAlias = Literal[
    "identified",
    "uncertain",
    "only_in_combination",
    "not_excited",
    "at_bound",
    "fixed",
    "too_little_data",
]
# Verdicts of a figure that has a value.
WITH_VALUE = ("identified", "uncertain", "extrapolated", "fixed")

# Limits of the verdicts; simulated means the nights of model.md, sections 5 and 8.
# Half-width over K, and √VIF: beyond, a figure would be read for more than it says.
WIDEST_COEFFICIENT = 0.5
LARGEST_ROOT_VIF = 100.0
# Half-width over the leakage, statistical and systematic together, of each verdict.
WIDEST_IDENTIFIED = 0.10
WIDEST_UNCERTAIN = 0.25
WIDEST_EXTRAPOLATED = 0.12
# Distance from what the samples saw over which a leakage is extrapolated [bar, K], with simulated
# coverage of 91 to 98 %; not over speed, which only a known curve follows.
FARTHEST = {"pressure": 20.0, "temperature": 10.0, "speed": 0.0}
# Least span of pressure for telling gaps apart that differ in their deformation.
LEAST_PRESSURE_SPAN_BAR = 20.0
# A combination a block of which tells more than this, or that has fewer degrees of freedom, has
# no credible interval: with 3 degrees of freedom 92 % of the simulated ones of a loss factor held
# the truth, as the limit of their width selects lucky nights.
LARGEST_BLOCK_SHARE = 0.5
LEAST_FREEDOM = 4.0

ONE_STRETCH = (
    "it rests on a short stretch of the window; its conditions must recur to show how sure it is"
)
ONE_BLOCK = "a single block of samples; an interval needs several"


@dataclass(frozen=True, slots=True)
class Excitation:
    """Range of the samples that a motor was fitted to: smallest and largest magnitude of each."""

    pressure_bar: tuple[float, float]
    temperature_c: tuple[float, float]
    speed_rpm: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict on a coefficient or a figure."""

    verdict: Verdict
    reason: str  # In words, with what operation would help; empty where identified.
    interval: Interval | None  # Its 95 % interval; None unless identified or uncertain.
    # The interval that was judged, whatever the verdict; None where the samples do not span it.
    information: Interval | None = None


@dataclass(frozen=True, slots=True)
class Identification:
    """Verdicts and intervals of a fit."""

    coefficients: tuple[Judgement, ...]  # for each coefficient of θ
    slow: SlowErrors  # memory of the errors from block to block
    n_blocks: int  # blocks behind the intervals
    # Of the coefficients that are not fixed; None where there is no interval at all.
    distribution: ClusterRobust | None


def identify(
    fit: Fit,
    factors: Array,
    excitation: Excitation,
    slow: SlowErrors = NOT_SLOW,
) -> Identification:
    """Judge every coefficient of a fit.

    `fit, factors`: The fit, and the factors of its blocks in time order, shape (b, c, c); whitened
    where errors are slow.
    `excitation`: Range of their samples.
    `slow`: Memory of the errors from block to block; the same that whitened the factors.
    """
    # A bound on which the minimum lies is no knowledge: every coefficient that is not fixed counts.
    free = ~fit.proven_minimum.fixed
    distribution = cluster_robust(factors, fit.coefficients, free, slow.widening)
    paths = fit.motor.coefficient_paths
    judgements = tuple(
        _judge(place, path, fit, distribution, excitation) for place, path in enumerate(paths)
    )
    return Identification(judgements, slow, len(factors), distribution)


def judge_by_total(
    fit: Fit, identification: Identification, total: Mapping[int, float | None]
) -> Identification:
    """Return the verdicts on coefficients with what sensors and the model can do to them.

    `total` has whole half-widths by place in θ. A coefficient that is identified by its samples is
    ``uncertain`` where its is more than half of the configured value or not less than the estimate.
    """
    paths = fit.motor.coefficient_paths
    judgements = list(identification.coefficients)
    for place, whole in total.items():
        path, value = paths[place], float(fit.coefficients[place])
        if path is None or whole is None or judgements[place].verdict != "identified":
            continue
        if whole > WIDEST_COEFFICIENT * _size(path, value) or whole >= abs(value):
            reason = (
                f"known to ± {100 * whole / abs(value):.0f} % only, with what sensors and the "
                "model can do to it"
            )
            judgements[place] = replace(judgements[place], verdict="uncertain", reason=reason)
    return replace(identification, coefficients=tuple(judgements))


def _judge(
    place: int,
    path: Law | None,
    fit: Fit,
    distribution: ClusterRobust | None,
    excitation: Excitation,
) -> Judgement:
    """Return verdict on a coefficient: excitation first, then bounds, then its interval."""
    proven_minimum = fit.proven_minimum
    if path is None or proven_minimum.fixed[place]:
        return Judgement("fixed", "held at its configured value", None)
    if distribution is None:
        return Judgement("too_little_data", ONE_BLOCK, None)
    interval = distribution.interval(np.eye(len(proven_minimum.fixed))[place])
    unseen = _unseen(place, path, fit, distribution, interval, excitation)
    if unseen is not None:
        return replace(unseen, information=interval)
    if proven_minimum.at_lower[place] or proven_minimum.at_upper[place]:
        side = "lower" if proven_minimum.at_lower[place] else "upper"
        return Judgement("at_bound", f"the minimum lies on the {side} bound", None, interval)
    taken = _taken_from_bounds(place, fit, interval)
    if taken:
        return Judgement("only_in_combination", taken, None, interval)
    return Judgement("identified", "", interval, interval)


def _taken_from_bounds(place: int, fit: Fit, interval: Interval | None) -> str:
    """Return reason why a coefficient is another's as well; empty if it is its own.

    What a bound takes from a coefficient goes into the others. By less than a standard error
    that is noise, which a bound mends; by more, the samples ask for what no gap can do.
    """
    proven_minimum = fit.proven_minimum
    moved = abs(float(fit.coefficients[place] - fit.unbounded[place]))
    on_bound = np.flatnonzero(proven_minimum.at_lower | proven_minimum.at_upper)
    if not len(on_bound) or interval is None or moved <= interval.standard_error:
        return ""
    paths = fit.motor.coefficient_paths
    names = " and ".join(path.coefficient_name for at in on_bound if (path := paths[at]))
    return f"{names} on a bound moves it by {100 * moved / abs(fit.coefficients[place]):.0f} %"


def _unseen(
    place: int,
    path: Law,
    fit: Fit,
    everything: ClusterRobust,
    interval: Interval | None,
    excitation: Excitation,
) -> Judgement | None:
    """Return reason why a coefficient is not identified; None if it is."""
    size = _size(path, float(fit.coefficients[place]))
    among = int(everything.active[:place].sum())
    root_vif = float(np.sqrt(everything.variance_inflation()[among]))
    if (
        interval is not None
        and interval.half_width <= WIDEST_COEFFICIENT * size
        and interval.half_width < abs(float(fit.coefficients[place]))
        and root_vif <= LARGEST_ROOT_VIF
    ):
        return _too_little(interval)
    span = excitation.pressure_bar[1] - excitation.pressure_bar[0]
    alone = 0.0 if interval is None else interval.half_width / root_vif
    if alone > WIDEST_COEFFICIENT * size or span < LEAST_PRESSURE_SPAN_BAR:
        return Judgement("not_excited", _missing_operation(path, excitation, span), None)
    partner = _partner(place, fit, everything)
    reason = f"only its sum with {partner} shows in these samples"
    return Judgement("only_in_combination", reason, None)


def _too_little(interval: Interval, least_freedom: float = LEAST_FREEDOM) -> Judgement | None:
    """Return reason why a combination's interval is not credible; None if it is."""
    if interval.largest_block_share > LARGEST_BLOCK_SHARE:
        return Judgement("not_excited", ONE_STRETCH, None)
    freedom = interval.degrees_of_freedom
    if freedom < least_freedom:
        reason = (
            f"{freedom:.1f} degrees of freedom, {least_freedom:.0f} are needed: more running time, "
            "or conditions that recur, show how sure it is"
        )
        return Judgement("too_little_data", reason, None)
    return None


def _size(path: Law, estimate: float) -> float:
    """Return reference size for a half-width: the configured coefficient.

    Dividing by the newest night's own estimate would favour nights whose estimate happens to be
    high. A flushing may be configured as 0; then the estimate is used.
    """
    return path.configured_coefficient or abs(estimate)


def _missing_operation(path: Law, excitation: Excitation, span: float) -> str:
    """Return operation that would make the path identifiable."""
    low, high = excitation.pressure_bar
    visible = path.visible_below_pa / 1e5
    if low > visible:
        return (
            f"no samples below {visible:.0f} bar: the gap of {path.name} cannot be seen; run "
            "some minutes at lower pressure"
        )
    if span < LEAST_PRESSURE_SPAN_BAR:
        return (
            f"the pressure stayed between {low:.4g} and {high:.4g} bar; a span of "
            f"{LEAST_PRESSURE_SPAN_BAR:.0f} bar is needed to tell paths apart"
        )
    return f"{path.name} is lost in the noise of these samples; more running time is needed"


def _partner(place: int, fit: Fit, everything: ClusterRobust) -> str:
    """Return the coefficient that the samples tell apart from it least."""
    places = np.flatnonzero(everything.active)
    among = int(np.flatnonzero(places == place)[0])
    strength = np.abs(everything.correlation()[among])
    strength[among] = -1.0
    paths = fit.motor.coefficient_paths
    other = paths[int(places[int(np.argmax(strength))])]
    return other.coefficient_name if other is not None else "another coefficient"


@dataclass(frozen=True, slots=True)
class LeakageJudgement:
    """The leakage of a fitted motor at a condition, flushing excluded."""

    leakage_l_per_min: float  # Estimate without bounds [l/min].
    interval: Interval | None  # Its 95 % interval; None where there is none.
    # ``identified``, ``uncertain``, ``extrapolated`` or ``fixed``, which are published;
    # ``not_identified``, ``outside_fitted_range`` or ``too_little_data``, which are not.
    verdict: str
    reason: str  # In words; empty where identified.
    # The interval that was judged, whatever the verdict; None where the samples do not span it.
    information: Interval | None = None

    @property
    def has_value(self) -> bool:
        """True if the value is meaningful."""
        return self.verdict in WITH_VALUE


def judge_leakage(
    fit: Fit,
    identification: Identification,
    excitation: Excitation,
    conditions: OperatingConditions,
    systematic_l_per_min: float = 0.0,
) -> LeakageJudgement:
    """Return leakage at a condition, with its interval from the joint distribution, and a verdict.

    `systematic_l_per_min` is the ± of sensors and of the model there. Within the samples' range
    ``identified`` where the whole half-width is at most 10 %, ``uncertain`` up to 25 %;
    ``extrapolated`` at most 20 bar or 10 K beyond it, up to 12 %.
    """
    row = regressors(fit.motor, conditions)[0]
    contrast = np.append(row[:-2], 0.0)
    leakage = float(contrast @ fit.unbounded + row[-1])
    distribution = identification.distribution
    interval = None if distribution is None else distribution.interval(contrast)
    if fit.proven_minimum.fixed[:-1].all():
        reason = "nothing of the leakage is estimated"
        return LeakageJudgement(leakage, None, "fixed", reason, interval)
    if distribution is None:
        return LeakageJudgement(leakage, None, "too_little_data", ONE_BLOCK)
    beyond = _beyond(excitation, conditions)
    verdict, reason = _of_leakage(leakage, interval, beyond, systematic_l_per_min)
    return LeakageJudgement(leakage, interval, verdict, reason, interval)


def _of_leakage(
    leakage: float, interval: Interval | None, beyond: tuple[bool, str], systematic: float
) -> tuple[str, str]:
    """Return verdict on a leakage and its reason by its range, what it rests on, and its width."""
    within_reach, outside = beyond
    if not within_reach:
        return "outside_fitted_range", outside
    few = None if interval is None else _too_little(interval, LEAST_FREEDOM_LEAKAGE)
    if interval is None:
        verdict, reason = "not_identified", "the samples do not span these conditions"
    elif few is not None:
        verdict = "too_little_data" if few.verdict == "too_little_data" else "not_identified"
        reason = few.reason
    else:
        width = float(np.hypot(interval.half_width, systematic)) / max(abs(leakage), 1e-300)
        verdict, reason = "not_identified", f"known to ± {100 * width:.1f} % only"
        if outside and width <= WIDEST_EXTRAPOLATED:
            return "extrapolated", outside
        if not outside and width <= WIDEST_UNCERTAIN:
            return ("uncertain", reason) if width > WIDEST_IDENTIFIED else ("identified", "")
    # Outside of the samples' range, that is the verdict, and the rest a part of its reason.
    return ("outside_fitted_range", f"{outside}; {reason}") if outside else (verdict, reason)


def is_outside(excitation: Excitation, conditions: OperatingConditions) -> bool:
    """Return True if a condition lies outside the ranges of the samples."""
    return bool(_beyond(excitation, conditions)[1])


def _beyond(excitation: Excitation, conditions: OperatingConditions) -> tuple[bool, str]:
    """Return True if a condition is within reach of the samples, and what lies outside."""
    within, words = True, []
    for name, values, (low, high), unit in (
        ("pressure", conditions.pressure_difference_pa / 1e5, excitation.pressure_bar, "bar"),
        ("temperature", conditions.oil_temperature_c, excitation.temperature_c, "°C"),
        ("speed", conditions.speed_rpm, excitation.speed_rpm, "rpm"),
    ):
        value = float(values[0])
        short = max(low - value, value - high)
        if short > 0.0:
            within &= short <= FARTHEST[name]
            words.append(
                f"{name} {value:g} {unit} lies outside the night's {low:.4g} to {high:.4g} {unit}"
            )
    return within, "; ".join(words)

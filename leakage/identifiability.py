"""What the samples of a window can tell of each coefficient, and what they cannot, in words.

The thesis's parameters enter through a few products only, and whether these can be told apart
depends on the pressures, temperatures and speeds that the motor saw. A figure without a verdict
would be a false one: a coefficient that is not identified never gets an interval.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.annular_gap import AnnularGap
from leakage.estimation import Fit
from leakage.motor import OperatingConditions, regressors
from leakage.multi_start import Parametrisation
from leakage.paths import LeakagePath
from leakage.uncertainty import ClusterRobust, Interval, cluster_robust, lengthened

Array = NDArray[np.float64]

Verdict: TypeAlias = Literal[
    "identified", "only_in_combination", "not_excited", "at_bound", "fixed", "too_little_data"
]

# Limits of model.md, section 5: half-width over K, √VIF, and half-width over the reference leakage.
WIDEST_COEFFICIENT = 0.5
LARGEST_ROOT_VIF = 100.0
WIDEST_LEAKAGE = 0.02
# Kept training samples, as time, below which there is no interval, or no verdict on a coefficient.
LEAST_MINUTES_INTERVAL = 30.0
LEAST_MINUTES_COEFFICIENT = 60.0
# Least span of pressure for telling gaps apart that differ in their deformation.
LEAST_PRESSURE_SPAN_BAR = 20.0
# A gap shows below about 0.83 X: at 100 bar for the piston ring's 120 bar.
VISIBLE_BELOW = 0.83
# A block carries an error that forgets within a tenth of it.
BLOCK_PER_CORRELATION_TIME = 10.0
# The window is this many times as long as its errors remember, and holds this many blocks:
# simulated nights of shorter ones gave intervals that held the truth in 91 % only.
LEAST_MEMORIES = 60.0
LEAST_BLOCKS = 10
# A combination of which one block tells more than this, or that has fewer degrees of freedom, has
# no credible interval: 34 % of such intervals held the truth in simulation.
LARGEST_BLOCK_SHARE = 0.5
LEAST_FREEDOM = 4.0


@dataclass(frozen=True, slots=True)
class Excitation:
    """What a window's training samples saw.

    Attributes
    ----------
    minutes
        Kept samples, as time [min].
    pressure_bar, temperature_c, speed_rpm
        Smallest and largest value, magnitudes.
    correlation_time_s
        Time over which the prediction errors forget [s].
    block_s
        Length of the blocks [s].
    """

    minutes: float
    pressure_bar: tuple[float, float]
    temperature_c: tuple[float, float]
    speed_rpm: tuple[float, float]
    correlation_time_s: float
    block_s: float

    @property
    def blocks_to_merge(self) -> int:
        """Neighbouring blocks to be merged, so that the errors' memory is short against a block."""
        if not np.isfinite(self.correlation_time_s):
            return 1
        needed = BLOCK_PER_CORRELATION_TIME * self.correlation_time_s / self.block_s
        return max(int(np.ceil(needed)), 1)


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict on a coefficient or a figure.

    Attributes
    ----------
    verdict
        One of `Verdict`.
    reason
        In words, with what operation would help; empty where identified.
    interval
        Its 95 % interval; None unless identified.
    """

    verdict: Verdict
    reason: str
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class Identification:
    """Verdicts and intervals of a fit.

    Attributes
    ----------
    coefficients
        One for each coefficient of θ.
    interval_status
        ``ok``, or why there is no interval at all.
    n_blocks
        Blocks behind the intervals, after lengthening.
    distribution
        Of the coefficients off their bounds; None where there is no interval at all.
    """

    coefficients: tuple[Judgement, ...]
    interval_status: str
    n_blocks: int
    distribution: ClusterRobust | None


def identify(
    fit: Fit, factors: Array, excitation: Excitation, inflation: float = 1.0
) -> Identification:
    """Judge every coefficient of a fit.

    Parameters
    ----------
    fit
        The fit.
    factors
        Triangular factors of its training blocks in time order, shape (b, c, c).
    excitation
        What these samples saw.
    inflation
        Factor on all standard errors, of robust weights.

    Returns
    -------
    Identification
    """
    blocks = lengthened(factors, excitation.blocks_to_merge)
    status = _interval_status(len(blocks), excitation)
    # A bound on which the minimum lies is no knowledge: every coefficient that is not fixed counts.
    free = ~fit.certificate.fixed
    distribution = cluster_robust(blocks, fit.coefficients, free, inflation)
    paths = Parametrisation.of(fit.motor).paths
    judged = tuple(
        _judge(place, path, fit, distribution, status, excitation)
        for place, path in enumerate(paths)
    )
    return Identification(judged, status, len(blocks), distribution if status == "ok" else None)


def _interval_status(n_blocks: int, excitation: Excitation) -> str:
    """``ok``, or why the window gives no interval."""
    if excitation.minutes < LEAST_MINUTES_INTERVAL:
        return (
            f"{excitation.minutes:.1f} minutes of kept training samples; an interval needs "
            f"{LEAST_MINUTES_INTERVAL:.0f}"
        )
    memory_s = excitation.correlation_time_s
    if not np.isfinite(memory_s):
        return "the errors remember for longer than the window can tell"
    if excitation.minutes * 60.0 < LEAST_MEMORIES * memory_s or n_blocks < LEAST_BLOCKS:
        return (
            f"the errors remember for {memory_s:.0f} s, which is long against the window of "
            f"{excitation.minutes:.0f} minutes: its {n_blocks} independent blocks are too few"
        )
    return "ok"


def _judge(
    place: int,
    path: LeakagePath | None,
    fit: Fit,
    distribution: ClusterRobust | None,
    status: str,
    excitation: Excitation,
) -> Judgement:
    """Verdict on one coefficient: excitation first, then bounds, then its interval."""
    certificate = fit.certificate
    if path is None or certificate.fixed[place]:
        return Judgement("fixed", "held at its configured value", None)
    if status != "ok" or distribution is None:
        return Judgement("too_little_data", status, None)
    if excitation.minutes < LEAST_MINUTES_COEFFICIENT:
        reason = (
            f"{excitation.minutes:.1f} minutes of kept training samples; a verdict on a "
            f"coefficient needs {LEAST_MINUTES_COEFFICIENT:.0f}"
        )
        return Judgement("too_little_data", reason, None)
    unseen = _unseen(place, path, fit, distribution, excitation)
    if unseen is not None:
        return unseen
    if certificate.at_lower[place] or certificate.at_upper[place]:
        side = "lower" if certificate.at_lower[place] else "upper"
        return Judgement("at_bound", f"the minimum lies on the {side} bound", None)
    interval = distribution.interval(_unit(place, len(certificate.fixed)))
    return Judgement("identified", "", interval)


def _unseen(
    place: int, path: LeakagePath, fit: Fit, everything: ClusterRobust, excitation: Excitation
) -> Judgement | None:
    """Why a coefficient is not identified, or None where it is."""
    size = _size(path, float(fit.coefficients[place]))
    interval = everything.interval(_unit(place, len(fit.coefficients)))
    among = int(everything.active[:place].sum())
    root_vif = float(np.sqrt(everything.variance_inflation()[among]))
    unit = _unit(place, len(fit.coefficients))
    if (
        interval is not None
        and interval.half_width <= WIDEST_COEFFICIENT * size
        and interval.half_width < abs(float(fit.coefficients[place]))
        and root_vif <= LARGEST_ROOT_VIF
    ):
        return None if _rests_on_many(everything, unit, interval) else _one_stretch(path)
    span = excitation.pressure_bar[1] - excitation.pressure_bar[0]
    alone = 0.0 if interval is None else interval.half_width / root_vif
    if alone > WIDEST_COEFFICIENT * size or span < LEAST_PRESSURE_SPAN_BAR:
        return Judgement("not_excited", _missing_operation(path, excitation, span), None)
    partner = _partner(place, fit, everything)
    reason = f"only its sum with {partner} shows in these samples"
    return Judgement("only_in_combination", reason, None)


def _rests_on_many(distribution: ClusterRobust, contrast: Array, interval: Interval) -> bool:
    """Whether more than a block or two tell of a combination: one alone cannot show its errors."""
    few = interval.degrees_of_freedom < LEAST_FREEDOM
    return not few and distribution.largest_block_share(contrast) <= LARGEST_BLOCK_SHARE


def _one_stretch(path: LeakagePath) -> Judgement:
    reason = (
        f"{path.coefficient_name} rests on one short stretch of the window; its conditions must "
        "recur to show how sure it is"
    )
    return Judgement("not_excited", reason, None)


def _size(path: LeakagePath, estimate: float) -> float:
    """What a half-width is measured by: the configured coefficient.

    Dividing by tonight's own estimate would select the nights that happen to come out high.
    A flushing may be configured as 0, and then only the estimate is left.
    """
    return path.configured_coefficient or abs(estimate)


def _unit(place: int, length: int) -> Array:
    contrast = np.zeros(length)
    contrast[place] = 1.0
    return contrast


def _missing_operation(path: LeakagePath, excitation: Excitation, span: float) -> str:
    """Which operation would show the path."""
    low, high = excitation.pressure_bar
    if isinstance(path, AnnularGap) and path.deformation_pressure_pa is not None:
        visible = VISIBLE_BELOW * path.deformation_pressure_pa / 1e5
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
    """The coefficient that the samples tell apart from this one least."""
    places = np.flatnonzero(everything.active)
    among = int(np.flatnonzero(places == place)[0])
    strength = np.abs(everything.correlation()[among])
    strength[among] = -1.0
    paths = Parametrisation.of(fit.motor).paths
    other = paths[int(places[int(np.argmax(strength))])]
    return other.coefficient_name if other is not None else "another coefficient"


@dataclass(frozen=True, slots=True)
class LeakageJudgement:
    """The leakage of a fitted motor at one condition, flushing excluded.

    Attributes
    ----------
    leakage_l_per_min
        Estimate [l/min].
    interval
        Its 95 % interval; None where there is none.
    verdict
        ``identified``, ``fixed``, ``not_identified``, ``outside_fitted_range`` or
        ``too_little_data``.
    reason
        In words; empty where identified.
    """

    leakage_l_per_min: float
    interval: Interval | None
    verdict: str
    reason: str


def judge_leakage(
    fit: Fit,
    identification: Identification,
    excitation: Excitation,
    conditions: OperatingConditions,
) -> LeakageJudgement:
    """Leakage at one condition, with its interval from the joint distribution, and a verdict.

    Parameters
    ----------
    fit, identification, excitation
        The fit, its verdicts, and what its samples saw.
    conditions
        One condition.

    Returns
    -------
    LeakageJudgement
        Identified where the half-width is at most 2 % and the condition lies within what the
        samples saw.
    """
    row = regressors(fit.motor, conditions)[0]
    contrast = np.append(row[:-2], 0.0)
    leakage = float(contrast @ fit.coefficients + row[-1])
    if fit.certificate.fixed[:-1].all():
        return LeakageJudgement(leakage, None, "fixed", "nothing of the leakage is estimated")
    if identification.interval_status != "ok":
        return LeakageJudgement(leakage, None, "too_little_data", identification.interval_status)
    assert identification.distribution is not None
    interval = identification.distribution.interval(contrast)
    outside = _outside(excitation, conditions)
    if outside:
        return LeakageJudgement(leakage, interval, "outside_fitted_range", outside)
    if interval is None:
        reason = "the samples do not span these conditions"
        return LeakageJudgement(leakage, None, "not_identified", reason)
    if not interval.half_width <= WIDEST_LEAKAGE * abs(leakage):
        reason = f"known to ± {100 * interval.half_width / abs(leakage):.1f} % only; 2 % are needed"
        return LeakageJudgement(leakage, interval, "not_identified", reason)
    if not _rests_on_many(identification.distribution, contrast, interval):
        reason = "it rests on one short stretch of the window"
        return LeakageJudgement(leakage, interval, "not_identified", reason)
    return LeakageJudgement(leakage, interval, "identified", "")


def _outside(excitation: Excitation, conditions: OperatingConditions) -> str:
    """Which channel of a condition lies outside what the samples saw; empty for none."""
    for name, value, (low, high), unit in (
        (
            "pressure",
            float(conditions.pressure_difference_pa[0]) / 1e5,
            excitation.pressure_bar,
            "bar",
        ),
        ("temperature", float(conditions.oil_temperature_c[0]), excitation.temperature_c, "°C"),
        ("speed", float(conditions.speed_rpm[0]), excitation.speed_rpm, "rpm"),
    ):
        if not low <= value <= high:
            return (
                f"{name} {value:g} {unit} lies outside the night's {low:.4g} to {high:.4g} {unit}"
            )
    return ""

"""The one fit, from stored blocks: of a night just read, of one fitted anew, of nights together.

The total ± of a figure, of samples, sensors and model, is half the width of a 95 % interval of the
figure itself; a stated tolerance counts as two standard deviations. A motor that is compared with
itself takes the statistical part alone: what its sensors and its model do wrong is the same on all
nights.
"""

from __future__ import annotations

import datetime as dt
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leakage import EstimationError, Motor, OperatingConditions, regressors
from leakage.estimation.block_fit import BlockEstimate, fit_blocks
from leakage.estimation.block_statistics import merge, with_free_known
from leakage.estimation.choices import COEFFICIENT_FACTOR, LEAKAGE_FACTOR
from leakage.estimation.identifiability import (
    Excitation,
    Identification,
    Judgement,
    LeakageJudgement,
    identify,
    is_outside,
    judge_by_total,
    judge_leakage,
)
from leakage.estimation.misfit import Misfit, model_errors
from leakage.estimation.proven_minimum import Fit, ProvenMinimum, fit
from leakage.estimation.residual_analysis import ResidualAnalysis
from leakage.estimation.sensitivities import SENSORS
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.night.stored_blocks import StoredBlocks

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ErrorParts:
    """Half-widths of a figure, in its unit."""

    statistical: float | None  # of the interval from the samples; None without one
    sensor: float  # from tolerances of the sensors, stated or assumed
    model: float | None  # from the night's structured misfit; None where it is not known
    # From tolerances of constants, as far as they are not the same on all nights.
    constants: float = 0.0

    @property
    def beside_samples(self) -> float:
        """All parts but the statistical one."""
        return math.hypot(self.sensor, self.model or 0.0, self.constants)

    @property
    def total(self) -> float | None:
        """Of all parts, by their squares; None without an interval from the samples."""
        if self.statistical is None:
            return None
        return math.hypot(self.statistical, self.beside_samples)


def of_stated(budget: Sequence[Row]) -> dict[str, float]:
    """Return ± of each indicator from stated tolerances."""
    return _by_squares([row for row in budget if not row["is_assumed"]])


def of_sensors(budget: Sequence[Row]) -> dict[str, float]:
    """Return ± of each indicator from tolerances of sensors, stated or assumed."""
    return _by_squares([row for row in budget if _is_sensor(row)])


def of_extrapolation(budget: Sequence[Row], there: str, here: str, ratio: float) -> float:
    """± of one leakage against another from tolerances of constants, scaled by their ratio."""
    effects: defaultdict[str, float] = defaultdict(float)
    for row in budget:
        if row["indicator"] in (there, here) and not _is_sensor(row):
            effects[row["source"]] += row["effect"] * (1.0 if row["indicator"] == there else -ratio)
    return math.hypot(*effects.values())


def _is_sensor(row: Row) -> bool:
    return str(row["source"]).startswith(SENSORS)


def _by_squares(rows: Sequence[Row]) -> dict[str, float]:
    effects: defaultdict[str, list[float]] = defaultdict(list)
    for row in rows:
        effects[row["indicator"]].append(row["effect"])
    return {indicator: math.hypot(*found) for indicator, found in effects.items()}


REFERENCE, OWN = "fitted_leakage", "own_conditions_leakage"
# ± of a change of all loss factors with temperature, which one night cannot tell (model.md,
# section 5) [1/K].
UNKNOWN_PER_KELVIN = 0.01


@dataclass(frozen=True, slots=True)
class RollerScale:
    """The scale of the rollers' curve by the blocks of a night, and the verdict on it."""

    value: float
    judgement: Judgement


@dataclass(frozen=True, slots=True)
class BlockFit:
    """The fit under one mode of flushing."""

    name: str  # none, fixed or estimated
    # fit, identification: estimates from all kept samples; verdicts and intervals.
    fit: Fit
    # training: The fit to the training samples alone, which is validated on the others
    training: ProvenMinimum
    # Estimates of the model as it is stated: what the predictions and the misfit are of.
    stated: BlockEstimate
    identification: Identification
    excitation: Excitation  # range of the samples
    block_s: float  # usual length of the blocks [s]
    duration_s: float  # time from the first sample to the last [s]
    reference_conditions: OperatingConditions  # where the reference leakage is evaluated
    reference: LeakageJudgement  # leakage there
    # ± from stated tolerances by indicator, in its unit; without those that have none.
    systematic: Mapping[str, float]
    errors: Mapping[str, ErrorParts]  # parts of the ± by indicator
    # What the blocks say of the scale of the rollers' curve, whether or not the fit uses it; None
    # without such a curve.
    roller: RollerScale | None = None
    # Residual analyses of training and validation samples; empty without samples.
    residuals: Mapping[str, ResidualAnalysis] = field(default_factory=dict)


def fit_stored_blocks(
    spec: MotorSpec,
    night: dt.date,
    mode: str,
    blocks: StoredBlocks,
    at: tuple[OperatingConditions, OperatingConditions],
    budget: Sequence[Mapping[str, Any]],
) -> BlockFit:
    """Fit a motor, in the form in which it is fitted, to blocks of samples.

    `at` are the conditions of the leakages: :func:`conditions`. Raises EstimationError if there are
    fewer training samples than free coefficients.
    """
    motor = spec.stated.motor(night, mode)
    samples = blocks.sample_blocks()
    stated = fit_blocks(samples, motor)
    made = stated
    if spec.roller_is_free and motor.standard is not None:
        free, samples = motor.with_free_standard(), samples.with_free_known(*scale_of(motor))
        made = fit_blocks(samples, free)
    fitted, excitation = made.fit, samples.excitation
    identification = made.identified(excitation)
    where = dict(zip((REFERENCE, OWN), at, strict=True))
    misfits = made.misfit, stated.misfit
    errors = _errors(made, identification, excitation, misfits, where, budget)
    beside = errors[REFERENCE].beside_samples
    reference = judge_leakage(fitted, identification, excitation, where[REFERENCE], beside)
    total = {
        place: errors[path.coefficient_name].total
        for place, path in enumerate(fitted.motor.coefficient_paths)
        if path is not None and path.coefficient_name in errors
    }
    return BlockFit(
        name=mode,
        fit=fitted,
        training=made.training,
        stated=stated,
        identification=judge_by_total(fitted, identification, total),
        excitation=excitation,
        block_s=samples.block_s,
        duration_s=blocks.duration_s,
        reference_conditions=where[REFERENCE],
        reference=reference,
        systematic=of_stated(budget),
        errors=errors,
        roller=_roller(motor, made, identification, excitation),
    )


def scale_of(motor: Motor) -> tuple[int, float]:
    """Return place of the scale of a motor's standard once it is free, and its configured value."""
    assert motor.standard is not None
    place = motor.with_free_standard().columns.index(motor.standard.name)
    return place, motor.standard.configured_coefficient


def with_free_rollers(spec: MotorSpec, motor: Motor, factor: Array) -> Array:
    """Return a factor in the columns in which the motor is fitted, of one in those as stated."""
    if not spec.roller_is_free or motor.standard is None:
        return factor
    moved: Array = with_free_known(factor[None], *scale_of(motor))[0]
    return moved


def _roller(
    motor: Motor,
    made: BlockEstimate,
    identification: Identification,
    excitation: Excitation,
) -> RollerScale | None:
    """Return scale of the rollers' curve of a motor as stated, from whitened blocks."""
    if motor.standard is None:
        return None
    place, configured = scale_of(motor)
    fitted = made.fit
    if fitted.motor.columns == motor.columns:
        factors = with_free_known(made.whitened, place, configured)
        try:
            fitted = fit(merge(factors), motor.with_free_standard())
        except EstimationError:
            return None
        identification = identify(fitted, factors, excitation, made.slow)
    judged = identification.coefficients[place]
    return RollerScale(float(fitted.coefficients[place]), judged)


def _errors(
    made: BlockEstimate,
    identification: Identification,
    excitation: Excitation,
    misfits: tuple[Misfit | None, Misfit | None],
    at: Mapping[str, OperatingConditions],
    budget: Sequence[Mapping[str, Any]],
) -> dict[str, ErrorParts]:
    """Parts of the ± of each leakage, by the first misfit, and each coefficient, by the second."""
    fitted, distribution = made.fit, identification.distribution
    fixed = fitted.proven_minimum.fixed
    sensors = of_sensors(budget)
    rows = {name: regressors(fitted.motor, place)[0] for name, place in at.items()}
    leakages = {name: row[:-2] @ fitted.unbounded[:-1] + row[-1] for name, row in rows.items()}
    constants = 0.0
    if is_outside(excitation, at[REFERENCE]) and leakages[OWN] > 0.0:
        ratio = float(leakages[REFERENCE] / leakages[OWN])
        apart_k = float(at[REFERENCE].oil_temperature_c[0] - at[OWN].oil_temperature_c[0])
        gaps = float(leakages[REFERENCE] - rows[REFERENCE][-1])
        constants = math.hypot(
            of_extrapolation(budget, REFERENCE, OWN, ratio),
            # The night is fitted before its motor's own change with temperature is known.
            UNKNOWN_PER_KELVIN * apart_k * gaps,
        )
    paths = {
        path.coefficient_name: place
        for place, path in enumerate(fitted.motor.coefficient_paths)
        if path is not None and not fixed[place]
    }
    contrasts = {name: np.append(row[:-2], 0.0) for name, row in rows.items()}
    contrasts |= {name: np.eye(len(fixed))[place] for name, place in paths.items()}
    intervals = {
        name: None if distribution is None else distribution.interval(contrasts[name])
        for name in rows
    }
    intervals |= {
        name: identification.coefficients[place].information for name, place in paths.items()
    }
    model: list[float | None] = [None] * len(contrasts)
    taus = [misfits[0]] * len(rows) + [misfits[1]] * len(paths)
    if any(taus):
        reach = model_errors(made.whole, fixed, np.array([*contrasts.values()]), 1.0)
        factor = np.repeat((LEAKAGE_FACTOR, COEFFICIENT_FACTOR), (len(rows), len(paths)))
        model = [
            None if tau is None else float(size * tau.l_per_min)
            for size, tau in zip(factor * reach, taus, strict=True)
        ]
    return {
        name: ErrorParts(
            None if interval is None else interval.half_width,
            sensors.get(name, 0.0),
            part,
            constants if name == REFERENCE else 0.0,
        )
        for (name, interval), part in zip(intervals.items(), model, strict=True)
    }


def conditions(
    spec: MotorSpec, blocks: StoredBlocks
) -> tuple[OperatingConditions, OperatingConditions]:
    """Return the reference conditions, and the mean ones of some blocks."""
    charge_bar = blocks.charge_bar
    return (
        spec.settings.reference.conditions(charge_bar).operating,
        OperatingConditions.from_bar(*blocks.means(), charge_bar),
    )

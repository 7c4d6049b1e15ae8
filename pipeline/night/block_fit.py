"""The one fit, from stored blocks: of a night just read, of one fitted anew, of nights together."""

from __future__ import annotations

import datetime as dt
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import EstimationError, Motor, OperatingConditions, regressors
from leakage.course.temperature_correction import UNKNOWN_PER_KELVIN, temperature_response
from leakage.estimation.block_fit import fit_blocks
from leakage.estimation.block_statistics import merge, with_free_known
from leakage.estimation.certificate import Certificate
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
from leakage.estimation.least_squares import Fit, fit
from leakage.estimation.model_verdict import (
    COEFFICIENT_FACTOR,
    LEAKAGE_FACTOR,
    Misfit,
    StructuredMisfit,
    model_errors,
    structured_misfit,
)
from leakage.estimation.multi_start import Parametrisation, SearchSettings
from leakage.estimation.uncertainty import Bootstrap, block_bootstrap
from pipeline.config import MotorSpec
from pipeline.night.error_parts import ErrorParts, of_extrapolation, of_sensors, stated
from pipeline.night.residuals import PartResiduals
from pipeline.night.stored_blocks import StoredBlocks

Array = NDArray[np.float64]

REFERENCE, OWN = "reference_leakage", "own_conditions_leakage"


@dataclass(frozen=True, slots=True)
class RollerScale:
    """The scale of the rollers' curve by the blocks of a night, and the verdict on it."""

    value: float
    judgement: Judgement


@dataclass(frozen=True, slots=True)
class BlockFit:
    """The fit under one mode of flushing.

    Attributes
    ----------
    name
        none, fixed or estimated.
    fit, identification
        Estimates from all kept samples; verdicts and intervals.
    training
        The fit to the training samples alone, which is validated on the others.
    excitation
        Range of the samples.
    duration_s
        Time from the first sample to the last [s].
    own_means
        Mean pressure difference [bar], temperature [°C] and speed [rpm].
    response
        dθ/db: change of the estimates with b, a change of all loss factors with temperature.
    reference_conditions
        Where the reference leakage is evaluated.
    reference, own
        Leakage at the reference conditions, and at the night's own mean conditions.
    bootstrap
        Percentile limits, a cross-check.
    systematic
        ± from stated tolerances by indicator, in its unit; without those that have none.
    misfit, structured
        What the blocks say of the model as it is stated, and what is structured in it; None where
        they are too few.
    errors
        Parts of the ± by indicator.
    roller
        What the blocks say of the scale of the rollers' curve, whether or not the fit uses it; None
        without such a curve.
    memory_s
        Time over which the training errors forget [s]; it needs samples, nan without.
    prediction_error
        Prediction errors of all samples by the training fit [l/min], shape (n,); empty without
        samples.
    residuals
        Residual analyses of training and validation samples; empty without samples.
    """

    name: str
    fit: Fit
    training: Certificate
    identification: Identification
    excitation: Excitation
    duration_s: float
    own_means: tuple[float, float, float]
    response: Array
    reference_conditions: OperatingConditions
    reference: LeakageJudgement
    own: LeakageJudgement
    bootstrap: Bootstrap
    systematic: Mapping[str, float]
    misfit: Misfit | None
    structured: StructuredMisfit | None
    errors: Mapping[str, ErrorParts]
    roller: RollerScale | None = None
    memory_s: float = math.nan
    prediction_error: Array = field(default_factory=lambda: np.empty(0))
    residuals: tuple[PartResiduals, ...] = ()


def fit_stored_blocks(
    spec: MotorSpec,
    night: dt.date,
    mode: str,
    blocks: StoredBlocks,
    charge_bar: float | None,
    inflation: float,
    sensitivities: Sequence[Mapping[str, Any]] = (),
    *,
    misfit_as_stated: Misfit | None = None,
    search: bool | None = None,
    bootstrap: bool = True,
) -> BlockFit:
    """Fit a motor to blocks of samples, with verdicts and intervals.

    Parameters
    ----------
    spec, night, mode
        Motor, night (it tells the oil) and mode of flushing.
    blocks
        Blocks of all kept samples.
    charge_bar
        Mean charge above case pressure; None in a model of one side.
    inflation
        Factor on standard errors that robust weights ask for; 1 without them.
    sensitivities
        Rows of the table: effects of the stated tolerances under this mode.
    misfit_as_stated
        Misfit of the model as it is stated, where the rollers' scale is free; else its own counts.
    search
        Make the starts of the search, too; None: on every n-th night, and where the rank is
        short. No estimate depends on them.
    bootstrap
        Make the block bootstrap, on which nothing but its own columns depends.

    Raises
    ------
    EstimationError
        If there are fewer training samples than free coefficients.
    """
    estimation = spec.settings.estimation
    nights = estimation.search_every_nights
    is_due = nights > 0 and night.toordinal() % nights == 0
    settings = SearchSettings(
        starting_points=0 if search is False else estimation.starting_points,
        gradient_type=estimation.gradient_type,
        step_tolerance=estimation.step_tolerance,
        function_tolerance=estimation.function_tolerance,
        maximum_iterations=estimation.maximum_iterations,
        only_at_short_rank=search is None and not is_due,
    )

    def generator(purpose: str) -> np.random.Generator:
        return np.random.default_rng(night_seed(estimation.seed, spec.motor_id, night, purpose))

    motor, of_files = spec.motor(night, mode), spec.stated.motor(night, mode)
    samples = blocks.sample_blocks(spec.settings.windows.block_s)
    made = fit_blocks(samples, motor, settings, generator(mode), inflation)
    fitted, identification, factors = made.fit, made.identification, made.whitened
    excitation, told = samples.excitation, made.misfit
    at = dict(zip((REFERENCE, OWN), conditions(spec, blocks, charge_bar), strict=True))
    own_means = blocks.means()
    judged = misfit_as_stated if spec.roller_is_free else told
    structured = None if judged is None else structured_misfit([judged])
    own_structured = structured if judged is told or told is None else structured_misfit([told])
    errors = _errors(
        fitted,
        identification,
        excitation,
        blocks.factors,
        (own_structured, structured),
        at,
        sensitivities,
    )
    reference, own = (
        judge_leakage(fitted, identification, excitation, at[name], errors[name].beside_samples)
        for name in (REFERENCE, OWN)
    )
    total = {
        place: errors[path.coefficient_name].total
        for place, path in enumerate(Parametrisation.of(motor).paths)
        if path is not None and path.coefficient_name in errors
    }
    return BlockFit(
        name=mode,
        fit=fitted,
        training=made.training,
        identification=judge_by_total(fitted, identification, total),
        excitation=excitation,
        duration_s=blocks.duration_s,
        own_means=own_means,
        response=temperature_response(
            factors,
            fitted.coefficients,
            ~(fitted.certificate.fixed | fitted.certificate.at_lower | fitted.certificate.at_upper),
            samples.means[:, 0] - own_means[1],
        ),
        reference_conditions=at[REFERENCE],
        reference=reference,
        own=own,
        bootstrap=block_bootstrap(
            factors,
            fitted.coefficients,
            identification.distribution,
            # A source of its own: limits do not depend on whether the search was made.
            generator(f"{mode}|bootstrap"),
            resamples=estimation.bootstrap_resamples if bootstrap else 0,
        ),
        systematic=stated(sensitivities),
        misfit=judged,
        structured=structured,
        errors=errors,
        roller=_roller(of_files, fitted, factors, identification, excitation, inflation),
    )


def _roller(
    motor: Motor,
    fitted: Fit,
    factors: Array,
    identification: Identification,
    excitation: Excitation,
    inflation: float,
) -> RollerScale | None:
    """Scale of the rollers' curve of a motor as stated, from whitened blocks."""
    standard = motor.standard
    if standard is None:
        return None
    free = motor.with_free_standard()
    place = free.columns.index(standard.name)
    if free.columns != fitted.motor.columns:
        factors = with_free_known(factors, place, standard.configured_coefficient)
        nowhere = SearchSettings(starting_points=0)
        try:
            fitted = fit(merge(factors), free, nowhere, np.random.default_rng(0))
        except EstimationError:
            return None
        identification = identify(fitted, factors, excitation, inflation, identification.slow)
    judged = identification.coefficients[place]
    return RollerScale(float(fitted.coefficients[place]), judged)


def _errors(
    fitted: Fit,
    identification: Identification,
    excitation: Excitation,
    factors: Array,
    misfits: tuple[StructuredMisfit | None, StructuredMisfit | None],
    at: Mapping[str, OperatingConditions],
    sensitivities: Sequence[Mapping[str, Any]],
) -> dict[str, ErrorParts]:
    """Parts of the ± of each leakage, by the first misfit, and each coefficient, by the second."""
    fixed, distribution = fitted.certificate.fixed, identification.distribution
    sensors = of_sensors(sensitivities)
    rows = {name: regressors(fitted.motor, one)[0] for name, one in at.items()}
    leakages = {name: row[:-2] @ fitted.coefficients[:-1] + row[-1] for name, row in rows.items()}
    constants = 0.0
    if is_outside(excitation, at[REFERENCE]) and leakages[OWN] > 0.0:
        ratio = float(leakages[REFERENCE] / leakages[OWN])
        apart_k = float(at[REFERENCE].oil_temperature_c[0] - at[OWN].oil_temperature_c[0])
        gaps = float(leakages[REFERENCE] - rows[REFERENCE][-1])
        constants = math.hypot(
            of_extrapolation(sensitivities, REFERENCE, OWN, ratio),
            # The night is fitted before its motor's own change with temperature is known.
            UNKNOWN_PER_KELVIN * apart_k * gaps,
        )
    paths = {
        path.coefficient_name: place
        for place, path in enumerate(Parametrisation.of(fitted.motor).paths)
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
        reach = model_errors(factors, fixed, np.array([*contrasts.values()]), 1.0)
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
    spec: MotorSpec, blocks: StoredBlocks, charge_bar: float | None
) -> tuple[OperatingConditions, OperatingConditions]:
    """The reference conditions, and the mean ones of some blocks."""
    reference = spec.settings.reference
    return (
        OperatingConditions.from_bar(
            reference.pressure_bar, reference.temperature_c, reference.speed_rpm, charge_bar
        ),
        OperatingConditions.from_bar(*blocks.means(), charge_bar),
    )


def night_seed(seed: int, motor_id: str, night: dt.date, purpose: str) -> int:
    """Seed of a fit's draws: the same for the same run seed, motor, night and purpose."""
    text = "|".join((str(seed), motor_id, night.isoformat(), purpose))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")

"""The one fit, from stored blocks: of a night just read, of one fitted anew, of nights together."""

from __future__ import annotations

import datetime as dt
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import EstimationError, Motor, OperatingConditions, regressors
from leakage.course.temperature_correction import UNKNOWN_PER_KELVIN, temperature_response
from leakage.estimation.block_fit import BlockEstimate, fit_blocks
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
    StructuredMisfit,
    model_errors,
    structured_misfit,
)
from leakage.estimation.multi_start import Parametrisation, SearchSettings
from leakage.estimation.uncertainty import Bootstrap, block_bootstrap
from pipeline.config import MotorSpec
from pipeline.night.error_parts import ErrorParts, of_extrapolation, of_sensors, of_stated
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
    """The fit under one mode of flushing."""

    name: str  # none, fixed or estimated
    # fit, identification: estimates from all kept samples; verdicts and intervals.
    fit: Fit
    training: Certificate  # the fit to the training samples alone, which is validated on the others
    # Estimates of the model as it is stated: what the search, the predictions and the misfit are
    # of.
    stated: BlockEstimate
    identification: Identification
    excitation: Excitation  # range of the samples
    duration_s: float  # time from the first sample to the last [s]
    # Mean pressure difference [bar], temperature [°C] and speed [rpm].
    own_means: tuple[float, float, float]
    # dθ/db: change of the estimates with b, a change of all loss factors with temperature.
    response: Array
    reference_conditions: OperatingConditions  # where the reference leakage is evaluated
    # reference, own: leakage at the reference conditions, and at the night's own mean conditions.
    reference: LeakageJudgement
    own: LeakageJudgement
    bootstrap: Bootstrap  # percentile limits, a cross-check
    # ± from stated tolerances by indicator, in its unit; without those that have none.
    systematic: Mapping[str, float]
    # Structured misfit of the model as it is stated; None where the blocks are too few.
    structured: StructuredMisfit | None
    errors: Mapping[str, ErrorParts]  # parts of the ± by indicator
    # What the blocks say of the scale of the rollers' curve, whether or not the fit uses it; None
    # without such a curve.
    roller: RollerScale | None = None
    # Time over which the training errors forget [s]; it needs samples, nan without.
    memory_s: float = math.nan
    # Residual analyses of training and validation samples; empty without samples.
    residuals: tuple[PartResiduals, ...] = ()


def fit_stored_blocks(
    spec: MotorSpec,
    night: dt.date,
    mode: str,
    blocks: StoredBlocks,
    at: tuple[OperatingConditions, OperatingConditions],
    inflation: float,
    sensitivities: Sequence[Mapping[str, Any]],
    *,
    search: bool | None = None,
) -> BlockFit:
    """Fit a motor to blocks of samples, with verdicts and intervals.

    Parameters
    ----------
    spec, night, mode
        Motor, in the form in which it is fitted, night (it tells the oil) and mode of flushing.
    blocks
        Blocks of all kept samples.
    at
        The reference conditions, and the mean ones of the blocks: :func:`conditions`.
    inflation
        Factor on standard errors that robust weights ask for; 1 without them.
    sensitivities
        Rows of the table: effects of the stated tolerances under this mode.
    search
        Make the starts of the search, too; None: on every n-th night, and where the rank is
        short. No estimate depends on them.

    Raises
    ------
    EstimationError
        If there are fewer training samples than free coefficients.
    """
    estimation, motor = spec.settings.estimation, spec.stated.motor(night, mode)

    def generator(purpose: str) -> np.random.Generator:
        return np.random.default_rng(night_seed(estimation.seed, spec.motor_id, night, purpose))

    samples = blocks.sample_blocks(spec.settings.windows.block_s)
    stated = fit_blocks(samples, motor, _search(spec, night, search), generator(mode))
    made = stated
    if spec.roller_is_free and motor.standard is not None:
        free, samples = motor.with_free_standard(), samples.with_free_known(*scale_of(motor))
        made = fit_blocks(samples, free)
    fitted, excitation = made.fit, samples.excitation
    identification = made.identified(excitation, inflation)
    where = dict(zip((REFERENCE, OWN), at, strict=True))
    own_means = blocks.means()
    structured = None if stated.misfit is None else structured_misfit([stated.misfit])
    own_structured = structured
    if made is not stated and made.misfit is not None:
        own_structured = structured_misfit([made.misfit])
    errors = _errors(
        made, identification, excitation, (own_structured, structured), where, sensitivities
    )
    reference, own = (
        judge_leakage(fitted, identification, excitation, where[name], errors[name].beside_samples)
        for name in (REFERENCE, OWN)
    )
    total = {
        place: errors[path.coefficient_name].total
        for place, path in enumerate(Parametrisation.of(fitted.motor).paths)
        if path is not None and path.coefficient_name in errors
    }
    return BlockFit(
        name=mode,
        fit=fitted,
        training=made.training,
        stated=stated,
        identification=judge_by_total(fitted, identification, total),
        excitation=excitation,
        duration_s=blocks.duration_s,
        own_means=own_means,
        response=temperature_response(
            made.whitened,
            fitted.coefficients,
            fitted.certificate.off_bounds,
            samples.means[:, 0] - own_means[1],
        ),
        reference_conditions=where[REFERENCE],
        reference=reference,
        own=own,
        bootstrap=block_bootstrap(
            made.whitened,
            fitted.coefficients,
            identification.distribution,
            # A source of its own: limits do not depend on whether the search was made.
            generator(f"{mode}|bootstrap"),
            resamples=estimation.bootstrap_resamples,
        ),
        systematic=of_stated(sensitivities),
        structured=structured,
        errors=errors,
        roller=_roller(motor, made, identification, excitation, inflation),
    )


def _search(spec: MotorSpec, night: dt.date, search: bool | None) -> SearchSettings:
    """Settings of the search on a night."""
    estimation = spec.settings.estimation
    nights = estimation.search_every_nights
    is_due = nights > 0 and night.toordinal() % nights == 0
    return SearchSettings(
        starting_points=0 if search is False else estimation.starting_points,
        gradient_type=estimation.gradient_type,
        step_tolerance=estimation.step_tolerance,
        function_tolerance=estimation.function_tolerance,
        maximum_iterations=estimation.maximum_iterations,
        only_at_short_rank=search is None and not is_due,
    )


def scale_of(motor: Motor) -> tuple[int, float]:
    """Place of the scale of a motor's standard once it is free, and its configured value."""
    assert motor.standard is not None
    place = motor.with_free_standard().columns.index(motor.standard.name)
    return place, motor.standard.configured_coefficient


def in_form(spec: MotorSpec, motor: Motor, factor: Array) -> Array:
    """Factor of some samples of a motor as stated, in the columns in which it is fitted."""
    if not spec.roller_is_free or motor.standard is None:
        return factor
    moved: Array = with_free_known(factor[None], *scale_of(motor))[0]
    return moved


def _roller(
    motor: Motor,
    made: BlockEstimate,
    identification: Identification,
    excitation: Excitation,
    inflation: float,
) -> RollerScale | None:
    """Scale of the rollers' curve of a motor as stated, from whitened blocks."""
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
        identification = identify(fitted, factors, excitation, inflation, made.slow)
    judged = identification.coefficients[place]
    return RollerScale(float(fitted.coefficients[place]), judged)


def _errors(
    made: BlockEstimate,
    identification: Identification,
    excitation: Excitation,
    misfits: tuple[StructuredMisfit | None, StructuredMisfit | None],
    at: Mapping[str, OperatingConditions],
    sensitivities: Sequence[Mapping[str, Any]],
) -> dict[str, ErrorParts]:
    """Parts of the ± of each leakage, by the first misfit, and each coefficient, by the second."""
    fitted, distribution = made.fit, identification.distribution
    fixed = fitted.certificate.fixed
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

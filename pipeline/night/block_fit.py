"""The one fit, from stored blocks: of a night just read, of one fitted anew, of nights together."""

from __future__ import annotations

import datetime as dt
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import Fit, OperatingConditions, Parametrisation, SearchSettings, fit, regressors
from leakage.block_statistics import merge
from leakage.certificate import Certificate, certify
from leakage.identifiability import (
    Excitation,
    Identification,
    LeakageJudgement,
    identify,
    is_outside,
    judge_leakage,
)
from leakage.model_verdict import (
    COEFFICIENT_FACTOR,
    LEAKAGE_FACTOR,
    Misfit,
    StructuredMisfit,
    misfit,
    model_errors,
    structured_misfit,
)
from leakage.slow_errors import slow_errors, whitened
from leakage.uncertainty import Bootstrap, block_bootstrap
from pipeline.config import MotorSpec
from pipeline.night.error_parts import ErrorParts, of_extrapolation, of_sensors, stated
from pipeline.night.residuals import PartResiduals
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.night.windows import TRAINING

Array = NDArray[np.float64]

REFERENCE, OWN = "reference_leakage", "own_conditions_leakage"


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
    reference_conditions
        Where the reference leakage is evaluated.
    reference, own
        Leakage at the reference conditions, and at the night's own mean conditions.
    bootstrap
        Percentile limits, a cross-check.
    systematic
        ± from stated tolerances by indicator, in its unit; without those that have none.
    misfit, structured
        Misfit statistics of the model, and what is structured in them; None where the blocks are
        too few.
    errors
        Parts of the ± by indicator.
    memory_s
        Time over which the training errors forget [s]; it needs samples, nan without.
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
    reference_conditions: OperatingConditions
    reference: LeakageJudgement
    own: LeakageJudgement
    bootstrap: Bootstrap
    systematic: Mapping[str, float]
    misfit: Misfit | None
    structured: StructuredMisfit | None
    errors: Mapping[str, ErrorParts]
    memory_s: float = math.nan
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
    search: bool = True,
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
    search
        Make the starts of the search, too; the estimate does not depend on them.
    bootstrap
        Make the block bootstrap, on which nothing but its own columns depends.

    Raises
    ------
    EstimationError
        If there are fewer training samples than free coefficients.
    """
    estimation = spec.settings.estimation
    settings = SearchSettings(
        starting_points=estimation.starting_points,
        gradient_type=estimation.gradient_type,
        step_tolerance=estimation.step_tolerance,
        function_tolerance=estimation.function_tolerance,
        maximum_iterations=estimation.maximum_iterations,
    )
    settings = settings if search else replace(settings, starting_points=0)

    def generator(purpose: str) -> np.random.Generator:
        return np.random.default_rng(night_seed(estimation.seed, spec.motor_id, night, purpose))

    motor = spec.motor(night, mode)
    lower, upper = Parametrisation.of(motor).coefficient_bounds()
    training = certify(blocks.factor_of(TRAINING), lower, upper)
    short = blocks.short_blocks(spec.settings.windows.block_s)
    unweighted = merge(blocks.factors)
    slow = slow_errors(blocks.factors, short, lower == upper, lower, unweighted)
    factors = whitened(blocks.factors, short, slow)
    whole = merge(factors) if slow.are_slow else unweighted
    fitted = fit(whole, motor, settings, generator(mode))
    excitation = Excitation(
        blocks.span("pressure_bar"), blocks.span("temperature_c"), blocks.span("speed_rpm")
    )
    identification = identify(fitted, factors, excitation, inflation, slow)
    at = dict(zip((REFERENCE, OWN), conditions(spec, blocks, charge_bar), strict=True))
    told = misfit(blocks.factors, short, fitted.coefficients, lower == upper, blocks.block_means())
    structured = None if told is None else structured_misfit([told])
    errors = _errors(
        fitted, identification, excitation, blocks.factors, structured, at, sensitivities
    )
    reference, own = (
        judge_leakage(fitted, identification, excitation, at[name], errors[name].beside_samples)
        for name in (REFERENCE, OWN)
    )
    return BlockFit(
        name=mode,
        fit=fitted,
        training=training,
        identification=identification,
        excitation=excitation,
        duration_s=blocks.duration_s,
        own_means=blocks.means(),
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
        misfit=told,
        structured=structured,
        errors=errors,
    )


def _errors(
    fitted: Fit,
    identification: Identification,
    excitation: Excitation,
    factors: Array,
    structured: StructuredMisfit | None,
    at: Mapping[str, OperatingConditions],
    sensitivities: Sequence[Mapping[str, Any]],
) -> dict[str, ErrorParts]:
    """Parts of the ± of each leakage and coefficient."""
    fixed, distribution = fitted.certificate.fixed, identification.distribution
    sensors = of_sensors(sensitivities)
    rows = {name: regressors(fitted.motor, one)[0] for name, one in at.items()}
    leakages = {name: row[:-2] @ fitted.coefficients[:-1] + row[-1] for name, row in rows.items()}
    constants = 0.0
    if is_outside(excitation, at[REFERENCE]) and leakages[OWN] > 0.0:
        ratio = float(leakages[REFERENCE] / leakages[OWN])
        constants = of_extrapolation(sensitivities, REFERENCE, OWN, ratio)
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
    model: Sequence[float | None] = [None] * len(contrasts)
    if structured is not None:
        reach = model_errors(factors, fixed, np.array([*contrasts.values()]), structured.l_per_min)
        factor = np.repeat([LEAKAGE_FACTOR, COEFFICIENT_FACTOR], [len(rows), len(paths)])
        model = (factor * reach).tolist()
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

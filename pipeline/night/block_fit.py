"""The one fit, from stored blocks: of a night just read, of one fitted anew, of nights together."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from leakage import Fit, OperatingConditions, SearchSettings, fit
from leakage.block_statistics import merge
from leakage.identifiability import (
    Excitation,
    Identification,
    LeakageJudgement,
    identify,
    judge_leakage,
)
from leakage.sensitivities import ErrorBudget
from leakage.uncertainty import Bootstrap, block_bootstrap, lengthened
from pipeline.config import MotorSpec
from pipeline.night.residuals import PartResiduals
from pipeline.night.stored_blocks import StoredBlocks

NO_BUDGET = ErrorBudget(())


@dataclass(frozen=True, slots=True)
class SampleFacts:
    """Facts of the training samples that their blocks do not hold.

    Attributes
    ----------
    minutes
        Kept samples, as time [min].
    own
        Mean pressure difference [bar], temperature [°C] and speed [rpm].
    charge_bar
        Mean charge above case pressure; None in a model of one side.
    inflation
        Factor on standard errors that robust weights ask for; 1 without them.
    """

    minutes: float
    own: tuple[float, float, float]
    charge_bar: float | None
    inflation: float


@dataclass(frozen=True, slots=True)
class BlockFit:
    """The fit under one mode of flushing.

    Attributes
    ----------
    name
        none, fixed or estimated.
    fit, identification
        Estimates; verdicts and intervals.
    excitation
        Range that the training samples saw.
    reference_conditions, own_conditions
        Conditions at which the two leakages are evaluated.
    reference, own
        Leakage at the reference conditions, and at the night's own mean conditions.
    bootstrap
        Percentile limits, a cross-check.
    budget
        Effects of the stated tolerances on θ and both leakages. It needs samples; empty without
        them, without a stated tolerance, or where one leads beyond the model's validity.
    residuals
        Residual analyses of training and validation samples; empty without samples.
    """

    name: str
    fit: Fit
    identification: Identification
    excitation: Excitation
    reference_conditions: OperatingConditions
    own_conditions: OperatingConditions
    reference: LeakageJudgement
    own: LeakageJudgement
    bootstrap: Bootstrap
    budget: ErrorBudget = NO_BUDGET
    residuals: tuple[PartResiduals, ...] = ()


def fit_stored_blocks(
    spec: MotorSpec,
    night: dt.date,
    mode: str,
    training: StoredBlocks,
    facts: SampleFacts,
    memory_s: Callable[[Fit], float],
    *,
    search: bool = True,
    bootstrap: bool = True,
) -> BlockFit:
    """Fit a motor to blocks of training samples, with verdicts and intervals.

    Parameters
    ----------
    spec, night, mode
        Motor, night (it tells the oil) and mode of flushing.
    training, facts
        Blocks of the training samples, and facts of these.
    memory_s
        Gives the time over which the errors of a fit forget [s].
    search
        Make the starts of the search, too; the estimate does not depend on them.
    bootstrap
        Make the block bootstrap, on which nothing but its own columns depends.

    Raises
    ------
    EstimationError
        If there are fewer samples than free coefficients.
    """
    estimation, reference = spec.settings.estimation, spec.settings.reference
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

    fitted = fit(merge(training.factors), spec.motor(night, mode), settings, generator(mode))
    excitation = _excitation(training, facts.minutes, memory_s(fitted))
    identification = identify(fitted, training.factors, excitation, facts.inflation)
    at_reference = OperatingConditions.from_bar(
        reference.pressure_bar, reference.temperature_c, reference.speed_rpm, facts.charge_bar
    )
    at_own = OperatingConditions.from_bar(*facts.own, facts.charge_bar)
    return BlockFit(
        name=mode,
        fit=fitted,
        identification=identification,
        excitation=excitation,
        reference_conditions=at_reference,
        own_conditions=at_own,
        reference=judge_leakage(fitted, identification, excitation, at_reference),
        own=judge_leakage(fitted, identification, excitation, at_own),
        bootstrap=block_bootstrap(
            lengthened(training.factors, excitation.blocks_to_merge),
            fitted.coefficients,
            ~fitted.certificate.fixed,
            # A source of its own: limits do not depend on whether the search was made.
            generator(f"{mode}|bootstrap"),
            resamples=estimation.bootstrap_resamples if bootstrap else 0,
        ),
    )


def _excitation(training: StoredBlocks, minutes: float, memory_s: float) -> Excitation:
    return Excitation(
        minutes=minutes,
        pressure_bar=training.span("pressure_bar"),
        temperature_c=training.span("temperature_c"),
        speed_rpm=training.span("speed_rpm"),
        correlation_time_s=memory_s,
        block_s=training.length_s,
    )


def night_seed(seed: int, motor_id: str, night: dt.date, purpose: str) -> int:
    """Seed of a fit's draws: the same for the same run seed, motor, night and purpose."""
    text = "|".join((str(seed), motor_id, night.isoformat(), purpose))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")

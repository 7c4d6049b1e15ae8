"""A fit from the statistics of blocks, with verdicts and intervals: what needs no samples."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage import Fit, OperatingConditions, SearchSettings, fit
from leakage.block_statistics import merge
from leakage.identifiability import (
    Excitation,
    Identification,
    LeakageJudgement,
    identify,
    judge_leakage,
)
from leakage.uncertainty import Bootstrap, block_bootstrap, lengthened
from pipeline.config import MotorSpec

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BlockFit:
    """The fit under one mode of flushing, and all that its blocks say of it.

    Attributes
    ----------
    name
        none, fixed or estimated.
    fit, identification
        Estimates; verdicts and intervals.
    excitation
        What the training samples saw.
    reference_conditions
        Where the reference leakage is evaluated.
    reference, own
        Leakage at the reference conditions, and at the night's own mean conditions.
    bootstrap
        Percentile limits, a cross-check.
    """

    name: str
    fit: Fit
    identification: Identification
    excitation: Excitation
    reference_conditions: OperatingConditions
    reference: LeakageJudgement
    own: LeakageJudgement
    bootstrap: Bootstrap


def fit_blocks(
    spec: MotorSpec,
    night: dt.date,
    mode: str,
    training: Array,
    excite: Callable[[Fit], Excitation],
    at: tuple[OperatingConditions, OperatingConditions],
    inflation: float = 1.0,
    *,
    search: bool = True,
    bootstrap: bool = True,
) -> BlockFit:
    """Fit a motor to blocks of training samples.

    Parameters
    ----------
    spec, night, mode
        Whose paths, with which oil and which mode of flushing.
    training
        Triangular factors of the blocks in time order, shape (b, c, c).
    excite
        What the samples saw, and how long the fit's errors remember.
    at
        Reference conditions, and the night's own.
    inflation
        Factor on standard errors that robust weights ask for.
    search
        Whether to make the starts of the search, too; the estimate does not depend on them.
    bootstrap
        Whether to make the block bootstrap, which nothing but its own columns depends on.

    Returns
    -------
    BlockFit

    Raises
    ------
    EstimationError
        If there are fewer samples than free coefficients.
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
    generator = np.random.default_rng(night_seed(estimation.seed, spec.motor_id, night, mode))
    fitted = fit(merge(training), spec.motor(night, mode), settings, generator)
    excitation = excite(fitted)
    identification = identify(fitted, training, excitation, inflation)
    return BlockFit(
        name=mode,
        fit=fitted,
        identification=identification,
        excitation=excitation,
        reference_conditions=at[0],
        reference=judge_leakage(fitted, identification, excitation, at[0]),
        own=judge_leakage(fitted, identification, excitation, at[1]),
        bootstrap=block_bootstrap(
            lengthened(training, excitation.blocks_to_merge),
            fitted.coefficients,
            ~fitted.certificate.fixed,
            _resampling(estimation.seed, spec.motor_id, night, mode),
            resamples=estimation.bootstrap_resamples if bootstrap else 0,
        ),
    )


def _resampling(seed: int, motor_id: str, night: dt.date, mode: str) -> np.random.Generator:
    """A source of its own, so that limits do not depend on whether the search was made."""
    return np.random.default_rng(night_seed(seed, motor_id, night, f"{mode}|bootstrap"))


def night_seed(seed: int, motor_id: str, night: dt.date, purpose: str) -> int:
    """Seed of a fit's draws: the same for the same run seed, motor, night and purpose."""
    text = "|".join((str(seed), motor_id, night.isoformat(), purpose))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")

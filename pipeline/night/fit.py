"""A night's fits: one for each mode of flushing, each with verdicts, intervals and error budget."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError, Motor, OperatingConditions
from leakage.estimation.sensitivities import ErrorBudget, error_budget
from pipeline.config import MotorSpec
from pipeline.night.block_fit import BlockFit, conditions, fit_stored_blocks
from pipeline.night.parameter_rows import Row, sensitivity_rows
from pipeline.night.residuals import night_residuals
from pipeline.night.statistics import NightStatistics, mean_charge_bar
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.night.tolerances import assumed_sensors, tolerances

Array = NDArray[np.float64]


def fit_modes(
    spec: MotorSpec, night: dt.date, statistics: NightStatistics, blocks: StoredBlocks
) -> tuple[tuple[BlockFit, ...], list[Row]]:
    """A fit for each mode of flushing, the primary one first, and rows of `sensitivities`.

    Raises EstimationError if there are fewer samples than free coefficients.
    """
    at = conditions(spec, blocks, mean_charge_bar(spec, statistics.samples))
    fits, rows = [], []
    for mode in spec.file.flushing.modes:
        motor = spec.stated.motor(night, mode)
        budget = _budget(spec, statistics, motor, at, night)
        sensitivities = sensitivity_rows(motor, budget, assumed_sensors(spec))
        inflation = statistics.inflation
        fits.append(fit_stored_blocks(spec, night, mode, blocks, at, inflation, sensitivities))
        rows += [{"flushing_mode": mode} | row for row in sensitivities]
    return tuple(fits), rows


def with_residuals(
    spec: MotorSpec,
    statistics: NightStatistics,
    modes: tuple[BlockFit, ...],
    errors: Sequence[Array],
) -> tuple[BlockFit, ...]:
    """Fits with the memory of their errors, and the analyses of what they leave unexplained."""
    smoothing, fits = spec.settings.smoothing, []
    for mode, error in zip(modes, errors, strict=True):
        theta = mode.stated.training.coefficients
        memory_s, residuals = night_residuals(statistics, theta, error, smoothing)
        fits.append(replace(mode, memory_s=memory_s, residuals=residuals))
    return tuple(fits)


def _budget(
    spec: MotorSpec,
    statistics: NightStatistics,
    motor: Motor,
    at: tuple[OperatingConditions, OperatingConditions],
    night: dt.date,
) -> ErrorBudget:
    """All tolerances carried through evenly thinned samples; empty beyond validity."""
    n = len(statistics.samples.index)
    wanted = min(spec.settings.estimation.sensitivity_samples, n)
    chosen = np.linspace(0, n - 1, wanted).round().astype(np.int64)
    thinned = statistics.conditions.part(chosen)
    flow = statistics.samples.leakage_l_per_min[chosen]
    try:
        reference, own = at
        return error_budget(motor, thinned, flow, tolerances(spec, night), [reference], [own])
    except LeakageError:
        return ErrorBudget(())

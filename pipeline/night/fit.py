"""A night's fits: one for each mode of flushing, each with verdicts, intervals and error budget."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError, Motor, OperatingConditions, regressors
from leakage.estimation.sensitivities import ErrorBudget, error_budget
from pipeline.config import MotorSpec
from pipeline.night.block_fit import BlockFit, conditions, fit_stored_blocks
from pipeline.night.parameter_rows import Row, sensitivity_rows
from pipeline.night.residuals import night_residuals
from pipeline.night.statistics import NightStatistics, mean_charge_bar
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.night.tolerances import assumed_sensors, tolerances
from pipeline.night.transport_delay import estimated_delay_s

Array = NDArray[np.float64]

PA_PER_BAR = 1e5


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


def transport_delays_s(
    spec: MotorSpec, statistics: NightStatistics, mode: BlockFit
) -> tuple[float | None, float | None]:
    """Mean delay of the kept samples as configured, and the one estimated; None where it is off."""
    samples = statistics.samples
    delay = samples.delay
    if delay is None:
        return None, None
    rows = samples.index - samples.first_index
    charge = statistics.conditions.charge_over_case_pa
    theta = np.append(mode.stated.fit.coefficients, 1.0)

    def predicted(inputs: Mapping[str, Array], chosen: NDArray[np.int64]) -> Array:
        bar = inputs.get("pressure_difference", samples.pressure_difference_bar[chosen])
        celsius = inputs.get("oil_temperature", samples.oil_temperature_c[chosen])
        rpm = inputs.get("speed", samples.speed_rpm[chosen])
        at = OperatingConditions.from_bar(
            np.abs(bar),
            celsius,
            np.abs(rpm),
            None if charge is None else charge[chosen] / PA_PER_BAR,
        )
        flow: Array = regressors(mode.stated.fit.motor, at) @ theta
        return flow

    estimate = estimated_delay_s(
        delay,
        rows,
        samples.leakage_l_per_min,
        predicted,
        samples.period_us / 1e6,
        spec.settings.transport_delay.maximum_s,
    )
    return float(delay.delay_s[rows].mean()), estimate


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

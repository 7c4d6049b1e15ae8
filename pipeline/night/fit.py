"""A night's fits: one for each mode of flushing, each with verdicts, intervals and error budget."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from leakage import Fit, LeakageError, OperatingConditions, regressors
from leakage.correlation import slowest_correlation_time
from leakage.identifiability import (
    Excitation,
)
from leakage.sensitivities import ChannelTolerance, ErrorBudget, Tolerances, error_budget
from pipeline.config import MotorSpec
from pipeline.night.block_fit import BlockFit, fit_blocks
from pipeline.night.residuals import ROUNDING, PartResiduals, night_residuals
from pipeline.night.statistics import NightStatistics, condition
from pipeline.night.transport_delay import estimated_delay_s
from pipeline.night.windows import TRAINING

Array = NDArray[np.float64]

# Longest memory of the errors that is looked for; beyond it there are no intervals.
LONGEST_MEMORY_S = 600.0
# Means over this time show a slow error under a larger fast one.
MEMORY_CELL_S = 30.0
PA_PER_BAR = 1e5


@dataclass(frozen=True, slots=True)
class FittedMode(BlockFit):
    """The fit under one mode of flushing, and all that the night's samples say of it.

    Attributes
    ----------
    error
        Prediction errors of the training samples, shape (n,) [l/min].
    budget
        Effects of the stated tolerances on θ, the reference leakage and the own leakage; empty
        where none is stated, or one leads where the model does not hold.
    residuals
        Residual analyses of training and validation samples; empty until :func:`with_residuals`.
    """

    error: Array
    budget: ErrorBudget
    residuals: tuple[PartResiduals, ...] = ()

    @classmethod
    def of(cls, found: BlockFit, *, error: Array, budget: ErrorBudget) -> FittedMode:
        """A fit from blocks with what samples add to it."""
        shared = {field.name: getattr(found, field.name) for field in fields(found)}
        return cls(**shared, error=error, budget=budget)


def own_conditions(statistics: NightStatistics) -> tuple[float, float, float]:
    """Mean pressure difference [bar], temperature [°C] and speed [rpm] of the training samples."""
    samples, rows = statistics.samples, statistics.rows_of(TRAINING)
    return (
        float(np.abs(samples.pressure_difference_bar[rows]).mean()),
        float(samples.oil_temperature_c[rows].mean()),
        float(np.abs(samples.speed_rpm[rows]).mean()),
    )


def fit_modes(
    spec: MotorSpec, night: dt.date, statistics: NightStatistics
) -> tuple[FittedMode, ...]:
    """A fit for each mode of flushing, the primary one first; all over the same statistics.

    Raises
    ------
    EstimationError
        If there are fewer samples than free coefficients.
    """
    reference = spec.settings.reference
    samples = statistics.samples
    at = (
        condition(
            spec, samples, reference.pressure_bar, reference.temperature_c, reference.speed_rpm
        ),
        condition(spec, samples, *own_conditions(statistics)),
    )
    return tuple(_fit_mode(spec, night, statistics, mode, at) for mode in spec.file.flushing.modes)


def _fit_mode(
    spec: MotorSpec,
    night: dt.date,
    statistics: NightStatistics,
    mode: str,
    at: tuple[OperatingConditions, OperatingConditions],
) -> FittedMode:
    training = statistics.factors_of(TRAINING)
    rows = statistics.rows_of(TRAINING)

    errors: list[Array] = []

    def excite(fitted: Fit) -> Excitation:
        errors.append(_error(statistics, rows, fitted))
        return _excitation(statistics, rows, errors[0])

    found = fit_blocks(spec, night, mode, training, excite, at, statistics.inflation)
    return FittedMode.of(
        found,
        error=errors[0],
        budget=_budget(spec, statistics, found.fit, rows, night, at),
    )


def with_residuals(
    spec: MotorSpec, statistics: NightStatistics, modes: tuple[FittedMode, ...]
) -> tuple[FittedMode, ...]:
    """Fits with the analyses of what they leave unexplained."""
    smoothing = spec.settings.smoothing
    return tuple(
        replace(
            mode,
            residuals=night_residuals(
                statistics,
                mode.fit.coefficients,
                mode.excitation.correlation_time_s,
                smoothing,
            ),
        )
        for mode in modes
    )


def _error(statistics: NightStatistics, rows: NDArray[np.bool_], fitted: Fit) -> Array:
    error: Array = statistics.z[rows] @ -np.concatenate([fitted.coefficients, (1.0, -1.0)])
    return error


def transport_delays_s(
    spec: MotorSpec, statistics: NightStatistics, mode: FittedMode
) -> tuple[float | None, float | None]:
    """Mean delay of the kept samples as configured, and the one estimated; None where it is off."""
    samples = statistics.samples
    delay = samples.delay
    if delay is None:
        return None, None
    rows = samples.index - samples.first_index
    conditions = statistics.conditions
    theta = np.append(mode.fit.coefficients, 1.0)

    def predicted(inputs: Mapping[str, Array], chosen: NDArray[np.int64]) -> Array:
        charge = conditions.charge_over_case_pa
        bar = inputs.get("pressure_difference", samples.pressure_difference_bar[chosen])
        celsius = inputs.get("oil_temperature", samples.oil_temperature_c[chosen])
        rpm = inputs.get("speed", samples.speed_rpm[chosen])
        at = OperatingConditions.from_bar(
            np.abs(bar),
            celsius,
            np.abs(rpm),
            None if charge is None else charge[chosen] / PA_PER_BAR,
        )
        flow: Array = regressors(mode.fit.motor, at) @ theta
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


def _excitation(statistics: NightStatistics, rows: NDArray[np.bool_], error: Array) -> Excitation:
    samples = statistics.samples
    period_s = samples.period_us / 1e6
    longest = int(min(LONGEST_MEMORY_S / period_s, len(error) // 4))
    memory = 0.0
    # Without noise the errors are rounding, and what rounding remembers is nothing.
    noisy = float(np.abs(error).max()) > ROUNDING * float(np.abs(samples.leakage_l_per_min).max())
    if longest > 1 and noisy:
        cell = round(MEMORY_CELL_S / period_s)
        memory = slowest_correlation_time(error, samples.index[rows], longest, cell) * period_s

    def limits(values: Array) -> tuple[float, float]:
        return float(values.min()), float(values.max())

    blocks = [block for block in statistics.blocks if block.part == TRAINING]
    return Excitation(
        minutes=len(error) * period_s / 60.0,
        pressure_bar=limits(np.abs(samples.pressure_difference_bar[rows])),
        temperature_c=limits(samples.oil_temperature_c[rows]),
        speed_rpm=limits(np.abs(samples.speed_rpm[rows])),
        correlation_time_s=memory,
        block_s=float(np.median([block.end_us - block.start_us for block in blocks])) / 1e6,
    )


def _budget(
    spec: MotorSpec,
    statistics: NightStatistics,
    fitted: Fit,
    rows: NDArray[np.bool_],
    night: dt.date,
    at: tuple[OperatingConditions, OperatingConditions],
) -> ErrorBudget:
    """The stated tolerances carried through evenly thinned training samples."""
    places = np.flatnonzero(rows)
    wanted = min(spec.settings.estimation.sensitivity_samples, len(places))
    chosen = places[np.linspace(0, len(places) - 1, wanted).round().astype(np.int64)]
    conditions = statistics.conditions
    charge = conditions.charge_over_case_pa
    thinned = OperatingConditions(
        conditions.pressure_difference_pa[chosen],
        conditions.oil_temperature_c[chosen],
        conditions.speed_rpm[chosen],
        None if charge is None else charge[chosen],
    )
    flow = statistics.samples.leakage_l_per_min[chosen]
    try:
        return error_budget(fitted.motor, thinned, flow, tolerances(spec, night), at)
    except LeakageError:
        return ErrorBudget(())


def tolerances(spec: MotorSpec, night: dt.date) -> Tolerances:
    """The tolerances that a motor's config states; of two ports the difference's, by squares."""

    def of(*names: str) -> ChannelTolerance:
        channels = [spec.file.channels[name] for name in names if name in spec.file.channels]
        return ChannelTolerance(
            float(np.hypot.reduce([channel.offset_tolerance for channel in channels])),
            float(np.hypot.reduce([channel.gain_tolerance_percent for channel in channels])) / 100,
        )

    paths = spec.motor_type.path
    oil, model = spec.oil_on(night), spec.settings.model
    return Tolerances(
        pressure_bar=of("pressure_difference", "high_port_pressure", "low_port_pressure"),
        temperature_c=of("oil_temperature"),
        speed_rpm=of("speed"),
        flow_l_per_min=of("leakage_flow"),
        deformation={
            path.name: path.deformation_tolerance_percent / 100
            for path in paths
            if path.law == "annular_gap"
        },
        speed_curve={
            path.name: path.curve_tolerance_percent / 100
            for path in paths
            if path.law == "speed_curve"
        },
        pressure_viscosity=oil.pressure_viscosity_tolerance_percent / 100,
        density=oil.density_tolerance_percent / 100,
        film_pressure_share=model.film_pressure_share_tolerance,
        charge_pressure_bar=model.charge_pressure_tolerance_bar,
    )

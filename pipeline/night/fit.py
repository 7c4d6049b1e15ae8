"""A night's fits: one for each mode of flushing, each with verdicts, intervals and error budget."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from leakage import Fit, LeakageError, OperatingConditions, regressors
from leakage.correlation import slowest_correlation_time
from leakage.sensitivities import ChannelTolerance, ErrorBudget, Tolerances, error_budget
from pipeline.config import MotorSpec
from pipeline.night.block_fit import NO_BUDGET, BlockFit, SampleFacts, fit_stored_blocks
from pipeline.night.residuals import ROUNDING, night_residuals
from pipeline.night.statistics import NightStatistics, mean_charge_bar
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.night.transport_delay import estimated_delay_s
from pipeline.night.windows import TRAINING

Array = NDArray[np.float64]

# Longest memory of the errors that is looked for; beyond it there are no intervals.
LONGEST_MEMORY_S = 600.0
# Means over this time show a slow error under a larger fast one.
MEMORY_CELL_S = 30.0
PA_PER_BAR = 1e5


def sample_facts(spec: MotorSpec, statistics: NightStatistics) -> SampleFacts:
    """Facts of the training samples, and of the charge pressure over the night."""
    samples, rows = statistics.samples, statistics.rows_of(TRAINING)
    return SampleFacts(
        minutes=int(rows.sum()) * (samples.period_us / 1e6) / 60.0,
        own=(
            float(np.abs(samples.pressure_difference_bar[rows]).mean()),
            float(samples.oil_temperature_c[rows].mean()),
            float(np.abs(samples.speed_rpm[rows]).mean()),
        ),
        charge_bar=mean_charge_bar(spec, samples),
        inflation=statistics.inflation,
    )


def fit_modes(
    spec: MotorSpec, night: dt.date, statistics: NightStatistics, blocks: StoredBlocks
) -> tuple[BlockFit, ...]:
    """A fit for each mode of flushing, the primary one first; all over the same blocks.

    Raises
    ------
    EstimationError
        If there are fewer samples than free coefficients.
    """
    training, facts = blocks.part(TRAINING), sample_facts(spec, statistics)

    def fit_mode(mode: str) -> BlockFit:
        found = fit_stored_blocks(
            spec, night, mode, training, facts, lambda fitted: _memory_s(statistics, fitted)
        )
        return replace(found, budget=_budget(spec, statistics, found, night))

    return tuple(fit_mode(mode) for mode in spec.file.flushing.modes)


def with_residuals(
    spec: MotorSpec, statistics: NightStatistics, modes: tuple[BlockFit, ...]
) -> tuple[BlockFit, ...]:
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


def _memory_s(statistics: NightStatistics, fitted: Fit) -> float:
    """Time over which the prediction errors of the training samples forget [s]."""
    samples, error = statistics.samples, statistics.training_error(fitted.coefficients)
    period_s = samples.period_us / 1e6
    longest = int(min(LONGEST_MEMORY_S / period_s, len(error) // 4))
    # Without noise the errors are rounding, and what rounding remembers is nothing.
    noisy = float(np.abs(error).max()) > ROUNDING * float(np.abs(samples.leakage_l_per_min).max())
    if longest <= 1 or not noisy:
        return 0.0
    index, cell = samples.index[statistics.rows_of(TRAINING)], round(MEMORY_CELL_S / period_s)
    return slowest_correlation_time(error, index, longest, cell) * period_s


def transport_delays_s(
    spec: MotorSpec, statistics: NightStatistics, mode: BlockFit
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


def _budget(
    spec: MotorSpec,
    statistics: NightStatistics,
    found: BlockFit,
    night: dt.date,
) -> ErrorBudget:
    """The stated tolerances carried through evenly thinned training samples."""
    places = np.flatnonzero(statistics.rows_of(TRAINING))
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
        at = found.reference_conditions, found.own_conditions
        return error_budget(found.fit.motor, thinned, flow, tolerances(spec, night), at)
    except LeakageError:
        return NO_BUDGET


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

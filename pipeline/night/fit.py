"""A night's fits, one for each mode of flushing, and the tolerances in their error budgets.

Tolerances of sensors are as stated, or by the kind of sensor where none is.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import replace

import numpy as np

from leakage import LeakageError, Motor, OperatingConditions
from leakage.estimation.sensitivities import (
    ChannelTolerance,
    ErrorBudget,
    Tolerances,
    error_budget,
)
from pipeline.config import MotorSpec
from pipeline.config.channels import Channel
from pipeline.night.block_fit import BlockFit, conditions, fit_stored_blocks
from pipeline.night.parameter_rows import Row, error_budget_rows
from pipeline.night.residuals import night_residuals
from pipeline.night.statistics import NightStatistics
from pipeline.night.stored_blocks import StoredBlocks

PRESSURES = ("pressure_difference", "high_port_pressure", "low_port_pressure")
# EN 837-1, class 1: 1 % of the range, which is this where the config tells none [bar].
PRESSURE_CLASS, PRESSURE_RANGE_BAR = 0.01, 400.0
# IEC 60751, class B: 0.3 + 0.005 |t|, at 50 °C [K].
PT100_CLASS_B_K = 0.55
# Gear meters within their range: 1 % of the reading.
GEAR_METER = 0.01
# Samples that carry the tolerances: the effects are smooth, and more would not move them.
SENSITIVITY_SAMPLES = 1500
ASSUMED = {
    "pressure_difference": "class 1",
    "oil_temperature": "Pt100 class B",
    "leakage_flow": "gear meter",
}


def fit_modes(
    spec: MotorSpec, night: dt.date, statistics: NightStatistics, blocks: StoredBlocks
) -> tuple[tuple[BlockFit, ...], list[Row]]:
    """Return a fit for each mode of flushing, the primary one first, and rows of `error_budget`.

    Raises EstimationError if there are fewer samples than free coefficients.
    """
    at = conditions(spec, blocks)
    fits, rows = [], []
    for mode in spec.file.flushing.modes:
        motor = spec.stated.motor(night, mode)
        budget = _budget(spec, statistics, motor, at, night)
        of_mode = error_budget_rows(motor, budget, assumed_sensors(spec))
        fits.append(fit_stored_blocks(spec, night, mode, blocks, at, of_mode))
        rows += [{"flushing_mode": mode} | row for row in of_mode]
    return tuple(fits), rows


def with_residuals(
    statistics: NightStatistics, modes: tuple[BlockFit, ...]
) -> tuple[BlockFit, ...]:
    """Return fits with the analyses of what they leave unexplained."""
    return tuple(
        replace(mode, residuals=night_residuals(statistics, mode.stated.training.coefficients))
        for mode in modes
    )


def _budget(
    spec: MotorSpec,
    statistics: NightStatistics,
    motor: Motor,
    at: tuple[OperatingConditions, OperatingConditions],
    night: dt.date,
) -> ErrorBudget:
    """Return all tolerances carried through evenly thinned samples; empty beyond validity."""
    n = len(statistics.samples.index)
    chosen = np.linspace(0, n - 1, min(SENSITIVITY_SAMPLES, n)).round().astype(np.int64)
    thinned = statistics.conditions.part(chosen)
    flow = statistics.samples.leakage_l_per_min[chosen]
    try:
        reference, own = at
        return error_budget(motor, thinned, flow, tolerances(spec, night), [reference], [own])
    except LeakageError:
        return ErrorBudget(())


def tolerances(spec: MotorSpec, night: dt.date) -> Tolerances:
    """Return tolerances of channels, oil and model; of two ports the difference's, by squares."""
    oil, model = spec.oil_on(night), spec.settings.model
    return Tolerances(
        pressure_bar=_of(spec, *PRESSURES),
        temperature_c=_of(spec, "oil_temperature"),
        speed_rpm=_of(spec, "speed"),
        flow_l_per_min=_of(spec, "leakage_flow"),
        pressure_viscosity=oil.pressure_viscosity_tolerance_percent / 100,
        density=oil.density_tolerance_percent / 100,
        film_pressure_share=model.film_pressure_share_tolerance,
        charge_pressure_bar=model.charge_pressure_tolerance_bar,
    )


def assumed_sensors(spec: MotorSpec) -> dict[str, str]:
    """Return kind of sensor by channel, of those without a stated tolerance."""
    return {
        name: kind
        for name, kind in ASSUMED.items()
        if not any(_is_stated(channel) for _, channel in _channels(spec, name))
    }


def _channels(spec: MotorSpec, *names: str) -> list[tuple[str, Channel]]:
    wanted = PRESSURES if "pressure_difference" in names else names
    return [(name, spec.file.channels[name]) for name in wanted if name in spec.file.channels]


def _is_stated(channel: Channel) -> bool:
    return bool(channel.offset_tolerance or channel.gain_tolerance_percent)


def _of(spec: MotorSpec, *names: str) -> ChannelTolerance:
    channels = _channels(spec, *names)
    if any(_is_stated(channel) for _, channel in channels):
        found = [
            (channel.offset_tolerance, channel.gain_tolerance_percent / 100)
            for _, channel in channels
        ]
    else:
        found = [_assumed(name, channel) for name, channel in channels]
    offset, gain = (float(np.hypot.reduce(part)) for part in zip(*found, strict=True))
    return ChannelTolerance(offset, gain)


def _assumed(name: str, channel: Channel) -> tuple[float, float]:
    """Return offset and gain by the kind of sensor; of the speed none is assumed."""
    if name in PRESSURES:
        highest = channel.valid_range[1] if channel.valid_range else PRESSURE_RANGE_BAR
        return PRESSURE_CLASS * (channel.sensor_maximum or highest), 0.0
    if name == "oil_temperature":
        return PT100_CLASS_B_K, 0.0
    return 0.0, GEAR_METER if name == "leakage_flow" else 0.0

"""One motor's night, from its truth to the rows of a log."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from leakage import OperatingConditions, leakage_l_per_min
from pipeline.config.channels import ChannelName
from pipeline.demo.fleet import DemoNight, Plan, truth_of
from pipeline.demo.noise import FloatArray, correlated_noise
from pipeline.demo.operation import Operation, simulate_operation
from pipeline.demo.sensors import (
    FaultRates,
    Recording,
    Sensor,
    flow_noise_l_per_min,
    measure,
    with_faults,
    with_frozen,
    with_log_faults,
)

START_HOUR: Final = 21.5  # UTC, on the evening before the date that labels the night
END_HOUR: Final = 6.0
CHARGE_PRESSURE_BAR: Final = 15.0
FROZEN_SHARE: Final = (0.40, 0.52)  # of the night
SLOW_ERRORS: Final = 0.013  # of the mean leakage, as the short ones
OWN_DELAY_US: Final = 4_000  # of one channel's stamps behind another's
OWN_JITTER_US: Final = 2_000

# White noise, usual spike, and what a broken sensor says, in the units of the tables.
SENSORS: Final[Mapping[ChannelName, tuple[float, float, float]]] = {
    "pressure_difference": (0.05, 60.0, 999.9),
    "high_port_pressure": (0.05, 60.0, 999.9),
    "low_port_pressure": (0.05, 8.0, 999.9),
    "oil_temperature": (0.03, 12.0, 850.0),
    "speed": (0.05, 40.0, 9999.0),
    "leakage_flow": (0.0, 3.0, -1.0),
}


def record_night(night: DemoNight) -> Recording:
    """Simulate a night and log it, faults included."""
    plan, rng = night.plan, night.generator("log")
    time_s = np.arange(round(plan.minutes * 60.0 * plan.rate_hz)) / plan.rate_hz
    signals = _signals(night, simulate_operation(night.demo.duty, time_s, rng), rng)
    delays = _own_delays_us(night, time_s.size, rng)
    values = {
        name: _logged(night, name, _at_own_time(signal, time_s, delays.get(name)), rng)
        for name, signal in signals.items()
    }
    values["oil_temperature"] = _once_a_second(values["oil_temperature"], time_s)
    recording = Recording(_stamps_us(plan, night.label, time_s), values, delays)
    return with_log_faults(recording, FaultRates(), plan.minutes / 60.0, rng)


def _signals(
    night: DemoNight, operation: Operation, rng: np.random.Generator
) -> dict[ChannelName, FloatArray]:
    """True signal at each sensor, by channel."""
    pressures: dict[ChannelName, FloatArray] = {
        "pressure_difference": operation.pressure_difference_bar
    }
    if "pressure_difference" not in night.spec.file.channels:
        step_s = 1.0 / night.plan.rate_hz
        wander = correlated_noise(rng, operation.time_s.size, step_s, 30.0)
        low = CHARGE_PRESSURE_BAR + 0.4 * wander
        pressures = {
            "high_port_pressure": low + operation.pressure_difference_bar,
            "low_port_pressure": low,
        }
    return pressures | {
        "oil_temperature": operation.oil_temperature_c,
        "speed": operation.speed_rpm,
        "leakage_flow": _drain_flow(night, operation, rng),
    }


def _drain_flow(night: DemoNight, operation: Operation, rng: np.random.Generator) -> FloatArray:
    """Leakage with its noise, flushing, and the sensor at its maximum under back-flow."""
    motor, coefficients = night.motor, truth_of(night).coefficients
    conditions = OperatingConditions.from_bar(
        operation.pressure_difference_bar, operation.oil_temperature_c, operation.speed_rpm
    )
    leakage = leakage_l_per_min(motor, conditions, coefficients)
    step_s, slow_s = 1.0 / night.plan.rate_hz, 60.0 * night.plan.slow_errors_min
    noise = flow_noise_l_per_min(leakage, step_s, rng)
    if slow_s:
        slow = correlated_noise(night.generator("slow errors"), leakage.size, step_s, slow_s)
        noise = noise + SLOW_ERRORS * leakage.mean() * slow
    flushing = coefficients[motor.constant.name] if motor.constant else 0.0
    flow = np.maximum(leakage + noise, 0.0) + flushing
    maximum = night.spec.file.channels["leakage_flow"].sensor_maximum
    return flow if maximum is None else np.where(operation.back_flow, maximum, flow)


def _logged(
    night: DemoNight, name: ChannelName, signal: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """A channel as its sensor and the logger make it, in the units of the tables."""
    channel = night.spec.file.channels[name]
    noise, spike, error_value = SENSORS[name]
    sensor = Sensor(channel.resolution, noise, spike, error_value, channel.sensor_maximum)
    # CSV and JSON have no agreed way to write a value that is not finite; Parquet has.
    not_finite = 1.0 if night.spec.file.logs.format == "parquet" else 0.0
    measured = measure(signal, sensor, rng)
    if night.demo.frozen == (night.number, name):
        measured = with_frozen(measured, *(int(at * measured.size) for at in FROZEN_SHARE))
    rates = FaultRates(not_finite=not_finite)
    return with_faults(measured, sensor, rates, night.plan.minutes / 60.0, rng)


def _own_delays_us(
    night: DemoNight, samples: int, rng: np.random.Generator
) -> dict[ChannelName, NDArray[np.int64]]:
    """Each channel's delay behind the common clock, where each message has its own stamp."""
    if night.spec.file.logs.format != "mcap":
        return {}
    return {
        name: OWN_DELAY_US * place + rng.integers(0, OWN_JITTER_US, samples)
        for place, name in enumerate(sorted(night.spec.file.channels))
    }


def _at_own_time(
    signal: FloatArray, time_s: FloatArray, delay_us: NDArray[np.int64] | None
) -> FloatArray:
    return signal if delay_us is None else np.interp(time_s + 1e-6 * delay_us, time_s, signal)


def _once_a_second(values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Blank but for the first sample of each second."""
    is_first = np.diff(np.floor(time_s + 1e-6), prepend=-1.0) > 0.0
    return np.where(is_first, values, np.nan)


def _stamps_us(plan: Plan, label: dt.date, time_s: FloatArray) -> NDArray[np.int64]:
    """UTC stamps in whole milliseconds; a log too long for the evening ends with the night."""
    hours = plan.minutes / 60.0
    start_h = min(START_HOUR - 24.0, END_HOUR - hours)
    midnight = dt.datetime.combine(label, dt.time(), dt.UTC)
    start_ms = round(midnight.timestamp() * 1e3 + start_h * 3.6e6)
    return (start_ms + np.rint(time_s * 1e3).astype(np.int64)) * 1000

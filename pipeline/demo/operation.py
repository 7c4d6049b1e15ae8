"""Operation of a simulated motor in a night: load, speed, oil temperature and halts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pipeline.demo.noise import FloatArray, correlated_noise

LOW_PRESSURE_BAR: Final = 100.0  # below it the piston rings leak enough to be seen
HOLD_S: Final = (20.0, 110.0)
RAMP_S: Final = (8.0, 20.0)
HALT_S: Final = (120.0, 240.0)
RUN_DOWN_S: Final = 6.0  # shorter than the guard time before a standstill, so none of it is kept
RUN_UP_S: Final = 8.0
BACK_FLOW_S: Final = (3.0, 8.0)
TEMPERATURE_PERIODS_S: Final = (1500.0, 3000.0)


@dataclass(frozen=True, slots=True)
class Duty:
    """Duty of a motor."""

    # Lowest and highest level of the pressure difference, [bar]; the same twice: one pressure.
    pressure_bar: tuple[float, float] = (15.0, 300.0)
    # Share of the levels that lie below 100 bar, where the pressures reach that low, [-].
    low_pressure_share: float = 0.45
    # pressure_drift_bar, pressure_ripple_bar: standard deviation of the slow and of the fast
    # variation around a level, [bar].
    pressure_drift_bar: float = 3.0
    pressure_ripple_bar: float = 0.4
    # Lowest and highest level of the speed, [rpm]; levels are even in the logarithm.
    speed_rpm: tuple[float, float] = (3.0, 110.0)
    # Middle of a night's oil temperature and its swing to either side, [°C].
    temperature_c: tuple[float, float] = (49.0, 8.5)
    reverses: bool = False  # the motor runs backward after every other halt


@dataclass(frozen=True, slots=True)
class Operation:
    """True conditions in a motor, sample by sample, before any sensor."""

    time_s: FloatArray  # time since the start, shape (n,), [s]
    # pressure_difference_bar, speed_rpm: shape (n,), [bar] and [rpm]; negative where the motor runs
    # backward, 0 where it stands.
    pressure_difference_bar: FloatArray
    oil_temperature_c: FloatArray  # shape (n,), [°C]
    speed_rpm: FloatArray
    # Shape (n,): the drain line empties backward through its sensor, right after a halt.
    back_flow: NDArray[np.bool_]


def simulate_operation(duty: Duty, time_s: FloatArray, rng: np.random.Generator) -> Operation:
    """Random load cycles of a night at evenly spaced times since its start, shape (n,), [s]."""
    halts = _halts(float(time_s[-1]), rng)
    direction = _direction(time_s, halts) if duty.reverses else np.ones_like(time_s)
    motion = direction * _running(time_s, halts)
    return Operation(
        time_s=time_s,
        pressure_difference_bar=motion * _pressure_bar(duty, time_s, rng),
        oil_temperature_c=_temperature_c(duty, time_s, rng),
        speed_rpm=motion * _speed_rpm(duty, time_s, rng),
        back_flow=_back_flow(time_s, halts, rng),
    )


def _pressure_bar(duty: Duty, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    low, high = duty.pressure_bar
    border = max(low, min(LOW_PRESSURE_BAR, high))

    def levels(count: int) -> FloatArray:
        is_low = rng.random(count) < duty.low_pressure_share
        return np.where(is_low, rng.uniform(low, border, count), rng.uniform(border, high, count))

    step_s = float(time_s[1] - time_s[0])
    level = _load_cycle(time_s, rng, levels)
    drift = duty.pressure_drift_bar * correlated_noise(rng, time_s.size, step_s, 60.0)
    ripple = duty.pressure_ripple_bar * correlated_noise(rng, time_s.size, step_s, 0.5)
    room = 3.0 * (duty.pressure_drift_bar + duty.pressure_ripple_bar)
    return np.clip(level + drift + ripple, max(0.8 * low, low - room), high + room)


def _speed_rpm(duty: Duty, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    low, high = np.log(duty.speed_rpm)
    level = np.exp(_load_cycle(time_s, rng, lambda count: rng.uniform(low, high, count)))
    ripple = 0.3 * correlated_noise(rng, time_s.size, float(time_s[1] - time_s[0]), 2.0)
    return np.maximum(level + ripple, 0.8 * duty.speed_rpm[0])


def _temperature_c(duty: Duty, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Three slow waves, scaled so that every night sees the whole swing."""
    middle, swing = duty.temperature_c
    periods = rng.uniform(*TEMPERATURE_PERIODS_S, 3)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = np.sin(2.0 * np.pi * time_s[:, None] / periods + phases).sum(axis=1)
    span = np.ptp(waves)
    shape = 2.0 * (waves - waves.min()) / span - 1.0
    return np.asarray(middle + rng.uniform(-1.0, 1.0) + swing * shape, dtype=np.float64)


def _load_cycle(
    time_s: FloatArray, rng: np.random.Generator, levels: Callable[[int], FloatArray]
) -> FloatArray:
    """Random levels, each held for a while, with straight ramps between them."""
    count = int(time_s[-1] / (HOLD_S[0] + RAMP_S[0])) + 2
    ramps, holds = rng.uniform(*RAMP_S, count), rng.uniform(*HOLD_S, count)
    ends = np.cumsum(ramps + holds)
    level = levels(count)
    knots = np.column_stack([ends - holds, ends]).ravel()
    return np.interp(time_s, knots, np.repeat(level, 2))


def _halts(seconds: float, rng: np.random.Generator) -> FloatArray:
    """First and last second of each halt: one a slot of 45 minutes, shorter in short logs."""
    count = max(1, round(seconds / 2700.0))
    slot = seconds / count
    lengths = np.minimum(rng.uniform(*HALT_S, count), 0.08 * slot)
    starts = slot * (np.arange(count) + rng.uniform(0.1, 0.75, count))
    return np.column_stack([starts, starts + lengths])


def _running(time_s: FloatArray, halts: FloatArray) -> FloatArray:
    """1 where the motor runs, 0 where it halts, straight between."""
    knots: FloatArray = halts[:, [0, 0, 1, 1]] + np.array([-RUN_DOWN_S, 0.0, 0.0, RUN_UP_S])
    states = np.tile(np.array([1.0, 0.0, 0.0, 1.0]), len(halts))
    return np.asarray(np.interp(time_s, knots.ravel(), states), dtype=np.float64)


def _direction(time_s: FloatArray, halts: FloatArray) -> FloatArray:
    """1 or -1, turned in the middle of each halt."""
    turns = np.searchsorted(halts.mean(axis=1), time_s)
    return np.where(turns % 2 == 0, 1.0, -1.0)


def _back_flow(
    time_s: FloatArray, halts: FloatArray, rng: np.random.Generator
) -> NDArray[np.bool_]:
    ends = halts[:, 0] + rng.uniform(*BACK_FLOW_S, len(halts))
    latest = np.searchsorted(halts[:, 0], time_s, side="right") - 1
    return np.logical_and(latest >= 0, time_s < ends[latest])

"""Nights of simulated machines as stored blocks, with the truth beside them.

All nights of a motor are simulated at once, a sample every ten seconds; a channel has the shape
(n, nights). What is fitted has the paths of a CB560, whatever the machine is. A seed draws the same
operating conditions and errors whatever changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.signal import lfilter

from leakage import OperatingConditions, regressors
from leakage.watch import Machine as Watched
from leakage.watch import NightBlocks
from pipeline.arrays import Array
from pipeline.config import load_fleet
from pipeline.demo.fleet import phi_of

STEP_S, BLOCK_S = 10.0, 120.0
OWN_SAMPLES = 480  # of the baseline, at which the motor's own change is taken
CONFIG = Path(__file__).parents[2] / "configs" / "fleet.toml"
MODEL = next(
    motor.motor(date(2026, 1, 1), "none")
    for motor in load_fleet(CONFIG).motors
    if motor.motor_id == "CB560-01"
)
# θ as configured, shape (p + 1,), and the names of its columns.
THETA = np.array([path.configured_coefficient if path else 0.0 for path in MODEL.coefficient_paths])
PATHS = RING, PISTON, SLEEVE = tuple(path.name for path in MODEL.column_paths)
OIL_VG68 = (68.0, 8.7)  # kinematic viscosity at 40 and 100 °C [mm²/s]


class Fitted(NamedTuple):
    """What the watch is given of a machine: it, and its drives of the regressors, shape (5, p)."""

    watched: Watched
    columns: Array


THREE_PATHS = Fitted(Watched((*PATHS, "known"), PATHS, OIL_VG68), np.eye(5)[:, [0, 1, 2, 4]])
AND_FLUSHING = Fitted(Watched((*PATHS, "flushing", "known"), PATHS, OIL_VG68), np.eye(5))
# One path stands for all gaps but the rings, beside the flushing.
ONE_PATH = Fitted(
    Watched(("all_gaps", "flushing"), ("all_gaps",), OIL_VG68),
    np.array([[0.0, *THETA[1:3], 0.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0]]).T,
)


@dataclass(frozen=True)
class State:
    """What a motor and its sensors are; as at first, by default.

    Each is a number or that of each night, shape (nights,); those that are 1 at first are factors.
    """

    # On the conductance of all gaps that wear, and of each of a CB560.
    wear: float | Array = 1.0
    piston_ring: float | Array = 1.0
    balance_piston: float | Array = 1.0
    balance_sleeve: float | Array = 1.0
    # viscosity, gain: on the oil's viscosity and on what the flow meter reads.
    viscosity: float | Array = 1.0
    gain: float | Array = 1.0
    # load, speed: on the highest load and speed.
    load: float | Array = 1.0
    speed: float | Array = 1.0
    vg46: float | Array = 0.0  # 1: VG 46 is in the motor
    # warmer_k, reads_high_c: oil warmer than at first, and what its sensor reads too much.
    warmer_k: float | Array = 0.0
    reads_high_c: float | Array = 0.0
    zero_l_per_min: float | Array = 0.0  # what the meter reads too much
    # temperature_lag_s, drain_lag_s: of the temperature sensor, and of the flow behind the motor.
    temperature_lag_s: float | Array = 0.0
    drain_lag_s: float | Array = 0.0
    dead_below_l_per_min: float | Array = 0.0  # flow below which the meter stands still
    ring_like: float | Array = 0.0  # a leak at low pressure, over the mean flow of all gaps
    wander: float | Array = 1.0  # of the paths from night to night, shape (nights, 3)

    @property
    def as_first(self) -> State:
        """The same operating conditions of a machine in which nothing has changed."""
        return State(load=self.load, speed=self.speed, warmer_k=self.warmer_k, wander=self.wander)


HEALTHY = State()
Course = Callable[[Array], State]  # of the nights' numbers


class Duty(NamedTuple):
    """Conditions, shape (n, nights) each: pressure [bar], temperature [°C], speed [rpm]."""

    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array

    def conditions(self, charge_bar: float | None = None) -> OperatingConditions:
        """Sample by sample, night after night."""
        pressure, temperature, speed = (channel.T.ravel() for channel in self)
        return OperatingConditions.from_bar(pressure, temperature, speed, charge_bar)


class Errors(NamedTuple):
    """Of sensors and paths: the meter's factor, shape (n, nights), others of each night."""

    gain: Array
    pressure_bar: Array
    temperature_c: Array
    paths: float | Array = 1.0


@dataclass(frozen=True, kw_only=True)
class Machine(ABC):
    """A machine with physics of its own, and what is fitted to it."""

    fitted: Fitted = THREE_PATHS
    own_every: ClassVar[int] = 1  # every how many samples its own change is taken from

    @property
    def flushing_l_per_min(self) -> float:
        """Flow in the drain line that is no leakage."""
        return 0.0

    @abstractmethod
    def duty(self, generator: np.random.Generator, nights: int, state: State) -> Duty:
        """What it does in its nights."""

    @abstractmethod
    def flow(self, duty: Duty, state: State) -> Array:
        """Drain flow without errors, shape (n, nights) [l/min]."""

    @abstractmethod
    def errors(self, seed: Sequence[int], n: int, nights: int) -> Errors:
        """What its sensors make of it."""


@dataclass(frozen=True, slots=True)
class History:
    """A motor's nights, what the watch is given of it, and what is true."""

    machine: Watched
    nights: tuple[NightBlocks, ...]
    # What is measured over what the machine as at first has at the conditions as read, less 1, of
    # each night and without errors: at the night's conditions, and at those of the baseline.
    newest_night: Array
    change: Array


def history(
    machine: Machine, course: Course, seed: Sequence[int], nights: int, baseline: int = 60
) -> History:
    """A motor's nights, and by how much their flow has changed."""
    state = course(np.arange(float(nights)))
    duty = machine.duty(np.random.default_rng([*seed, 0]), nights, state)
    n = len(duty.pressure_bar)
    errors = machine.errors(seed, n, nights)
    state = replace(state, wander=errors.paths)
    flow = _flow(machine, duty, state)
    read = duty._replace(
        temperature_c=_late(duty.temperature_c, state.temperature_lag_s) + state.reads_high_c
    )
    seen = Duty(
        np.maximum(duty.pressure_bar + errors.pressure_bar, 0.5),
        read.temperature_c + errors.temperature_c,
        duty.speed_rpm,
    )
    columns = regressors(MODEL, seen.conditions()) @ machine.fitted.columns
    drives = _block_means(columns.reshape(nights, n, -1).swapaxes(0, 1))
    measured = _block_means(_metered(flow * errors.gain, state))
    channels = np.stack([seen.temperature_c, seen.pressure_bar, seen.speed_rpm], axis=-1)
    means = _block_means(channels)
    middle_s = BLOCK_S * (np.arange(float(len(means))) + 0.5)
    blocks = (
        NightBlocks(day, middle_s, drives[:, day], measured[:, day], means[:, day])
        for day in range(nights)
    )
    changes = _change(machine, state, read, flow, baseline)
    return History(machine.fitted.watched, tuple(blocks), *changes)


def drives_and_leakage(machine: Machine, conditions: Array) -> tuple[Array, float]:
    """Of a machine in which nothing has changed, at some [°C], [bar] and [rpm]: (p,), [l/min]."""
    celsius, bar, rpm = conditions.reshape(3, 1, 1)
    duty = Duty(bar, celsius, rpm)
    drives = regressors(MODEL, duty.conditions())[0] @ machine.fitted.columns
    return drives, float(machine.flow(duty, HEALTHY)[0, 0])


def _flow(machine: Machine, duty: Duty, state: State) -> Array:
    return _late(machine.flow(duty, state) * state.gain, state.drain_lag_s)


def _metered(flow: Array, state: State) -> Array:
    """What the meter makes of a flow, shape (n, nights)."""
    read: Array = np.where(flow < state.dead_below_l_per_min, 0.0, flow) + state.zero_l_per_min
    return read


def _change(
    machine: Machine, state: State, read: Duty, flow: Array, baseline: int
) -> tuple[Array, Array]:
    """Measured leakage over that of the machine as at first at the conditions as read, less 1.

    At each night's conditions, and at those of the baseline, shape (nights,) both.
    """
    nights, flushing = flow.shape[1], machine.flushing_l_per_min
    now = replace(state, temperature_lag_s=0.0, drain_lag_s=0.0)
    before = _flow(machine, read, now.as_first).mean(axis=0) - flushing
    newest_night = (_metered(flow, now).mean(axis=0) - flushing) / before - 1.0
    own = [channel[:: machine.own_every, :baseline].reshape(-1, 1) for channel in read]
    step = max(1, own[0].size // OWN_SAMPLES)
    seen = Duty(*(np.tile(channel[::step], nights) for channel in own))
    now = replace(now, wander=1.0)
    warm = seen._replace(temperature_c=seen.temperature_c - now.reads_high_c)
    changed = _metered(_flow(machine, warm, now), now).mean(axis=0) - flushing
    first = _flow(machine, seen, now.as_first).mean(axis=0) - flushing
    return newest_night, changed / first - 1.0


def _late(signal: Array, lag_s: float | Array) -> Array:
    lags = np.broadcast_to(lag_s, signal.shape[1])
    late = signal.copy()
    for lag in np.unique(lags[lags > 0.0]):
        late[:, lags == lag] = lagging(signal[:, lags == lag], lag)
    return late


def lagging(signal: Array, time_constant_s: float) -> Array:
    """First-order lag behind a signal, settled on its first value: heat behind its sensor."""
    phi = phi_of(STEP_S, time_constant_s)
    lagged, _ = lfilter([1.0 - phi], [1.0, -phi], signal, axis=0, zi=phi * signal[:1])
    return np.asarray(lagged, dtype=np.float64)


def levels(
    generator: np.random.Generator, n: int, nights: int, hold_s: float, lag_s: float
) -> Array:
    """Levels within 0 to 1 that are held for so long each, smoothed; shape (n, nights)."""
    held = round(hold_s / STEP_S)
    drawn = np.repeat(generator.random((n // held + 1, nights)), held, axis=0)
    return lagging(drawn[:n], lag_s)


def _block_means(samples: Array) -> Array:
    """Means of blocks of two minutes of the first axis."""
    rows = round(BLOCK_S / STEP_S)
    n = len(samples) // rows
    means: Array = samples[: n * rows].reshape(n, rows, *samples.shape[1:]).mean(axis=1)
    return means

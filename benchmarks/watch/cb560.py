"""Nights of a CB560 with the placeholders of its type, as stored blocks: fitted, or not quite.

A night is an hour of load steps in a warm-up, up to a load and a speed that differ from night to
night. Its drain flow has short and slow errors as a real record has them
(`benchmarks/results/noise.md`), its sensors wander from night to night. All nights of a motor are
simulated at once, at one sample in ten seconds: their block means are those of samples at 1 Hz
(`tests/test_watched_nights.py`). A seed draws the same operating conditions and errors whatever
changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from benchmarks.simulated_nights import (
    RECORDED_PHI,
    RECORDED_SHORT,
    RECORDED_SLOW,
    RECORDED_SLOW_S,
    WANDER_GAIN,
    WANDER_PHI,
    WANDER_PRESSURE_BAR,
    WANDER_TEMPERATURE_C,
    lagging,
    motor,
    true_coefficients,
)
from benchmarks.watch.history import Asked, History, block_means, night_blocks
from leakage import OperatingConditions, regressors
from leakage.physics.oil import FilmPressure, Oil
from leakage.watch import Machine as Watched
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression, phi_of

MODEL = motor()
THETA = true_coefficients(MODEL)
PATHS = RING, PISTON, SLEEVE = tuple(path.name for path in MODEL.column_paths)
OIL_VG68 = (68.0, 8.7)  # kinematic viscosity at 40 and 100 °C [mm²/s]
VG46 = Oil.from_reference_viscosities(
    "VG 46",
    temperature_1_c=40.0,
    viscosity_1_mm2_per_s=46.0,
    temperature_2_c=100.0,
    viscosity_2_mm2_per_s=6.8,
    density_15_c_kg_per_m3=882.0,
    thermal_expansion_per_k=7e-4,
    pressure_viscosity_per_pa=2e-8,
)
# Ranges from which a night's highest load [bar] and speed [rpm] are drawn.
TOP_BAR, TOP_RPM = (220.0, 300.0), (80.0, 110.0)
STEP_S = 10.0
OWN_SAMPLES = 480  # of the baseline, at which the motor's own change is taken
ODD_GAIN = 0.06  # of odd nights, times Student's t of 3
# Deformation pressure of a ring that leaks at low pressure.
RING_PA = 120e5


@dataclass(frozen=True)
class State:
    """What a motor and its sensors are in a night; as at first, by default."""

    paths: Mapping[str, float] = field(default_factory=dict)  # factors on K
    # viscosity, gain: factors on the oil's viscosity and on what the flow meter reads.
    viscosity: float = 1.0
    gain: float = 1.0
    oil: Oil | None = None  # the oil in the motor; None: the stated one
    # warmer_k, reads_high_c: oil warmer than at first, and what its sensor reads too much.
    warmer_k: float = 0.0
    reads_high_c: float = 0.0
    # load, speed: factors on the highest load and speed.
    load: float = 1.0
    speed: float = 1.0
    zero_l_per_min: float = 0.0  # what the meter reads too much
    # temperature_lag_s, drain_lag_s: of the temperature sensor, and of the flow behind the motor.
    temperature_lag_s: float = 0.0
    drain_lag_s: float = 0.0
    dead_below_l_per_min: float = 0.0  # flow below which the meter stands still
    ring_like: float = 0.0  # a leak at low pressure, over the mean flow of all gaps

    @property
    def as_first(self) -> State:
        """The same operating conditions of a machine in which nothing has changed."""
        return State(warmer_k=self.warmer_k, load=self.load, speed=self.speed)


HEALTHY = State()
Course = Callable[[int], State]


@dataclass(frozen=True)
class Truth:
    """In what a machine differs from the model that is fitted to it."""

    # Pressure at which its films have their viscosity.
    film_pressure: FilmPressure = MODEL.film_pressure
    # Change of all flows with temperature beyond that of the viscosity [1/K].
    per_kelvin: float = 0.0
    # Charge pressure that leaks past the low side; None: leakage is one-sided.
    charge_bar: float | None = None
    # Coefficients of ring, piston, sleeve, flushing [l/min], and the factor of the rollers' curve.
    coefficients: tuple[float, ...] = (*THETA.tolist(), 1.0)


FITTED = Truth()
# Films as in a slot, and an effect of temperature as on both pump records.
OTHERWISE = Truth(FilmPressure("slot"), -0.009)
# The charged low side leaks as well, which the stated model leaves out.
TWO_SIDED = Truth(FilmPressure("slot"), -0.009, 15.0)
FLUSHED = replace(FITTED, coefficients=(*THETA[:-1].tolist(), 0.5, 1.0))
# Nothing but a laminar gap; its flow falls by 0.3 % a kelvin beside the viscosity's.
LAMINAR = Truth(FilmPressure(share=0.0), -0.003, coefficients=(0.0, 2.0 * THETA[1], 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class World:
    """How sensors and paths wander from night to night, beside the usual."""

    wander: float = 1.0  # factor on the wander of sensors
    phi: float = WANDER_PHI
    odd: float = 0.0  # share of odd nights
    paths: float = 0.0  # wander of each path


USUAL = World()


@dataclass(frozen=True)
class Nights:
    """Length [min] and load of nights, and what is fitted to them."""

    minutes: int = 60
    bar: tuple[float, float] | None = None  # every load is between these; None: a night's highest
    with_flushing: bool = False
    one_path: bool = False  # one path stands for all gaps but the rings, beside the flushing

    @property
    def watched(self) -> Watched:
        """What the watch is given of the machine."""
        if self.one_path:
            return Watched(("all_gaps", "flushing"), ("all_gaps",), OIL_VG68)
        flushing = ("flushing",) if self.with_flushing else ()
        return Watched((*PATHS, *flushing, "known"), PATHS, OIL_VG68)

    def drives(self, columns: Array) -> Array:
        """Columns of the paths, of the regressors' shape (n, 5)."""
        if self.one_path:
            gaps = columns[:, 1:3] @ THETA[1:3] + columns[:, 4]
            return np.column_stack([gaps, columns[:, 3]])
        return columns if self.with_flushing else columns[:, [0, 1, 2, 4]]


AN_HOUR = Nights()


@dataclass(frozen=True)
class Duty:
    """True conditions, shape (n, nights) each: pressure [bar], temperature [°C], speed [rpm]."""

    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array

    def part(self, places: Sequence[int] | Array) -> Duty:
        """Of some nights."""
        channels = (self.pressure_bar, self.temperature_c, self.speed_rpm)
        return Duty(*(one[:, places] for one in channels))

    def conditions(self, charge_bar: float | None = None) -> OperatingConditions:
        """Sample by sample, night after night."""
        pressure, temperature, speed = (
            one.T.ravel() for one in (self.pressure_bar, self.temperature_c, self.speed_rpm)
        )
        return OperatingConditions.from_bar(pressure, temperature, speed, charge_bar)


def history(
    truth: Truth,
    course: Course,
    nights: int,
    seed: Sequence[int],
    world: World = USUAL,
    kind: Nights = AN_HOUR,
    step_s: float = STEP_S,
    baseline: int = 60,
) -> History:
    """A motor's nights, and by how much their flow has changed."""
    of_duty, of_errors, of_wander = (np.random.default_rng([*seed, part]) for part in range(3))
    states = [course(place) for place in range(nights)]
    operating_point = _duty(of_duty, states, kind, step_s)
    wander = _wander(of_wander, nights, world)
    flow = _flow(truth, states, operating_point, wander.paths, step_s)
    read_c = _read_c(states, operating_point, step_s)
    read = replace(operating_point, temperature_c=read_c)
    changes = _change(truth, states, read, flow, wander.paths, baseline)
    errors = (1.0 + wander.gain) * (1.0 + _errors(of_errors, flow.shape, step_s))
    measured = _metered(flow * errors, states)
    seen = Duty(
        np.maximum(operating_point.pressure_bar + wander.pressure_bar, 0.5),
        read_c + wander.temperature_c,
        operating_point.speed_rpm,
    )
    drives = kind.drives(regressors(MODEL, seen.conditions()))
    drives = drives.reshape(nights, len(flow), -1).swapaxes(0, 1)
    channels = np.stack([seen.temperature_c, seen.pressure_bar, seen.speed_rpm], axis=-1)
    means = [block_means(one, step_s) for one in (drives, measured, channels)]
    return History(kind.watched, night_blocks(*means), *changes)


def asked(truth: Truth, conditions: Sequence[float]) -> Asked:
    """The leakage of a machine in which nothing has changed, at some [°C], [bar] and [rpm]."""
    temperature_c, pressure_bar, speed_rpm = (np.array([[one]]) for one in conditions)
    operating_point = Duty(pressure_bar, temperature_c, speed_rpm)
    flow = _flow(truth, [HEALTHY], operating_point, np.ones((1, 3)), STEP_S)
    columns = regressors(MODEL, operating_point.conditions())
    drives = AN_HOUR.drives(columns)[0]
    return Asked(drives, np.array(conditions), float(flow[0, 0]))


class Wander(NamedTuple):
    """Errors that sensors and paths keep for a night, shape (nights,); paths (nights, 3)."""

    gain: Array
    temperature_c: Array
    pressure_bar: Array
    paths: Array


def _wander(generator: np.random.Generator, nights: int, world: World) -> Wander:
    remembered = autoregression(generator.standard_normal((nights, 5)), world.phi)
    odd = generator.standard_t(3.0, nights) * (generator.random(nights) < world.odd)
    pressure = WANDER_PRESSURE_BAR * world.wander * generator.standard_normal(nights)
    return Wander(
        WANDER_GAIN * world.wander * remembered[:, 0] + ODD_GAIN * odd,
        WANDER_TEMPERATURE_C * world.wander * remembered[:, 1],
        pressure,
        1.0 + world.paths * remembered[:, 2:],
    )


def _duty(
    generator: np.random.Generator, states: Sequence[State], kind: Nights, step_s: float
) -> Duty:
    """A warm-up under steps of load: 60 s of pressure, 90 s of speed."""
    n, nights = round(60.0 * kind.minutes / step_s), len(states)

    def held(hold_s: float, lag_s: float) -> Array:
        rows = round(hold_s / step_s)
        levels = generator.random((n // rows + 1, nights))
        return lagging(np.repeat(levels, rows, axis=0)[:n], step_s, lag_s)

    def drawn(low: float, high: float) -> Array:
        return generator.uniform(low, high, nights)

    warm_c, cold_k, tau_s = drawn(54.0, 60.0), drawn(8.0, 16.0), drawn(1200.0, 2400.0)
    top_bar, top_rpm = drawn(*TOP_BAR), drawn(*TOP_RPM)
    top_bar = top_bar * [one.load for one in states]
    top_rpm = top_rpm * [one.speed for one in states]
    low_bar, high_bar = kind.bar or (15.0, top_bar)
    time_s = step_s * np.arange(n)[:, None]
    temperature = warm_c - cold_k * np.exp(-time_s / tau_s) + 3.0 * held(600.0, 200.0) - 1.5
    return Duty(
        low_bar + (high_bar - low_bar) * held(60.0, 3.0),
        temperature + [one.warmer_k for one in states],
        3.0 + (top_rpm - 3.0) * held(90.0, 3.0),
    )


def _errors(generator: np.random.Generator, shape: tuple[int, ...], step_s: float) -> Array:
    """Of the flow over the flow, shape (n, nights): means over a step of those of a record."""
    # Variance of a mean of so many samples at 1 Hz of the short errors.
    short = (1.0 + RECORDED_PHI) / (1.0 - RECORDED_PHI) / step_s if step_s > 1.0 else 1.0
    memory = 0.0 if step_s > 1.0 else RECORDED_PHI
    quick = autoregression(generator.standard_normal(shape), memory)
    slow = autoregression(generator.standard_normal(shape), phi_of(step_s, RECORDED_SLOW_S))
    found: Array = RECORDED_SHORT * np.sqrt(short) * quick + RECORDED_SLOW * slow
    return found


def _flow(
    truth: Truth, states: Sequence[State], operating_point: Duty, wander: Array, step_s: float
) -> Array:
    """Drain flow without errors of the sensors, shape (n, nights) [l/min]."""
    flow = np.empty_like(operating_point.pressure_bar)
    oils = {id(one.oil): one.oil for one in states}
    for key, oil in oils.items():
        places = [place for place, one in enumerate(states) if id(one.oil) == key]
        of = replace(MODEL, oil=oil or MODEL.oil, film_pressure=truth.film_pressure)
        part = operating_point.part(places)
        columns = regressors(of, part.conditions(truth.charge_bar))
        factors = np.array([[states[at].paths.get(name, 1.0) for name in PATHS] for at in places])
        theta = np.tile(truth.coefficients, (len(places), 1))
        theta[:, :3] *= factors * wander[places]
        theta[:, [0, 1, 2, 4]] /= np.array([[states[at].viscosity] for at in places])
        by_night = columns.reshape(len(places), len(flow), -1)
        flow[:, places] = np.einsum("kni,ki->nk", by_night, theta)
    flow *= 1.0 + truth.per_kelvin * (operating_point.temperature_c - 55.0)
    low = flow * np.exp(-3e5 * operating_point.pressure_bar / RING_PA)
    flow += low * [one.ring_like for one in states] * (flow.sum(axis=0) / low.sum(axis=0))
    flow *= [one.gain for one in states]
    return _late(flow, [one.drain_lag_s for one in states], step_s)


def _metered(flow: Array, states: Sequence[State]) -> Array:
    """What the meter makes of a flow, shape (n, nights)."""
    dead = flow < [one.dead_below_l_per_min for one in states]
    found: Array = np.where(dead, 0.0, flow) + [one.zero_l_per_min for one in states]
    return found


def _read_c(states: Sequence[State], operating_point: Duty, step_s: float) -> Array:
    """Temperature as read, without wander, shape (n, nights) [°C]."""
    late = _late(operating_point.temperature_c, [one.temperature_lag_s for one in states], step_s)
    found: Array = late + [one.reads_high_c for one in states]
    return found


def _late(signal: Array, lags_s: Sequence[float], step_s: float) -> Array:
    found = signal.copy()
    for lag_s in {one for one in lags_s if one}:
        places = np.flatnonzero(np.array(lags_s) == lag_s)
        found[:, places] = lagging(signal[:, places], step_s, lag_s)
    return found


def _change(
    truth: Truth,
    states: Sequence[State],
    read: Duty,
    flow: Array,
    wander: Array,
    baseline: int,
) -> tuple[Array, Array]:
    """Measured flow over that of the machine as at first at the conditions as read, less 1.

    At each night's conditions, and at those of the baseline, shape (nights,) both.
    """
    newest_night, change = np.zeros((2, len(states)))
    places = [place for place, one in enumerate(states) if one != one.as_first]
    if places:
        now = [replace(states[at], temperature_lag_s=0.0, drain_lag_s=0.0) for at in places]
        first = [one.as_first for one in now]
        before = _flow(truth, first, read.part(places), wander[places], STEP_S).mean(axis=0)
        newest_night[places] = _metered(flow[:, places], now).mean(axis=0) / before - 1.0
        own = read.part(range(min(baseline, len(states))))
        channels = (own.pressure_bar, own.temperature_c, own.speed_rpm)
        step = max(1, own.pressure_bar.size // OWN_SAMPLES)
        seen = Duty(*(np.tile(one.reshape(-1, 1)[::step], len(places)) for one in channels))
        warm = seen.temperature_c - [one.reads_high_c for one in now]
        same = np.ones((len(places), 3))
        changed = _flow(truth, now, replace(seen, temperature_c=warm), same, STEP_S)
        unchanged = _flow(truth, first, seen, same, STEP_S).mean(axis=0)
        change[places] = _metered(changed, now).mean(axis=0) / unchanged - 1.0
    return newest_night, change

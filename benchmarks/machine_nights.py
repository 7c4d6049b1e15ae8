"""Nights of motors as plants have them, sample by sample: what methods are compared on.

A night is an hour at 1 Hz: a warm-up under steps of load, up to a load and a speed that differ from
night to night. Its drain flow has short and slow errors as the real record at hand has them
(`benchmarks/results/noise.md`), and its sensors wander from night to night. A seed draws the same
nights whatever has changed in the motor, so that methods and changes share one set of errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks import error_kinds
from benchmarks.simulated_nights import held_levels, motor, true_coefficients, warming_up
from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.block_statistics import factors
from leakage.physics.oil import FilmPressure, Oil, flow_drive_per_s
from pipeline.arrays import Array
from pipeline.night.operation_rows import coarse_histogram
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C

MODEL = motor()
THETA = true_coefficients(MODEL)
PATHS = RING, PISTON, SLEEVE = tuple(path.name for path in MODEL.column_paths)
MINUTES, BLOCK = 60, 120
N = 60 * MINUTES
# Ranges from which a night's highest load [bar] and speed [rpm] are drawn.
TOP_BAR, TOP_RPM = (220.0, 300.0), (80.0, 110.0)


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
    load: float = 1.0  # factor on the highest load


Course = Callable[[int], State]


@dataclass(frozen=True)
class Machine:
    """In what a machine differs from the model that is fitted to it."""

    # Pressure at which its films have their viscosity.
    film_pressure: FilmPressure = MODEL.film_pressure
    # Change of all flows with temperature beyond that of the viscosity [1/K].
    per_kelvin: float = 0.0
    # Charge pressure that leaks past the low side; None: leakage is one-sided.
    charge_bar: float | None = None


AS_MODELLED = Machine()
# Films as in a slot, and an effect of temperature as on both pump records.
OTHERWISE = Machine(FilmPressure("slot"), -0.009)
# The charged low side leaks as well, which the stated model leaves out.
TWO_SIDED = Machine(FilmPressure("slot"), -0.009, 15.0)


@dataclass(frozen=True, slots=True)
class Night:
    """A night as logged; b blocks of 120 samples."""

    # Triangular factors of the blocks, columns as of the stated model, shape (b, c, c).
    factors: Array
    means: Array  # mean temperature [°C], pressure [bar] and speed [rpm] of each, shape (b, 3)
    drives: Array  # means of ΔP/η, ΔP, ΔP²/η and ω ΔP/η of each, shape (b, 4), each about 1
    flow_l_per_min: Array  # mean drain flow of each, shape (b,)
    spans: Array  # lowest and highest pressure, temperature and speed, shape (3, 2)
    # Samples by pressure, temperature and speed, in the bins of `operation`.
    histograms: tuple[list[int], ...]


def night_of(
    machine: Machine, state: State, wander: error_kinds.NightWander, generator: np.random.Generator
) -> Night:
    """Simulate a night."""
    pressure, temperature, speed = _duty(generator, state)
    temperature = temperature + state.warmer_k
    oil = MODEL.oil if state.oil is None else state.oil
    of: Motor = replace(MODEL, oil=oil, film_pressure=machine.film_pressure)
    theta = THETA * [*(state.paths.get(name, 1.0) for name in PATHS), 1.0]
    at = OperatingConditions.from_bar(pressure, temperature, speed, machine.charge_bar)
    flow = regressors(of, at) @ np.append(theta, 1.0) / state.viscosity
    flow *= 1.0 + machine.per_kelvin * (temperature - 55.0)
    errors = error_kinds.as_recorded(generator, (N,))
    flow *= state.gain * (1.0 + float(wander.gain)) * (1.0 + errors)
    read_bar = np.maximum(pressure + float(wander.pressure_bar), 0.5)
    read_c = temperature + float(wander.temperature_c) + state.reads_high_c
    seen = OperatingConditions.from_bar(read_bar, read_c, speed)
    z = np.column_stack([regressors(MODEL, seen), flow])
    drive = flow_drive_per_s(read_bar * 1e5, read_c, MODEL.oil) / 4e8
    drives = [drive, read_bar / 200.0, drive * read_bar / 200.0, drive * speed / 50.0]
    channels = (read_bar, read_c, speed)
    edges = (PRESSURE_EDGES_BAR, TEMPERATURE_EDGES_C, SPEED_EDGES_RPM)
    return Night(
        factors(z, np.arange(0, N + 1, BLOCK)),
        _block_means([read_c, read_bar, speed]),
        _block_means(drives),
        _block_means([flow])[:, 0],
        np.array([(one.min(), one.max()) for one in channels]),
        tuple(coarse_histogram(one, at) for one, at in zip(channels, edges, strict=True)),
    )


def nights_of(machine: Machine, course: Course, seed: Sequence[int], nights: range) -> list[Night]:
    """Some of a motor's nights; the first is number 0."""
    wander = error_kinds.night_wander(np.random.default_rng([*seed, 0]), (nights.stop,))
    return [
        night_of(
            machine,
            course(place),
            error_kinds.NightWander(*(one[place] for one in wander)),
            np.random.default_rng([*seed, 1, place]),
        )
        for place in nights
    ]


def _duty(generator: np.random.Generator, state: State) -> tuple[Array, Array, Array]:
    """Pressure [bar], temperature [°C] and speed [rpm]: a warm-up under steps of load."""
    temperature = warming_up(N, generator)
    top_bar = state.load * generator.uniform(*TOP_BAR)
    top_rpm = generator.uniform(*TOP_RPM)
    return (
        held_levels(N, 15.0, top_bar, 60, 3.0, generator),
        temperature,
        held_levels(N, 3.0, top_rpm, 90, 3.0, generator),
    )


def _block_means(channels: Sequence[Array]) -> Array:
    means: Array = np.column_stack(channels).reshape(-1, BLOCK, len(channels)).mean(axis=1)
    return means

"""Nights by length, rate, load and errors, fitted as a nightly run does, against their truth.

The samples of each night are simulated; only the decomposition of the regressors is shared by the
nights of one duty, which changes no figure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.simulated_nights import (
    BLOCK_S,
    RECORDED_PHI,
    RECORDED_SHORT,
    RECORDED_SLOW,
    RECORDED_SLOW_S,
    REFERENCE,
    WANDER_GAIN,
    WANDER_PHI,
    WANDER_PRESSURE_BAR,
    WANDER_TEMPERATURE_C,
    CompressedNights,
    Duty,
    duty,
    lagging,
    motor,
    true_coefficients,
)
from leakage import AnnularGap, Motor, OperatingConditions, regressors
from leakage.estimation.block_fit import SampleBlocks, fit_blocks
from leakage.estimation.identifiability import Excitation, judge_leakage
from leakage.estimation.multi_start import Parametrisation
from leakage.physics.paths import LeakagePath
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression, phi_of

NIGHTS_A_DUTY = 5
# Short errors are this large, and three times larger below 100 bar.
NOISE_L_PER_MIN = 0.015
# A load is held for so long.
STEPS_S, CYCLES_S = (60.0, 900.0), (15.0, 90.0)


@dataclass(frozen=True, slots=True)
class SimulatedNights:
    """Nights of one duty of a motor of known θ; `seen` is the duty as the log has it."""

    motor: Motor
    theta: Array
    seen: Duty
    compressed: CompressedNights
    generator: np.random.Generator

    @classmethod
    def of(cls, kind: Kind, seed: int) -> SimulatedNights:
        """Nights of a kind; the same seed makes the same."""
        generator = np.random.default_rng(seed)
        simulated = motor() if kind.coefficients == 3 else one_coefficient(motor())
        seen = duty(kind.minutes / 60.0, generator, kind.rate_hz, kind.hold_s)
        compressed = CompressedNights(simulated, seen)
        return cls(simulated, true_coefficients(simulated), seen, compressed, generator)

    @property
    def step_s(self) -> float:
        """Between samples [s]."""
        return 1.0 / self.seen.rate_hz

    @property
    def clean_flow(self) -> Array:
        """Drain flow without errors, shape (n, 1) [l/min]."""
        flow: Array = self.compressed.columns @ np.append(self.theta, 1.0)[:, None]
        return flow

    @property
    def level(self) -> Array:
        """Standard deviation of the short errors, shape (n, 1) [l/min]."""
        return NOISE_L_PER_MIN * np.where(self.seen.pressure_bar < 100.0, 3.0, 1.0)[:, None]

    def white(self) -> Array:
        """Normal white noise, shape (n, NIGHTS_A_DUTY)."""
        return self.generator.standard_normal((len(self.level), NIGHTS_A_DUTY))

    def as_if(self, **changes: Array) -> Array:
        """Change of the flow, shape (n, 1) [l/min], where the truth is not as the log has it."""
        truth = replace(self.seen, **changes).conditions  # type: ignore[arg-type]
        flow = regressors(self.motor, truth) @ np.append(self.theta, 1.0)[:, None]
        change: Array = flow - self.clean_flow
        return change

    def flow(self, kind: Kind) -> Array:
        """Drain flow as the log has it, shape (n, NIGHTS_A_DUTY) [l/min]."""
        if kind.errors == RECORDED:
            return self.clean_flow + ERRORS[RECORDED](self)
        short = self.level * autoregression(self.white(), kind.phi)
        return self.clean_flow + short + ERRORS[kind.errors](self)


def slow(of: SimulatedNights, minutes: float) -> Array:
    """Errors as large as the short ones that remember for minutes."""
    phi = phi_of(of.step_s, 60.0 * minutes)
    return NOISE_L_PER_MIN * autoregression(of.white(), phi)


def random_walk(of: SimulatedNights) -> Array:
    """Twice as large as the short errors after an hour."""
    found: Array = np.cumsum(of.white(), axis=0) * np.sqrt(of.step_s / 3600.0)
    return 2.0 * NOISE_L_PER_MIN * found


def warm_up(of: SimulatedNights) -> Array:
    """Fades in ten minutes."""
    found: Array = 4.0 * NOISE_L_PER_MIN * np.exp(-of.seen.time_s[:, None] / 600.0)
    return found


def dead_band(of: SimulatedNights) -> Array:
    """A flow meter that loses 0.02 l/min below 40 bar, and is never below 0."""
    lost = np.maximum(of.clean_flow - 0.02, 0.0)
    return np.where(of.seen.pressure_bar[:, None] < 40.0, lost, of.clean_flow) - of.clean_flow


def drifting_offset(of: SimulatedNights) -> Array:
    """By 0.3 l/min in a night, evenly."""
    time_s = of.seen.time_s[:, None]
    found: Array = 0.3 * (time_s / time_s[-1] - 0.5)
    return found


def late_heat(of: SimulatedNights, minutes: float) -> Array:
    """Oil at the gaps that warms later than at its sensor."""
    return of.as_if(temperature_c=lagging(of.seen.temperature_c, of.step_s, 60.0 * minutes))


def heavy_tails(of: SimulatedNights) -> Array:
    """White errors with the tails of Student's t of 4."""
    found: Array = of.level * of.generator.standard_t(4.0, of.white().shape) / np.sqrt(2.0)
    return found


def wander(of: SimulatedNights) -> Array:
    """Of temperature, gain and pressure from night to night."""
    warmer, more = (
        autoregression(of.generator.standard_normal(NIGHTS_A_DUTY), WANDER_PHI) for _ in range(2)
    )
    offset_bar = WANDER_PRESSURE_BAR * of.generator.standard_normal(NIGHTS_A_DUTY)
    shifted = [
        of.as_if(temperature_c=of.seen.temperature_c - t, pressure_bar=of.seen.pressure_bar - p)
        for t, p in zip(WANDER_TEMPERATURE_C * warmer, offset_bar, strict=True)
    ]
    return np.hstack(shifted) + of.clean_flow * WANDER_GAIN * more


def as_recorded(of: SimulatedNights) -> Array:
    """As large as on a real record, short ones and slow ones."""
    short = autoregression(of.white(), RECORDED_PHI)
    slowly = autoregression(of.white(), phi_of(of.step_s, RECORDED_SLOW_S))
    return of.clean_flow * (RECORDED_SHORT * short + RECORDED_SLOW * slowly)


RECORDED = "as recorded"
# Beside the short errors, which all nights have but those as recorded.
ERRORS: dict[str, Callable[[SimulatedNights], Array | float]] = {
    "–": lambda _: 0.0,
    "slow, 5 min": partial(slow, minutes=5.0),
    "slow, 15 min": partial(slow, minutes=15.0),
    "slow, 60 min": partial(slow, minutes=60.0),
    "random walk": random_walk,
    "warm-up": warm_up,
    "dead band": dead_band,
    "drifting offset": drifting_offset,
    "heat 1 min late": partial(late_heat, minutes=1.0),
    "heat 10 min late": partial(late_heat, minutes=10.0),
    "heavy tails": heavy_tails,
    "wander": wander,
    RECORDED: as_recorded,
}


@dataclass(frozen=True, slots=True)
class Kind:
    """Length, rate, φ of the short errors, load, other errors, and free K of nights."""

    minutes: float
    rate_hz: float
    phi: float
    hold_s: tuple[float, float] = CYCLES_S
    errors: str = "–"
    coefficients: int = 3

    @property
    def words(self) -> list[str]:
        """First columns of its row."""
        numbers = (self.minutes, self.rate_hz, self.phi)
        load = "steps" if self.hold_s == STEPS_S else "cycles"
        return [*(f"{one:g}" for one in numbers), load, self.errors, str(self.coefficients)]


KIND_HEADER = "minutes | Hz | φ | load | other errors | free K"


def one_coefficient(of: Motor) -> Motor:
    """The motor with K of the balance pistons free alone."""

    def fixed(path: LeakagePath) -> LeakagePath:
        if not isinstance(path, AnnularGap) or path.name == "balance_piston":
            return path
        known = path.eccentricity and replace(path.eccentricity, fixed=True)
        return replace(path, gap=replace(path.gap, fixed=True), eccentricity=known)

    return replace(of, paths=tuple(fixed(path) for path in of.paths))


class Figure(NamedTuple):
    """A figure of a night: half-width of its interval (nan: none) and its error, relative."""

    name: str
    half_width: float
    error: float


def figures(nights: SimulatedNights, flow: Array) -> Iterator[list[Figure]]:
    """Each night's K, and leakage at the reference and at its own mean conditions."""
    own = OperatingConditions.from_bar(*(float(np.mean(one)) for one in nights.seen.channels))
    for blocks in nights.compressed.factors(flow):
        yield _figures(nights, blocks, own)


def _figures(nights: SimulatedNights, blocks: Array, own: OperatingConditions) -> list[Figure]:
    of, theta = nights.motor, nights.theta
    excitation = Excitation(*((one.min(), one.max()) for one in nights.seen.channels))
    every, n = np.ones(len(blocks), dtype=bool), len(blocks)
    means = np.zeros((n, 3))
    made = fit_blocks(SampleBlocks(blocks, np.arange(n), BLOCK_S, every, means, excitation), of)
    estimate, verdicts = made.fit, made.identified(excitation)
    found = []
    paths = Parametrisation.of(of).paths
    judged = zip(paths, verdicts.coefficients, estimate.coefficients, theta, strict=True)
    for path, judgement, value, true in judged:
        if path is not None and path.is_free:
            half_width = judgement.interval.half_width if judgement.interval else np.nan
            found.append(Figure(path.coefficient_name, half_width / true, value / true - 1.0))
    for name, conditions in (("reference", REFERENCE), ("own conditions", own)):
        row = regressors(of, conditions)[0]
        true = float(row[:-2] @ theta[:-1] + row[-1])
        leakage = judge_leakage(estimate, verdicts, excitation, conditions)
        told = leakage.interval if leakage.is_told else None
        half_width = told.half_width if told else np.nan
        found.append(Figure(name, half_width / true, leakage.leakage_l_per_min / true - 1.0))
    return found

"""How often nights have an interval, how often it holds the truth, and how wide it is.

Each night is a CB560 with the placeholders of its type. Its samples are simulated, and every
estimate, verdict and interval is made by the package as in a nightly run; only the decomposition of
the regressors is shared by the nights of one duty, which changes no figure.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.results_file import RESULTS, write_results
from benchmarks.simulated_nights import (
    BLOCK_S,
    REFERENCE,
    CompressedNights,
    Duty,
    duty,
    motor,
    true_coefficients,
)
from leakage import (
    AnnularGap,
    Motor,
    OperatingConditions,
    Parametrisation,
    SearchSettings,
    fit,
    regressors,
)
from leakage.block_statistics import merge
from leakage.correlation import slowest_correlation_time
from leakage.identifiability import Excitation, identify, judge_leakage
from leakage.paths import LeakagePath
from pipeline.demo import noise

Array = NDArray[np.float64]

NIGHTS, NIGHTS_A_DUTY = 1000, 5
# Short errors are this large, and three times larger below 100 bar.
NOISE_L_PER_MIN = 0.015
STEPS_S, CYCLES_S = (60.0, 900.0), (15.0, 90.0)
NO_SEARCH = SearchSettings(starting_points=0)
STORED = RESULTS / "coverage.json"
NONE = "–"
FIGURES = ("K_piston_ring", "K_balance_piston", "K_balance_sleeve", "reference", "own conditions")
HEADINGS = tuple(
    f"{figure}: {column} %"
    for figure in ("K", "leakage")
    for column in ("with interval", "held", "median ±")
)


@dataclass(frozen=True, slots=True)
class Simulated:
    """Nights of one duty: as the log has it, and the flow [l/min] of a duty without errors."""

    seen: Duty
    clean_flow: Callable[[Duty], Array]
    generator: np.random.Generator

    @property
    def step_s(self) -> float:
        """Between samples [s]."""
        return 1.0 / self.seen.rate_hz

    @property
    def level(self) -> Array:
        """Standard deviation of the short errors, shape (n, 1) [l/min]."""
        return NOISE_L_PER_MIN * np.where(self.seen.pressure_bar < 100.0, 3.0, 1.0)[:, None]

    def white(self) -> Array:
        """Normal white noise, shape (n, NIGHTS_A_DUTY)."""
        return self.generator.standard_normal((len(self.level), NIGHTS_A_DUTY))

    def as_if(self, **changes: Array) -> Array:
        """Error of the flow, shape (n, 1) [l/min], where the truth is not as the log has it."""
        true = self.clean_flow(replace(self.seen, **changes))
        return (true - self.clean_flow(self.seen))[:, None]


def slow(of: Simulated, minutes: float) -> Array:
    """Errors as large as the short ones that remember for minutes."""
    phi = noise.phi_of(of.step_s, 60.0 * minutes)
    return NOISE_L_PER_MIN * noise.autoregression(of.white(), phi)


def late_heat(of: Simulated, minutes: float) -> Array:
    """Oil at the gaps that warms later than at its sensor."""
    late = noise.lagging(of.seen.temperature_c, of.step_s, 60.0 * minutes)
    return of.as_if(temperature_c=late)


def dead_band(of: Simulated) -> Array:
    """Of the flow meter."""
    clean = of.clean_flow(of.seen)
    return (noise.dead_band(clean, of.seen.pressure_bar) - clean)[:, None]


def wander(of: Simulated) -> Array:
    """Of temperature, gain and pressure from night to night."""
    found = noise.night_wander(of.generator, (NIGHTS_A_DUTY,))
    clean = of.clean_flow(of.seen)[:, None]
    shifted = [
        of.as_if(temperature_c=of.seen.temperature_c - t, pressure_bar=of.seen.pressure_bar - p)
        for t, p in zip(found.temperature_c, found.pressure_bar, strict=True)
    ]
    return np.hstack(shifted) + clean * found.gain


# Beside the short errors, which all nights have.
ERRORS: dict[str, Callable[[Simulated], Array | float]] = {
    "–": lambda _: 0.0,
    "slow, 5 min": partial(slow, minutes=5.0),
    "slow, 15 min": partial(slow, minutes=15.0),
    "slow, 60 min": partial(slow, minutes=60.0),
    "random walk": lambda of: noise.random_walk(of.white(), of.step_s, 2.0 * NOISE_L_PER_MIN),
    "warm-up": lambda of: noise.warm_up(of.seen.time_s, 4.0 * NOISE_L_PER_MIN)[:, None],
    "dead band": dead_band,
    "drifting offset": lambda of: noise.drifting_offset(of.seen.time_s)[:, None],
    "heat 1 min late": partial(late_heat, minutes=1.0),
    "heat 10 min late": partial(late_heat, minutes=10.0),
    "heavy tails": lambda of: of.level * noise.heavy_tailed(of.generator, of.white().shape),
    "wander": wander,
}


@dataclass(frozen=True, slots=True)
class Cell:
    """Nights of one kind: length, rate, φ of the short errors, load, other errors, free K."""

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


CELLS = (
    *(Cell(minutes, 10.0, 0.95) for minutes in (10, 15, 30, 60, 90, 480)),
    *(Cell(minutes, 10.0, 0.95, STEPS_S) for minutes in (10, 30, 60, 90)),
    *(Cell(60, 0.2, phi) for phi in (0.5, 0.95)),
    *(Cell(60, 1.0, phi) for phi in (0.5, 0.9, 0.99)),
    *(Cell(60, 10.0, phi) for phi in (0.5, 0.99, 0.999)),
    *(Cell(90, 1.0, 0.9, errors=name) for name in ERRORS),
    Cell(30, 1.0, 0.9, errors="slow, 15 min"),
    Cell(480, 0.2, 0.5, errors="slow, 60 min"),
    *(Cell(minutes, 1.0, 0.9, coefficients=1) for minutes in (10, 30)),
    *(Cell(90, 1.0, 0.9, errors=name, coefficients=1) for name in ("slow, 15 min", "random walk")),
)


class Judged(NamedTuple):
    """A figure of a night: half-width of its interval (nan: none) and its error, relative."""

    figure: str
    half_width: float
    error: float


def one_coefficient(of: Motor) -> Motor:
    """The motor with K of the balance pistons free alone."""

    def fixed(path: LeakagePath) -> LeakagePath:
        if not isinstance(path, AnnularGap) or path.name == "balance_piston":
            return path
        known = path.eccentricity and replace(path.eccentricity, fixed=True)
        return replace(path, gap=replace(path.gap, fixed=True), eccentricity=known)

    return replace(of, paths=tuple(fixed(path) for path in of.paths))


def nights(cell: Cell, seed: int) -> Iterator[Judged]:
    """Figures of the nights of one duty."""
    generator = np.random.default_rng(seed)
    model = motor() if cell.coefficients == 3 else one_coefficient(motor())
    theta = true_coefficients(model)
    seen = duty(cell.minutes / 60.0, generator, cell.rate_hz, cell.hold_s)
    compressed = CompressedNights(model, seen)

    def clean_flow(of: Duty) -> Array:
        columns = compressed.columns if of is seen else regressors(model, of.conditions)
        flow: Array = columns @ np.append(theta, 1.0)
        return flow

    simulated = Simulated(seen, clean_flow, generator)
    short = simulated.level * noise.autoregression(simulated.white(), cell.phi)
    flow = clean_flow(seen)[:, None] + short + ERRORS[cell.errors](simulated)
    for night, blocks in enumerate(compressed.factors(flow)):
        yield from judged(model, theta, seen, blocks, flow[:, night], compressed.columns)


def judged(
    of: Motor, theta: Array, seen: Duty, blocks: Array, flow: Array, columns: Array
) -> Iterator[Judged]:
    """Figures of one night."""
    blocks = blocks[: max(int(0.8 * len(blocks)), 1)]
    estimate = fit(merge(blocks), of, NO_SEARCH, np.random.default_rng(0))
    n = min(round(len(blocks) * BLOCK_S * seen.rate_hz), len(flow))
    error = flow[:n] - columns[:n] @ np.append(estimate.coefficients, 1.0)
    cell = max(round(30.0 * seen.rate_hz), 2)
    lag = int(min(600.0 * seen.rate_hz, n // 4))
    excitation = Excitation(
        minutes=n / seen.rate_hz / 60.0,
        pressure_bar=(seen.pressure_bar.min(), seen.pressure_bar.max()),
        temperature_c=(seen.temperature_c.min(), seen.temperature_c.max()),
        speed_rpm=(seen.speed_rpm.min(), seen.speed_rpm.max()),
        correlation_time_s=slowest_correlation_time(error, np.arange(n), lag, cell) / seen.rate_hz,
        block_s=BLOCK_S,
    )
    verdicts = identify(estimate, blocks, excitation)
    for path, one, found, true in zip(
        Parametrisation.of(of).paths,
        verdicts.coefficients,
        estimate.coefficients,
        theta,
        strict=True,
    ):
        if path is not None and path.is_free:
            half = one.interval.half_width if one.interval else np.nan
            yield Judged(path.coefficient_name, half / true, found / true - 1.0)
    own = OperatingConditions.from_bar(
        *(float(np.mean(one)) for one in (seen.pressure_bar, seen.temperature_c, seen.speed_rpm))
    )
    for figure, conditions in (("reference", REFERENCE), ("own conditions", own)):
        row = regressors(of, conditions)[0]
        true = float(row[:-2] @ theta[:-1] + row[-1])
        leakage = judge_leakage(estimate, verdicts, excitation, conditions)
        known = leakage.verdict == "identified" and leakage.interval is not None
        half = leakage.interval.half_width if known and leakage.interval else np.nan
        yield Judged(figure, half / true, leakage.leakage_l_per_min / true - 1.0)


def measured(cell: Cell) -> dict[str, list[str]]:
    """Share with an interval, coverage and median half-width of each figure, in %."""
    by_figure = defaultdict(list)
    with threadpool_limits(1):
        for seed in range(NIGHTS // NIGHTS_A_DUTY):
            for one in nights(cell, seed):
                by_figure[one.figure].append((one.half_width, one.error))
    return {figure: _cells(np.array(found)) for figure, found in by_figure.items()}


def _cells(found: Array) -> list[str]:
    known = found[np.isfinite(found[:, 0])]
    share = f"{100 * len(known) / len(found):.0f}"
    if not len(known):
        return [share, NONE, NONE]
    held = np.mean(np.abs(known[:, 1]) <= known[:, 0])
    return [share, f"{100 * held:.1f}", f"{100 * np.median(known[:, 0]):.3g}"]


def main(options: Sequence[str] = ()) -> None:
    """Measure all cells or some, and write `benchmarks/results/coverage.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks coverage")
    parser.add_argument("--first", type=int, default=0, help="first cell to measure")
    parser.add_argument("--last", type=int, default=len(CELLS) - 1, help="last cell to measure")
    asked = parser.parse_args(list(options))
    stored = json.loads(STORED.read_text("utf-8")) if STORED.exists() else {}
    for cell in CELLS[asked.first : asked.last + 1]:
        stored[" ".join(cell.words)] = measured(cell)
        STORED.write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n", "utf-8")
    rows = [
        [*cell.words, *_columns(stored[" ".join(cell.words)])]
        for cell in CELLS
        if " ".join(cell.words) in stored
    ]
    header = ("minutes", "Hz", "φ", "load", "other errors", "free K", *HEADINGS)
    title = f"Coverage of 95 % intervals, {NIGHTS} nights a row"
    write_results("coverage", title, header, rows)


def _columns(found: dict[str, list[str]]) -> list[str]:
    """K of rings, pistons and sleeves, then leakage at the reference and at own conditions."""
    return [
        " / ".join(found[figure][place] for figure in group if figure in found)
        for group in (FIGURES[:3], FIGURES[3:])
        for place in range(3)
    ]

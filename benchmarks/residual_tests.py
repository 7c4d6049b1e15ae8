"""How often the residual tests fail a model that is right, and one that is not.

Each night is a CB560 with the placeholders of its type, 10 Hz, errors of a first-order
autoregression. The model is fitted to the first four fifths, as in a nightly run, and its errors
are tested there and on the rest. A right model fails by chance; one in a hundred is the goal.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from benchmarks.results_file import write_results
from benchmarks.simulated_nights import (
    BLOCK_S,
    RATE_HZ,
    CompressedNights,
    Duty,
    duty,
    motor,
    true_coefficients,
)
from leakage import AnnularGap, Motor, regressors
from leakage.estimation.block_statistics import merge
from leakage.estimation.least_squares import fit
from leakage.estimation.multi_start import SearchSettings
from leakage.estimation.residual_analysis import ResidualAnalysis, analyse_residuals
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

NOISE_L_PER_MIN = 0.015
NO_SEARCH = SearchSettings(starting_points=0)
NIGHTS_A_DUTY = 4
ROWS_A_BLOCK = int(BLOCK_S * RATE_HZ)


@dataclass(frozen=True, slots=True)
class Case:
    """What the nights of a row of the table are."""

    # hours, phi: length of the night; coefficient of the errors.
    hours: float
    phi: float
    nights: int
    uneven: bool = False  # errors are three times larger below 100 bar
    refused: int = 0  # one sample in so many is refused; 0: none
    delay: int = 0  # samples by which the flow comes late
    # Factor on the deformation constant of the rings that the logs were made with.
    ring: float = 1.0

    @property
    def words(self) -> str:
        """What is not as the model has it."""
        if self.delay:
            return f"flow {self.delay / RATE_HZ:g} s late"
        if self.ring != 1.0:
            return f"rings' X {100 * (self.ring - 1):+.0f} %"
        return "none"


CASES = (
    *(Case(0.5, phi, 1000) for phi in (0.0, 0.9, 0.99)),
    *(Case(1.0, phi, 1000) for phi in (0.0, 0.9, 0.99)),
    *(Case(8.0, phi, 400) for phi in (0.0, 0.9, 0.99)),
    *(Case(1.0, phi, 600, uneven=True) for phi in (0.0, 0.9, 0.99)),
    *(Case(1.0, phi, 600, refused=500) for phi in (0.0, 0.9, 0.99)),
    *(Case(hours, 0.9, 100, delay=delay) for hours in (1.0, 8.0) for delay in (1, 3, 10)),
    *(Case(hours, 0.9, 100, ring=0.5) for hours in (1.0, 8.0)),
)


def nights(case: Case, seed: int) -> Iterator[tuple[str, ResidualAnalysis]]:
    """Residual analyses of training and validation, of the nights of one duty."""
    generator = np.random.default_rng(seed)
    model = motor()
    seen = duty(case.hours, generator)
    compressed = CompressedNights(model, seen)
    n = compressed.n_blocks * ROWS_A_BLOCK
    columns = compressed.columns[:n]
    clean = _flow(_with_ring(model, case.ring), seen)[:n]
    clean = np.concatenate([np.full(case.delay, clean[0]), clean[: n - case.delay]])
    noise = NOISE_L_PER_MIN * autoregression(
        generator.standard_normal((n, NIGHTS_A_DUTY)), case.phi
    )
    if case.uneven:
        noise *= np.where(seen.pressure_bar[:n, None] < 100.0, 3.0, 1.0)
    flow = clean[:, None] + noise
    # As in a nightly run: four fifths train, one block is left out, the rest validates.
    training = int(0.8 * compressed.n_blocks)
    parts = {
        "training": np.arange(training * ROWS_A_BLOCK),
        "validation": np.arange((training + 1) * ROWS_A_BLOCK, n),
    }
    memory = -1.0 / math.log(case.phi) if case.phi else 0.0
    for night, blocks in enumerate(compressed.factors(flow)):
        found = fit(merge(blocks[:training]), model, NO_SEARCH, generator)
        error = flow[:, night] - columns @ np.append(found.coefficients, 1.0)
        for part, rows in parts.items():
            kept = rows
            if case.refused:
                kept = rows[generator.uniform(size=len(rows)) > 1.0 / case.refused]
            inputs = {
                "pressure": seen.pressure_bar[kept],
                "temperature": seen.temperature_c[kept],
                "speed": seen.speed_rpm[kept],
            }
            yield part, analyse_residuals(error[kept], inputs, kept, memory)


def _flow(of: Motor, seen: Duty) -> Array:
    flow: Array = regressors(of, seen.conditions) @ np.append(true_coefficients(of), 1.0)
    return flow


def _with_ring(of: Motor, factor: float) -> Motor:
    ring, *rest = of.paths
    assert isinstance(ring, AnnularGap)
    assert ring.deformation_pressure_pa is not None
    changed = replace(ring, deformation_pressure_pa=factor * ring.deformation_pressure_pa)
    return replace(of, paths=(changed, *rest))


def _counted(case: Case, seed: int) -> list[tuple[str, str, bool, float]]:
    """Part, test, whether it failed, and its share of lags outside."""
    with threadpool_limits(1):
        return [
            (part, name, test.verdict == "failed", test.outside.sum() / max(test.n_judged, 1))
            for part, found in nights(case, seed)
            for name, test in {"whiteness": found.whiteness, **found.independence}.items()
        ]


def main() -> None:
    """Measure and write `benchmarks/results/residual_tests.md`."""
    rows = []
    for case in CASES:
        many = Parallel(n_jobs=2)(
            delayed(_counted)(case, seed) for seed in range(case.nights // NIGHTS_A_DUTY)
        )
        counted = defaultdict(list)
        for part, name, failed, outside in (one for some in many for one in some):
            counted[part, name].append((failed, outside))
        rows += [_row(case, part, counted) for part in ("training", "validation")]
    columns = (f"{name}: failed % (lags outside %)" for name in NAMES)
    header = " | ".join((WORDS, *columns))
    title = (
        "Residual tests: how often they fail, at a level of 1 % (one motor-day of 864 000 samples: "
        f"{_milliseconds():.0f} ms)"
    )
    write_results("residual_tests", title, header, rows)


WORDS = "wrong in the model | hours | φ | errors | refused | nights | part"
NAMES = ("whiteness", "pressure", "temperature", "speed")


def _row(
    case: Case, part: str, counted: dict[tuple[str, str], list[tuple[bool, float]]]
) -> list[str]:
    return [
        case.words,
        f"{case.hours:g}",
        f"{case.phi:g}",
        "three times larger below 100 bar" if case.uneven else "even",
        f"one in {case.refused}" if case.refused else "none",
        str(case.nights),
        part,
        *(
            "{:.1f} ({:.1f})".format(*(100 * np.mean(counted[part, name], axis=0)))
            for name in NAMES
        ),
    ]


def _milliseconds() -> float:
    """Best of five, one thread."""
    generator = np.random.default_rng(1)
    seen = duty(24.0, generator)
    error = autoregression(generator.standard_normal(len(seen.pressure_bar)), 0.95)
    inputs = {"p": seen.pressure_bar, "t": seen.temperature_c, "w": seen.speed_rpm}
    times = []
    with threadpool_limits(1):
        for _ in range(5):
            begin = time.perf_counter()
            analyse_residuals(error, inputs, np.arange(len(error)), 20.0)
            times.append(time.perf_counter() - begin)
    return 1e3 * min(times)

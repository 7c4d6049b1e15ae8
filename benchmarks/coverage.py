"""How often 95 % intervals hold the truth, over simulated nights with correlated errors.

Each night is a CB560 with the placeholders of its type, 10 Hz, errors of a first-order
autoregression three times larger below 100 bar. Every estimate, verdict and interval is made by the
package as in a nightly run; only the decomposition of the regressors is shared by nights of one
duty. A night's interval counts in "all" whatever the verdict; in "identified" only with it.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from benchmarks.results_file import write_results
from benchmarks.simulated_nights import (
    BLOCK_S,
    RATE_HZ,
    REFERENCE,
    CompressedNights,
    correlated_noise,
    duty,
    motor,
    true_coefficients,
)
from leakage import Parametrisation, SearchSettings, fit, regressors
from leakage.block_statistics import merge
from leakage.correlation import correlation_time
from leakage.identifiability import Excitation, identify, judge_leakage
from pipeline.config.motors import FlushingTable

NIGHTS, NIGHTS_A_DUTY = 1000, 20
NOISE_L_PER_MIN = 0.015
CELLS = [(hours, phi) for hours in (0.5, 1.0, 8.0) for phi in (0.0, 0.9, 0.95, 0.99)]
MUST_FAIL = (1.0, 0.999)
LONGEST_LAG_S = 600.0
NO_SEARCH = SearchSettings(starting_points=0)
FLUSHING = FlushingTable(mode="estimated", flow_l_per_min=4.0)


@dataclass(frozen=True, slots=True)
class Judged:
    """One figure of one night: whether it was identified, and its interval held the truth."""

    figure: str
    identified: bool
    has_interval: bool
    held: bool
    relative_half_width: float


def nights(mode: str, hours: float, phi: float, seed: int) -> list[Judged]:
    """Judge all figures of the nights of one duty."""
    generator = np.random.default_rng(seed)
    model = motor(FLUSHING, mode)
    theta = true_coefficients(model)
    seen = duty(hours, generator)
    compressed = CompressedNights(model, seen)
    columns = compressed.columns
    clean = columns @ np.append(theta, 1.0)
    level = NOISE_L_PER_MIN * np.where(seen.pressure_bar < 100.0, 3.0, 1.0)
    noise = correlated_noise(len(clean), phi, NIGHTS_A_DUTY, generator) * level[:, None]
    flow = clean[:, None] + noise
    reference_row = regressors(model, REFERENCE)[0]
    truth = float(reference_row[:-2] @ theta[:-1] + reference_row[-1])
    found = []
    for night, blocks in enumerate(compressed.factors(flow)):
        estimate = fit(merge(blocks), model, NO_SEARCH, generator)
        error = flow[:, night] - columns @ np.append(estimate.coefficients, 1.0)
        lag = int(min(LONGEST_LAG_S * RATE_HZ, len(error) // 4))
        memory = correlation_time(error, np.arange(len(error)), lag) / RATE_HZ
        excitation = Excitation(
            minutes=hours * 60.0,
            pressure_bar=(seen.pressure_bar.min(), seen.pressure_bar.max()),
            temperature_c=(seen.temperature_c.min(), seen.temperature_c.max()),
            speed_rpm=(seen.speed_rpm.min(), seen.speed_rpm.max()),
            correlation_time_s=memory,
            block_s=BLOCK_S,
        )
        verdicts = identify(estimate, blocks, excitation)
        for place, path in enumerate(Parametrisation.of(model).paths):
            if path is None or not path.is_free:
                continue
            judgement = verdicts.coefficients[place]
            unit = np.eye(len(theta))[place]
            distribution = verdicts.distribution
            active = distribution is not None and distribution.active[place]
            interval = distribution.interval(unit) if active and distribution else None
            found.append(
                _judged(
                    path.coefficient_name,
                    judgement.verdict == "identified",
                    None if interval is None else interval.half_width,
                    estimate.coefficients[place] - theta[place],
                    theta[place],
                )
            )
        leakage = judge_leakage(estimate, verdicts, excitation, REFERENCE)
        width = None if leakage.interval is None else leakage.interval.half_width
        deviation = leakage.leakage_l_per_min - truth
        found.append(_judged("reference", leakage.verdict == "identified", width, deviation, truth))
    return found


def _judged(
    figure: str, identified: bool, half_width: float | None, deviation: float, truth: float
) -> Judged:
    if half_width is None:
        return Judged(figure, identified, False, False, np.nan)
    return Judged(figure, identified, True, abs(deviation) <= half_width, half_width / truth)


def main() -> None:
    """Measure and write `benchmarks/results/coverage.md`."""
    rows = []
    for mode in ("none", "estimated"):
        for hours, phi in (*CELLS, MUST_FAIL):
            many = Parallel(n_jobs=2)(
                delayed(nights)(mode, hours, phi, seed) for seed in range(NIGHTS // NIGHTS_A_DUTY)
            )
            by_figure = defaultdict(list)
            for judged in (one for some in many for one in some):
                by_figure[judged.figure].append(judged)
            rows += [_row(mode, hours, phi, name, found) for name, found in by_figure.items()]
    header = (
        "flushing",
        "hours",
        "φ",
        "figure",
        "all %",
        "identified %",
        "identified, share %",
        "without interval, share %",
        "median ± %",
    )
    write_results("coverage", "Coverage of 95 % intervals, 1000 nights a cell", header, rows)


def _row(mode: str, hours: float, phi: float, name: str, found: list[Judged]) -> list[str]:
    with_interval = [one for one in found if one.has_interval]
    identified = [one for one in with_interval if one.identified]

    def percent(some: list[Judged]) -> str:
        return f"{100 * np.mean([one.held for one in some]):.1f}" if some else "–"

    widths = [one.relative_half_width for one in with_interval]
    return [
        mode,
        f"{hours:g}",
        f"{phi:g}",
        name,
        percent(with_interval),
        percent(identified),
        f"{100 * np.mean([one.identified for one in found]):.0f}",
        f"{100 * (1 - len(with_interval) / len(found)):.0f}",
        f"{100 * np.median(widths):.2f}" if widths else "–",
    ]

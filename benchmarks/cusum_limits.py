"""Limits of the cumulative sum, calibrated by simulation; writes `leakage/course/cusum_limits.py`.

A healthy indicator is a normal first-order autoregression. Its baseline is estimated from its first
nights exactly as the package does, then it is watched for a year. The limit may depend on what is
known when it is needed: the length of the baseline and the estimated φ, never the true one. Of all
limits that rise with the estimated φ and keep the share of alarmed years at the rate whatever the
true φ up to 0.6, the ones with the least mean logarithm are taken (a Lagrangian with one multiplier
for each true φ, found by dual ascent).

Where a floor decides, standard deviation and φ are no estimates and only the mean is one: a second,
lower set of limits. Between the two it is interpolated by how close the nights' own scatter may
come to the floor; the last table of the results checks what that gives.

Run `python -m benchmarks cusum_limits` after a change of the baseline's estimators, of the
reference value or of winsorising; it takes about three minutes. `benchmarks/alarms.py` measures
with what it has written.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import chdtri

from benchmarks.results_file import Part, write_parts
from leakage.course.autoregression import HIGHEST_PHI, variance_of_mean
from leakage.course.baseline import BaselineSettings, fit_baseline
from leakage.course.cusum import (
    BASELINE_ERRORS,
    FLOOR_DECIDES,
    NIGHTS_DECIDE,
    REFERENCE_VALUE,
    WINSORISED_AT,
    cusum,
)
from leakage.estimation.robust import MAD_TO_SD
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

LENGTHS = (15, 20, 30, 40, 60, 90, 120)
RATES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
TRUE_PHI = np.arange(0.0, 0.65, 0.1)
BEYOND_PHI = (0.7, 0.8)
NODES = np.arange(0.0, 0.95, 0.1)
YEAR = 365
SERIES = 40_000
# A healthy indicator that is told changed at all is so 1.2 times a year, and real errors have
# heavier tails than normal ones: the limits are sought at the rate divided by this.
MARGIN = 2.0
CHUNK = 5_000
SCATTERS = (0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.5)
CANDIDATES = np.exp(np.linspace(np.log(2.0), np.log(400.0), 400))
ROUNDS = 2_000
ASCENT = 0.03
TABLE = Path(__file__).parent.parent / "leakage" / "course" / "cusum_limits.py"


def estimated(values: Array) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and φ of baselines side by side: `fit_baseline` without a floor."""
    n = len(values)
    median = np.median(values, axis=0)
    at = BaselineSettings().winsorised_at
    reach = at * MAD_TO_SD * np.median(np.abs(values - median), axis=0)
    steady = np.clip(values, median - reach, median + reach)
    centred = steady - steady.mean(axis=0)
    place = np.arange(n) - (n - 1) / 2
    residual = centred - place[:, None] * (place @ steady) / (place @ place)
    correlation = np.mean(residual[1:] * residual[:-1], axis=0) / np.mean(residual**2, axis=0)
    phi = np.clip(correlation + (2 + 4 * correlation) / n, 0.0, HIGHEST_PHI)
    return steady.mean(axis=0), steady.std(axis=0, ddof=1), phi


def walked(steps: Array, phi: Array, mean_error: Array) -> Array:
    """Highest cumulative sum of whitened steps, by series."""
    carried = BASELINE_ERRORS * mean_error * np.sqrt((1.0 - phi) / (1.0 + phi))
    walk = np.cumsum(
        np.clip(steps, -WINSORISED_AT, WINSORISED_AT) - REFERENCE_VALUE - carried, axis=0
    )
    result: Array = (walk - np.minimum(np.minimum.accumulate(walk, axis=0), 0.0)).max(axis=0)
    return result


def highest_sums(values: Array, length: int, floor: float = 0.0) -> tuple[Array, Array, Array]:
    """Floored φ, upper bound of sd over its floor, and highest sum, of each series."""
    mean, sd, phi = estimated(values[:length])
    floored_sd = np.maximum(sd, floor)
    ratio = (sd / floored_sd) ** 2 * phi / (1.0 - phi)
    floored = ratio / (1.0 + ratio)
    freedom = np.maximum(length * (1.0 - phi**2) / (1.0 + phi**2) - 1.0, 1.0)
    highest_sd = sd * np.sqrt(freedom / chdtri(freedom, 0.95))
    grid = np.linspace(0.0, HIGHEST_PHI, 96)
    error = [np.sqrt(variance_of_mean(one, np.arange(length))) for one in grid]
    z = (values - mean) / floored_sd
    steps = (z[length:] - floored * z[length - 1 : -1]) / np.sqrt(1.0 - floored**2)
    return floored, highest_sd / floored_sd, walked(steps, floored, np.interp(floored, grid, error))


def limits_of_floor(length: int, generator: np.random.Generator) -> Array:
    """Limits by rate where only the mean is estimated: white nights of known scatter."""
    highest = []
    for _ in range(SERIES // CHUNK):
        white = generator.standard_normal((YEAR, CHUNK))
        error = generator.standard_normal(CHUNK) / np.sqrt(length)
        known = np.zeros(CHUNK)
        highest.append(walked(white - error, known, known + 1.0 / np.sqrt(length)))
    result: Array = np.quantile(np.concatenate(highest), 1.0 - np.array(RATES) / MARGIN)
    return result


def exceedance(length: int, phi: float, generator: np.random.Generator) -> tuple[Array, Array]:
    """Share of series in each bin of estimated φ, and of those above each candidate limit."""
    above, share = np.zeros((len(NODES), len(CANDIDATES))), np.zeros(len(NODES))
    for _ in range(SERIES // CHUNK):
        white = generator.standard_normal((length + YEAR, CHUNK))
        found, _, highest = highest_sums(autoregression(white, phi), length)
        bins = np.clip(np.rint(found / 0.1).astype(int), 0, len(NODES) - 1)
        for place in range(len(NODES)):
            inside = np.sort(highest[bins == place])
            share[place] += len(inside) / SERIES
            above[place] += (len(inside) - np.searchsorted(inside, CANDIDATES, "right")) / SERIES
    return share, above


def cheapest_limits(share: Array, above: Array, rate: float) -> Array:
    """Limit at each node of estimated φ; `share` and `above` for each true φ."""
    multipliers = np.full(len(share), 1.0 / (rate * len(share)))
    prior = share.mean(axis=0)
    best_cost, best = np.inf, np.full(len(NODES), len(CANDIDATES) - 1)
    for _ in range(ROUNDS):
        cost = prior[:, None] * np.log(CANDIDATES) + np.einsum("t,tnc->nc", multipliers, above)
        chosen = np.maximum.accumulate(cost.argmin(axis=1))
        rates = above[:, np.arange(len(NODES)), chosen].sum(axis=1)
        multipliers *= np.exp(ASCENT * (rates / rate - 1.0))
        whole_cost = float(prior @ np.log(CANDIDATES[chosen]))
        if np.all(rates <= rate) and whole_cost < best_cost:
            best_cost, best = whole_cost, chosen
    result: Array = CANDIDATES[best]
    return result


def same_as_the_package() -> None:
    """Fail where the side-by-side computation here and the package differ."""
    generator = np.random.default_rng(7)
    values = 100.0 + autoregression(generator.standard_normal((60 + YEAR, 20)), 0.5)
    nights = np.arange(len(values))
    for floor in (0.0, 1.5):
        chosen = BaselineSettings(relative_floor=0.0, absolute_floor=floor)
        for series, (phi, bound, highest) in enumerate(
            zip(*highest_sums(values, 60, floor), strict=True)
        ):
            baseline = fit_baseline(nights, values[:, series], chosen)
            sums = cusum(nights, values[:, series], baseline, limit=np.inf).statistic
            found = [
                baseline.floored_phi,
                baseline.highest_sd() / baseline.floored_sd,
                np.nanmax(sums),
            ]
            np.testing.assert_allclose(found, [phi, bound, highest], rtol=1e-3)


def main() -> None:
    """Calibrate, write the tables, and `benchmarks/results/cusum_limits.md`."""
    same_as_the_package()
    limits = np.zeros((len(RATES), len(LENGTHS), len(NODES)))
    of_floor = np.zeros((len(RATES), len(LENGTHS)))
    rows = []
    for at, length in enumerate(LENGTHS):
        generator = np.random.default_rng([1, length])
        found = [exceedance(length, phi, generator) for phi in (*TRUE_PHI, *BEYOND_PHI)]
        share, above = (np.stack(part) for part in zip(*found, strict=True))
        within = len(TRUE_PHI)
        of_floor[:, at] = limits_of_floor(length, generator)
        for place, rate in enumerate(RATES):
            found_limits = cheapest_limits(share[:within], above[:within], rate / MARGIN)
            # What holds a lower rate holds this one.
            stricter = limits[place - 1, at] if place else np.inf
            limits[place, at] = np.minimum(found_limits, stricter)
            chosen = np.searchsorted(CANDIDATES, limits[place, at])
            rates = above[:, np.arange(len(NODES)), chosen].sum(axis=1)
            rows.append(
                [
                    f"{length}",
                    f"{rate:g}",
                    f"{of_floor[place, at]:.1f}",
                    *(f"{limits[place, at, node]:.1f}" for node in (0, 3, 6, 9)),
                    *(f"{rates[phi]:.4f}" for phi in (0, 3, 6, 7, 8)),
                ]
            )
    TABLE.write_text(module_text(limits, of_floor), "utf-8")
    of_limits = (f"limit at φ̂ = {phi:g}" for phi in (0.0, 0.3, 0.6, 0.9))
    of_years = (f"alarmed years, φ = {phi:g}" for phi in (0.0, 0.3, 0.6, 0.7, 0.8))
    beside = ("baseline nights", "rate a year", "limit of the floor")
    header = " | ".join((*beside, *of_limits, *of_years))
    calibrated = Part(
        "Limits",
        "The alarmed years are those without a floor, at the limits of the estimated φ.",
        header,
        rows,
    )
    write_parts(
        "cusum_limits",
        "Limits of the cumulative sum",
        f"Share of healthy years that they alarm, {SERIES} years each; sought at the rate over "
        f"{MARGIN:g}.",
        [calibrated, checked(limits, of_floor)],
    )


def checked(limits: Array, of_floor: Array) -> Part:
    """What the limits give on new years of nights that scatter about as much as their floor."""
    place, rows = RATES.index(0.02), []
    for length in (30, 60):
        at = LENGTHS.index(length)
        for phi in (0.0, 0.3, 0.6):
            generator = np.random.default_rng([2, length, int(10 * phi)])
            cells = []
            for scatter in SCATTERS:
                white = generator.standard_normal((length + YEAR, 2 * CHUNK))
                values = scatter * autoregression(white, phi)
                floored, highest_sd, highest = highest_sums(values, length, floor=1.0)
                share = np.clip(
                    (highest_sd - FLOOR_DECIDES) / (NIGHTS_DECIDE - FLOOR_DECIDES), 0, 1
                )
                estimated_limit = np.interp(floored, NODES, np.log(limits[place, at]))
                limit = (1 - share) * np.log(of_floor[place, at]) + share * estimated_limit
                cells.append(f"{np.mean(np.log(highest + 1e-300) > limit):.4f}")
            rows.append([f"{length}", f"{phi:g}", *cells])
    return Part(
        "Around the floor",
        "Share of alarmed years at a rate of 0.02, for nights whose true scatter is so many times "
        "their floor; new draws.",
        " | ".join(("baseline nights", "φ", *(f"{scatter:g}" for scatter in SCATTERS))),
        rows,
    )


def module_text(limits: Array, of_floor: Array) -> str:
    """Source of the module that holds the tables."""
    lines = [
        '"""Limits of the cumulative sum; made by `python -m benchmarks cusum_limits`."""',
        "",
        "from __future__ import annotations",
        "",
        "from typing import Final",
        "",
        "# False alarms a year of one indicator, nights of the baseline, estimated φ.",
        f"RATES: Final = {RATES}",
        f"LENGTHS: Final = {LENGTHS}",
        f"PHI: Final = {tuple(float(f'{node:.1f}') for node in NODES)}",
        "# Where the nights decide: for each rate, for each length, the limits over φ.",
        "LIMITS: Final = (",
    ]
    for of_rate in limits:
        rows = [", ".join(f"{limit:.1f}" for limit in of_length) for of_length in of_rate]
        lines += ["    (", *(f"        ({row})," for row in rows), "    ),"]
    lines += [")", "# Where the floor decides: for each rate, the limits over the length."]
    rows = [", ".join(f"{limit:.1f}" for limit in of_rate) for of_rate in of_floor]
    lines += ["FLOOR_LIMITS: Final = (", *(f"    ({row})," for row in rows), ")", ""]
    return "\n".join(lines)

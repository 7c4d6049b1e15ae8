"""How often right and wrong models are disproved, and how often the total ± holds the leakage.

Each night goes through the physics of one motor and is fitted with another: an hour at 1 Hz,
warming up under steps of load, noise with memory, and sensors that are off from night to night
(0.3 °C and 0.3 % gain, AR(1) 0.6; 0.3 bar white), of which twice that is the stated tolerance.
"Before" is the statistical ± alone, "after" the total with the night's own misfit; "free" is the
same with the scale of the rollers' curve estimated, K with the misfit of the stated model.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from benchmarks.error_kinds import lagging
from benchmarks.results_file import write_results
from benchmarks.simulated_nights import REFERENCE, held_levels, motor, true_coefficients, warming_up
from leakage import Motor, OperatingConditions, SpeedCurve, regressors
from leakage.estimation.block_statistics import factors, merge, with_free_known
from leakage.estimation.certificate import certify
from leakage.estimation.error_sources import ChannelTolerance, Tolerances
from leakage.estimation.model_verdict import (
    COEFFICIENT_FACTOR,
    LEAKAGE_FACTOR,
    Misfit,
    misfit,
    model_errors,
    model_verdict,
    structured_misfit,
)
from leakage.estimation.multi_start import Parametrisation
from leakage.estimation.sensitivities import error_budget
from leakage.estimation.slow_errors import WIDENING, short_blocks, slow_errors, whitened
from leakage.estimation.uncertainty import cluster_robust
from leakage.physics.annular_gap import AnnularGap
from leakage.physics.oil import FilmPressure, Oil
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

MODEL = motor()
FREE = MODEL.with_free_standard()
ROLLER = FREE.columns.index("cam_roller")
FACTORS = np.array([LEAKAGE_FACTOR, *[COEFFICIENT_FACTOR] * 3])
MINUTES, BLOCK = 60, 120
COURSES, NIGHTS = 24, 10
# Seeds of its own: the rules were tuned on others.
FIRST_SEED = 1800
NOISE_L_PER_MIN = 0.015
SENSOR_SAMPLES = 600
STATED = Tolerances(
    pressure_bar=ChannelTolerance(0.6),
    temperature_c=ChannelTolerance(0.6),
    flow_l_per_min=ChannelTolerance(0.0, 0.006),
)
VERDICTS = ("supported", "doubtful", "disproved", None)


@dataclass(frozen=True, kw_only=True)
class SensorFaults:
    """What sensors do wrong."""

    # temperature_lag_s, drain_lag_s: first-order lags of the temperature sensor, and of the flow
    # behind the motor.
    temperature_lag_s: float = 0.0
    drain_lag_s: float = 0.0
    dead_below_l_per_min: float = 0.0  # flow below which the meter stands still


@dataclass(frozen=True)
class Case(SensorFaults):
    """A motor with its sensors as they are, and the errors of its flow."""

    # motor, charge_bar: the truth; a charge pressure where leakage is two-sided.
    motor: Motor = MODEL
    charge_bar: float | None = None
    # temperature_by_load_k, flow_by_load_l_per_min: what the sensors read too much at 300 bar; the
    # temperature as much too low at 0 bar.
    temperature_by_load_k: float = 0.0
    flow_by_load_l_per_min: float = 0.0
    # phi, slow_s, noise: memory of the errors from second to second; time over which a slow error
    # twice as large forgets, 0: there is none; size of the errors over the usual one.
    phi: float = 0.9
    slow_s: float = 0.0
    noise: float = 1.0


def _roller(factor: float) -> Motor:
    paths = (
        replace(path, coefficients=tuple(factor * one for one in path.coefficients))
        if isinstance(path, SpeedCurve)
        else path
        for path in MODEL.paths
    )
    return replace(MODEL, paths=tuple(paths))


def _deformation(place: int, factor: float) -> Motor:
    """Another X of the first or last gap that deforms: X_o or X_s."""
    gaps = [
        path
        for path in MODEL.paths
        if isinstance(path, AnnularGap) and path.deformation_pressure_pa is not None
    ]
    chosen = gaps[place]
    changed = replace(
        chosen, deformation_pressure_pa=factor * (chosen.deformation_pressure_pa or 0)
    )
    return replace(MODEL, paths=tuple(changed if one is chosen else one for one in MODEL.paths))


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
CASES = {
    "right, φ 0.9": Case(),
    "right, φ 0.99": Case(phi=0.99),
    "right, AR of 5 minutes": Case(slow_s=300.0),
    "right, AR of 15 minutes": Case(slow_s=900.0),
    "right, AR of 60 minutes": Case(slow_s=3600.0),
    "right, noise × 4": Case(phi=0.99, noise=4.0),
    "two-sided, 15 bar": Case(charge_bar=15.0),
    "slot film": Case(replace(MODEL, film_pressure=FilmPressure("slot"))),
    "roller at 60 %": Case(_roller(0.6)),
    "VG 46 under VG 68": Case(replace(MODEL, oil=VG46)),
    "T lag 600 s": Case(temperature_lag_s=600.0),
    "T lag 60 s": Case(temperature_lag_s=60.0),
    "drain lag 20 s": Case(drain_lag_s=20.0),
    "flow offset by load, 0.06 l/min": Case(flow_by_load_l_per_min=0.06),
    "T by load, ± 1.5 K": Case(temperature_by_load_k=1.5),
    "dead band 0.3 l/min": Case(dead_below_l_per_min=0.3),
    "X_o + 20 %": Case(_deformation(0, 1.2)),
    "X_s − 20 %": Case(_deformation(-1, 0.8)),
}


@dataclass(frozen=True, slots=True)
class Night:
    """A night; shapes (2, 4): roller fixed and free, leakage and K over the true ones."""

    misfit: Misfit
    error: Array
    statistical: Array
    total: Array


def course(case: Case, seed: int) -> list[Night]:
    """Ten nights of a motor."""
    generator = np.random.default_rng(seed)
    return [night(case, one, generator) for one in wander(NIGHTS, generator)]


def wander(nights: int, generator: np.random.Generator) -> list[tuple[float, float, float]]:
    """Errors of temperature [K], gain and pressure [bar] of some nights."""
    temperature_c, gain = autoregression(generator.standard_normal((nights, 2)), 0.6).T * (
        (0.3,),
        (0.003,),
    )
    pressure_bar = 0.3 * generator.standard_normal(nights)
    return list(zip(temperature_c.tolist(), gain.tolist(), pressure_bar.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class Logged:
    """A night as logged: factors of its blocks, and its channels at 1 Hz, shape (n,) each."""

    factors: Array
    temperature_c: Array
    pressure_bar: Array
    speed_rpm: Array
    flow_l_per_min: Array

    @property
    def means(self) -> Array:
        """Mean temperature, pressure and speed of each block, shape (b, 3)."""
        channels = np.column_stack([self.temperature_c, self.pressure_bar, self.speed_rpm])
        means: Array = channels.reshape(-1, BLOCK, 3).mean(axis=1)
        return means


def logged(
    case: Case,
    wander: tuple[float, float, float],
    generator: np.random.Generator,
    top_bar: float = 300.0,
    top_rpm: float = 110.0,
    wear: Sequence[float] = (1.0, 1.0, 1.0),
) -> Logged:
    """Simulate a night, up to some pressure and speed, with factors on the gaps' K."""
    n = 60 * MINUTES
    temperature = warming_up(n, generator)
    pressure = held_levels(n, 15.0, top_bar, 60, 3.0, generator)
    speed = held_levels(n, 3.0, top_rpm, 90, 3.0, generator)
    theta = true_coefficients(case.motor) * [*wear, 1.0]
    at = OperatingConditions.from_bar(pressure, temperature, speed, case.charge_bar)
    flow = lagged(regressors(case.motor, at) @ np.append(theta, 1.0), case.drain_lag_s)
    level = case.noise * NOISE_L_PER_MIN
    noise = np.where(pressure < 100.0, 3.0, 1.0) * autoregression(
        generator.standard_normal(n), case.phi
    )
    if case.slow_s:
        noise += 2.0 * autoregression(generator.standard_normal(n), math.exp(-1.0 / case.slow_s))
    flow = (1.0 + wander[1]) * flow + level * noise
    flow += case.flow_by_load_l_per_min * pressure / 300.0
    flow[flow < case.dead_below_l_per_min] = 0.0
    read_c = lagged(temperature, case.temperature_lag_s) + wander[0]
    read_c += case.temperature_by_load_k * (pressure - 150.0) / 150.0
    read_bar = np.maximum(pressure + wander[2], 0.5)
    seen = OperatingConditions.from_bar(read_bar, read_c, speed)
    z = np.column_stack([regressors(MODEL, seen), flow])
    blocks = factors(z, np.arange(0, n + 1, BLOCK))
    return Logged(blocks, read_c, read_bar, speed, flow)


def night(case: Case, wander: tuple[float, float, float], generator: np.random.Generator) -> Night:
    """Simulate and fit a night."""
    seen = logged(case, wander, generator)
    theta = true_coefficients(case.motor)
    n = len(seen.flow_l_per_min)
    thin = np.linspace(0, n - 1, SENSOR_SAMPLES).round().astype(np.int64)
    few = OperatingConditions.from_bar(
        seen.pressure_bar[thin], seen.temperature_c[thin], seen.speed_rpm[thin]
    )
    budget = error_budget(MODEL, few, seen.flow_l_per_min[thin], STATED, [REFERENCE])
    leakage_there = OperatingConditions.from_bar(200.0, 50.0, 30.0, case.charge_bar)
    row = regressors(case.motor, leakage_there)[0]
    truth = np.append(row[:-2] @ theta[:-1] + row[-1], theta[:3])
    leakages, coefficients = budget.leakages_l_per_min(), budget.coefficients()
    assert leakages is not None
    assert coefficients is not None
    sensors = np.append(leakages, coefficients[:3])
    fixed, misfit_of_stated = _fitted(MODEL, seen.factors, seen.means, sensors)
    moved = with_free_known(seen.factors, ROLLER, 1.0)
    free, _ = _fitted(FREE, moved, seen.means, sensors, misfit_of_stated)
    parts = np.stack([fixed, free], axis=1)
    parts[0] -= truth
    return Night(misfit_of_stated, *parts / truth)


def _fitted(
    model: Motor, blocks: Array, means: Array, sensors: Array, stated: Misfit | None = None
) -> tuple[Array, Misfit]:
    """Estimate, ± of the samples and total ± as the package makes them; and the model's misfit."""
    k = len(model.columns) - 2
    fixed = np.arange(k) == k - 1
    short = short_blocks(blocks, np.arange(len(blocks)))
    slow = slow_errors(blocks, short, fixed, np.zeros(k))
    white = whitened(blocks, short, slow)
    theta = certify(merge(white), *Parametrisation.of(model).coefficient_bounds()).coefficients
    own = misfit(blocks, short, theta, fixed, means)
    distribution = cluster_robust(white, theta, ~fixed, WIDENING if slow.are_slow else 1.0)
    assert own is not None
    assert distribution is not None
    row = regressors(model, REFERENCE)[0]
    contrasts = np.vstack([np.append(row[:-2], 0.0), np.eye(k)[:3]])
    intervals = [distribution.interval(one) for one in contrasts]
    statistical = np.array([np.nan if one is None else one.half_width for one in intervals])
    taus = [structured_misfit([one]).l_per_min for one in (own, *[stated or own] * 3)]
    reach = model_errors(merge(blocks), fixed, contrasts, 1.0) * np.array(taus)
    total = np.sqrt(statistical**2 + sensors**2 + (reach * FACTORS) ** 2)
    estimate = np.append(contrasts[0] @ theta + row[-1], theta[:3])
    return np.array([estimate, statistical, total]), own


def lagged(values: Array, lag_s: float) -> Array:
    """A signal at 1 Hz behind a first-order lag; itself without one."""
    return lagging(values, 1.0, lag_s) if lag_s else values


def main() -> None:
    """Measure and write `benchmarks/results/model_verdict.md`."""
    rows = []
    for name, case in CASES.items():
        many = Parallel(n_jobs=2)(
            delayed(course)(case, seed) for seed in range(FIRST_SEED, FIRST_SEED + COURSES)
        )
        rows.append([name, *_verdicts(many), *_coverage([one for some in many for one in some])])
    header = (
        "case | τ of a night, median / 95 % | verdicts of a night, % | τ of ten, median / 95 % "
        "| verdicts of ten, % | first kind | leakage held before, % | after, % | free, % | "
        "bias, fixed → free, % | ± before, fixed → free, % | ± after, fixed → free, % | K held "
        "before, % | after, % | free, % | ± of K after, fixed → free, %"
    )
    title = (
        f"Verdicts on models: {COURSES * NIGHTS} nights a case; verdicts are shares of supported / "
        "doubtful / disproved / cannot tell; K as ring / piston / sleeve"
    )
    write_results("model_verdict", title, header, rows)


def _verdicts(courses: Sequence[Sequence[Night]]) -> list[str]:
    ones = [structured_misfit([one.misfit]) for some in courses for one in some]
    tens = [structured_misfit([one.misfit for one in some]) for some in courses]
    cells = []
    for found in (ones, tens):
        shares = 100 * np.array([one.share for one in found])
        counts = Counter(model_verdict(one) for one in found)
        cells += [
            f"{np.median(shares):.2f} / {np.quantile(shares, 0.95):.2f}",
            " / ".join(f"{100 * counts[one] / len(found):.1f}" for one in VERDICTS),
        ]
    first = Counter(one.kinds[0] if one.kinds else "none" for one in tens)
    kind, n = first.most_common(1)[0]
    return [*cells, f"{kind} ({100 * n / len(tens):.0f} %)"]


def _coverage(nights: Sequence[Night]) -> list[str]:
    error, statistical, total = (
        np.array([getattr(one, name) for one in nights])
        for name in ("error", "statistical", "total")
    )
    before, after = (100 * np.mean(np.abs(error) <= half, 0) for half in (statistical, total))
    bias = 100 * np.mean(error[:, :, 0], axis=0)
    widths = 100 * np.median([statistical, total], axis=1)

    def k(held: Array) -> str:
        return " / ".join(f"{one:.0f}" for one in held[1:])

    return [
        f"{before[0, 0]:.0f}",
        f"{after[0, 0]:.0f}",
        f"{after[1, 0]:.0f}",
        " → ".join(f"{one:+.1f}" for one in bias),
        " → ".join(f"{one:.2f}" for one in widths[0, :, 0]),
        " → ".join(f"{one:.2f}" for one in widths[1, :, 0]),
        k(before[0]),
        k(after[0]),
        k(after[1]),
        " → ".join(k(one) for one in widths[1]),
    ]

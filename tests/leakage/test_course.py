"""Slopes against least squares written out, times to a limit against draws, drifts of zeros."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import t as student_t

from leakage.course import (
    KAPPAS,
    POWERS,
    Slope,
    TimeToLimit,
    estimated_phi,
    fit_slope,
    time_to_limit,
    whiten,
    zero_course,
)
from tests.leakage.made_samples import autoregression

Array = NDArray[np.float64]


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_it_equals_generalised_least_squares_with_the_whole_covariance(missing: float) -> None:
    """Aitken's estimate, with the covariance of the errors inverted whole."""
    generator = np.random.default_rng(1)
    nights = np.flatnonzero(generator.random(150) >= missing)
    values = 3.0 + 0.02 * nights + autoregression(0.5, 150, generator)[nights]
    found = fit_slope(nights, values, nights.astype(float))
    phi = estimated_phi(values - np.polyval(np.polyfit(nights, values, 1), nights), nights)
    assert phi > 0.1
    inverse = np.linalg.inv(phi ** np.abs(np.subtract.outer(nights, nights)))
    design = np.column_stack([np.ones(len(nights)), nights - nights.mean()])
    bread = np.linalg.inv(design.T @ inverse @ design)
    line = bread @ design.T @ inverse @ values
    error, freedom = values - design @ line, len(nights) - 3
    variance = bread[1, 1] * (error @ inverse @ error) / freedom
    half = student_t.ppf(0.975, freedom) * np.sqrt(variance)
    assert found.slope == pytest.approx(line[1], rel=1e-9)
    assert [found.lower, found.upper] == pytest.approx([line[1] - half, line[1] + half])


@pytest.mark.parametrize(
    ("n", "missing", "has_line", "is_provisional"),
    [(0, 0, 0, 0), (19, 0, 0, 0), (20, 0, 1, 1), (59, 0, 1, 1), (60, 0, 1, 0), (79, 20, 1, 1)],
)
def test_nights_that_count_decide_on_a_slope(
    n: int, missing: int, has_line: bool, is_provisional: bool
) -> None:
    values = np.random.default_rng(7).standard_normal(n)
    values[5 : 5 + missing] = np.nan
    found = fit_slope(np.arange(n), values, np.arange(n) / 365.0)
    assert (found.n, found.slope is not None) == (n - missing, has_line)
    assert found.is_provisional == is_provisional


def test_series_without_scatter_or_span_have_no_interval() -> None:
    nights = np.arange(30)
    for values, slope in ((np.full(30, 1.37), 0.0), (2.0 + 0.5 * nights, 0.5)):
        found = fit_slope(nights, values, nights.astype(float))
        assert found == Slope(30, pytest.approx(slope, abs=1e-12))
    # The mean of so many times 0.1 is not 0.1 to the last bit.
    assert fit_slope(nights, np.arange(30.0), np.full(30, 0.1)) == Slope(30)


@pytest.mark.parametrize("phi", [0.0, 0.4, 0.95])
def test_whitening_is_that_of_the_covariance(phi: float) -> None:
    nights = np.array([0, 1, 2, 5, 6, 20, 21, 23])
    transform = whiten(np.eye(8), phi, nights)
    whole = phi ** np.abs(np.subtract.outer(nights, nights))
    assert transform @ whole @ transform.T == pytest.approx(np.eye(8))


@pytest.mark.parametrize(
    ("n", "phi", "apart", "within"),
    [(30, 0.0, 1, 0.1), (30, 0.4, 1, 0.04), (60, 0.6, 1, 0.04), (600, 0.6, 2, 0.03)],
)
def test_phi_is_found_without_the_bias_of_a_fitted_line(
    n: int, phi: float, apart: int, within: float
) -> None:
    """Uncorrected it falls short by (2 + 4 φ) / n, 0.12 for n = 30, φ = 0.4; clipped at 0."""
    generator, nights = np.random.default_rng(n), apart * np.arange(n)
    found = []
    for _ in range(12_000 // n):
        values = autoregression(phi, apart * n, generator)[::apart]
        residual = values - np.polyval(np.polyfit(nights, values, 1), nights)
        found.append(estimated_phi(residual, nights))
    assert np.mean(found) == pytest.approx(phi, abs=within)


def test_series_that_say_nothing_of_their_memory_have_none_and_no_memory_is_whole() -> None:
    triangular = np.cumsum(np.arange(1, 30))  # every distance between nights but once
    for values, nights in (
        (np.zeros(50), np.arange(50)),
        (np.ones(5), np.arange(5)),
        (np.empty(0), np.empty(0, dtype=np.int64)),
        (np.random.default_rng(1).normal(size=29), triangular),
    ):
        assert estimated_phi(values, nights) == 0.0
    slow = np.cumsum(np.random.default_rng(5).standard_normal(400))
    assert 0.9 < estimated_phi(slow - slow.mean(), np.arange(400)) <= 0.95


FAR = 5000.0
SHAPES: list[Callable[[Array], Array]] = [
    *(lambda u, k=k: np.expm1(k * u) / np.expm1(k) for k in KAPPAS),
    *(lambda u, p=p: u**p for p in POWERS),
]


def found_of(values: Array, limit: float, horizon: float = FAR) -> TimeToLimit:
    """Of nights one after the other, a position each."""
    nights = np.arange(len(values))
    return time_to_limit(nights, nights.astype(np.float64), values, limit, horizon)


def crossings_by_draws(y: Array, limit: float, generator: np.random.Generator) -> Array:
    """Crossings in units of what was seen, of draws of (a, b) of every shape; white errors."""
    n = len(y)
    u, ahead = np.linspace(0.0, 1.0, n), np.linspace(1.0, 9.0, 4001)
    kinds = np.array(
        [0 if abs(k) < 0.3 else np.sign(k) for k in KAPPAS] + [np.sign(p - 1) for p in POWERS]
    )
    log_weights, crossings = [], []
    for shape, kind in zip(SHAPES, kinds, strict=True):
        x = np.column_stack([np.ones(n), shape(u)])
        gram = x.T @ x
        best = np.linalg.solve(gram, x.T @ y)
        squares = float(np.sum((y - x @ best) ** 2))
        prior = 1.0 / 3.0 / np.sum(kinds == kind)
        tempered = 0.25 * (n - 3) / 2.0 * np.log(squares)
        log_weights.append(np.log(prior) - tempered - 0.5 * np.log(np.linalg.det(gram)))
        root = np.linalg.cholesky(squares / (n - 3) * np.linalg.inv(gram))
        a, b = best[:, None] + root @ generator.standard_normal((2, 1000)) / np.sqrt(
            generator.chisquare(n - 3, 1000) / (n - 3)
        )
        course = a[:, None] + b[:, None] * shape(ahead)
        reached = course[:, -1] >= limit
        crossings.append(np.where(reached, ahead[np.argmax(course >= limit, axis=1)], np.inf))
    weights = np.exp(np.array(log_weights) - max(log_weights))
    drawn = generator.choice(len(SHAPES), 40_000, p=weights / weights.sum())
    return np.array([crossings[shape][generator.integers(1000)] for shape in drawn]) - 1.0


def test_the_set_and_the_middle_are_those_of_draws_from_the_mixture() -> None:
    generator = np.random.default_rng(4)
    # White by construction, so that the draws need no model of the errors; the gap of this course
    # grows evenly, so the gamma process adds next to nothing to the set.
    values = (1.0 + 0.08 * np.linspace(0.0, 1.0, 120)) ** 3
    values += 0.004 * np.tile([1.0, -1.0, -1.0, 1.0], 30)
    found = found_of(values, 1.35)
    drawn = 119.0 * np.quantile(crossings_by_draws(values, 1.35, generator), [0.05, 0.5, 0.95])
    assert found.status == "finite"
    assert found.time == pytest.approx(drawn[1], rel=0.05)
    assert drawn[0] * 0.7 <= found.lower <= drawn[0] * 1.05
    assert drawn[2] * 0.95 <= found.upper <= drawn[2] * 1.3


def with_noise(course: Array, generator: np.random.Generator, phi: float = 0.3) -> Array:
    return course * (1.0 + 0.015 * autoregression(phi, len(course), generator))


COURSES = {
    "linear": lambda t: 0.3 * t,
    "gap": lambda t: (1.0 + 0.0914 * t) ** 3 - 1.0,
    "accelerating": lambda t: 0.3 * np.expm1(3.0 * t) / np.expm1(3.0),
    "running_in": lambda t: 0.3 * (0.5 * t - 0.5 * np.expm1(-5.0 * t)) / (1.0 - 0.5 * np.exp(-5.0)),
}


@pytest.mark.parametrize("course", COURSES)
def test_sets_hold_the_truth_whatever_the_course(course: str) -> None:
    generator = np.random.default_rng(1)
    held = trends = 0
    for _ in range(80):
        life = 120.0 * (1.0 + generator.uniform(0.1, 2.0))
        values = 1.0 + COURSES[course](np.arange(120) / life)
        found = found_of(with_noise(values, generator), 1.3)
        trends += found.status != "no_trend"
        upper = np.inf if found.upper is None else found.upper
        held += found.status != "no_trend" and (found.lower or 0.0) <= life - 119.0 <= upper
    assert trends >= 72
    # 90 % of 80, less two and a half standard deviations.
    assert held >= trends - 15


def rising(slope: float = 0.2, noise: float = 0.005) -> Array:
    """A hundred nights from 1 on."""
    scatter = np.random.default_rng(3).standard_normal(100)
    return np.linspace(1.0, 1.0 + slope, 100) + noise * scatter


def test_a_range_ends_no_further_ahead_than_the_nights_reach_back() -> None:
    near, far = (found_of(rising(noise=0.003), limit) for limit in (1.25, 1.6))
    assert near.status == "finite"
    assert 0.0 < near.lower < near.time < near.upper <= 99.0
    assert (far.status, far.upper) == ("not_before", None)
    assert 0.0 < far.lower < 198.0


@pytest.mark.parametrize(
    ("values", "limit", "expected"),
    [
        (rising(), 1.15, TimeToLimit("already_crossed", lower=0.0, upper=0.0)),
        (rising(-0.2), 1.3, TimeToLimit("no_trend")),
        (rising(), 9.0, TimeToLimit("beyond_horizon", lower=100.0)),
        (rising()[:19], 1.3, TimeToLimit("insufficient")),
        (np.where(np.arange(100) < 81, np.nan, rising()), 1.3, TimeToLimit("insufficient")),
    ],
)
def test_the_other_statuses(values: Array, limit: float, expected: TimeToLimit) -> None:
    assert found_of(values, limit, horizon=100.0) == expected


def test_twenty_nights_that_go_on_are_enough() -> None:
    assert found_of(rising()[:20], 1.3).status != "insufficient"
    stands = time_to_limit(np.arange(100), np.full(100, 8.0), rising(), 1.3, FAR)
    assert stands.status == "insufficient"


def halts(drift: float, seed: int, n: int = 60) -> Array:
    generator = np.random.default_rng(seed)
    return 0.01 + 0.005 * generator.standard_normal(n) + drift * np.linspace(0, 1, n)


@pytest.mark.parametrize(("drift", "is_named"), [(0.08, True), (-0.08, True), (0.02, False)])
def test_a_drift_beyond_the_tolerance_is_named(drift: float, is_named: bool) -> None:
    found = zero_course(halts(drift, 2), np.full(60, 0.002), tolerance=0.02)
    assert found.drifts[-1] == is_named
    # Halves of a straight drift differ by half of it.
    assert found.change_lower[-1] < drift / 2 < found.change_upper[-1]


def test_steady_sensors_are_rarely_accused_without_a_tolerance() -> None:
    errors = np.full(40, 0.001)
    courses = (zero_course(halts(0.0, seed, 40), errors, 0.0) for seed in range(300))
    assert 3 <= sum(bool(course.drifts[-1]) for course in courses) <= 27


def test_errors_of_halts_count_where_the_halts_agree_by_chance() -> None:
    found = zero_course(np.zeros(20), np.full(20, 0.03), 0.0)
    assert found.change_upper[-1] == pytest.approx(2.1009 * 0.03 * np.sqrt(2 / 10), rel=1e-4)


@pytest.mark.parametrize(("n", "is_known"), [(0, False), (1, False), (9, False), (20, True)])
def test_few_halts_say_nothing_and_one_without_a_zero_does_not_count(
    n: int, is_known: bool
) -> None:
    zeros = np.where(np.arange(n) == 4, np.nan, 0.01)
    found = zero_course(zeros, np.full(n, 0.001), 0.02)
    assert found.zero == pytest.approx([np.nan] * min(n, 10) + [0.01] * max(n - 10, 0), nan_ok=True)
    assert not found.drifts.any()
    assert bool(np.isfinite(found.zero[-1:]).all() and n) == is_known

"""Time to a limit against draws from its definition; drift of sensors' zeros."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.course.sensor_zero import zero_course
from leakage.course.time_to_limit import KAPPAS, POWERS, TimeToLimit, time_to_limit
from tests.leakage.estimation.made_errors import autoregression

Array = NDArray[np.float64]

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
    held = told = 0
    for _ in range(80):
        life = 120.0 * (1.0 + generator.uniform(0.1, 2.0))
        values = 1.0 + COURSES[course](np.arange(120) / life)
        found = found_of(with_noise(values, generator), 1.3)
        told += found.status != "no_trend"
        upper = np.inf if found.upper is None else found.upper
        held += found.status != "no_trend" and (found.lower or 0.0) <= life - 119.0 <= upper
    assert told >= 72
    # 90 % of 80, less two and a half standard deviations.
    assert held >= told - 15


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


def halts(drift: float, seed: int, n: int = 60) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return 0.01 + 0.005 * generator.standard_normal(n) + drift * np.linspace(0, 1, n)


def test_a_drift_beyond_the_tolerance_is_named_and_a_smaller_one_is_not() -> None:
    errors = np.full(60, 0.002)
    found = zero_course(halts(0.08, 2), errors, tolerance=0.02)
    assert found.drifts[-1]
    # Halves of a straight drift differ by half of it.
    assert found.change_lower[-1] < 0.04 < found.change_upper[-1]
    assert not zero_course(halts(0.02, 2), errors, tolerance=0.02).drifts[-1]
    down = zero_course(halts(-0.08, 2), errors, tolerance=0.02)
    assert down.drifts[-1]
    assert down.change[-1] < 0


def test_steady_sensors_are_rarely_accused_without_a_tolerance() -> None:
    errors = np.full(40, 0.001)
    told = sum(
        bool(zero_course(halts(0.0, seed, 40), errors, 0.0).drifts[-1]) for seed in range(300)
    )
    assert 3 <= told <= 27


def test_errors_of_halts_count_where_the_halts_agree_by_chance() -> None:
    found = zero_course(np.zeros(20), np.full(20, 0.03), 0.0)
    assert found.change_upper[-1] == pytest.approx(2.1009 * 0.03 * np.sqrt(2 / 10), rel=1e-4)


def test_halts_without_a_zero_do_not_count() -> None:
    zeros = np.where(np.arange(20) == 4, np.nan, 0.01)
    found = zero_course(zeros, np.full(20, 0.001), 0.02)
    assert found.zero[-1] == pytest.approx(0.01)
    assert not found.drifts[-1]


def test_few_halts_say_nothing() -> None:
    for n in (0, 1, 9):
        found = zero_course(np.zeros(n), np.full(n, 0.01), 0.02)
        assert len(found.zero) == n
        assert np.isnan(found.zero).all()

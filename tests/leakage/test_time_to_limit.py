"""Time to a limit: Fieller's set found by search, its statuses, and how often it holds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t

from leakage.slope import Slope, fit_slope
from leakage.time_to_limit import time_to_limit
from tests.leakage.made_nights import autoregression


def line(
    level: float, slope: float, sd_level: float, sd_slope: float, correlation: float = 0.0
) -> Slope:
    """A line whose pivot is night 100."""
    mixed = correlation * sd_level * sd_slope
    return Slope(
        status="ok",
        n=100,
        theil_sen=slope,
        slope=slope,
        lower=slope - 2 * sd_slope,
        upper=slope + 2 * sd_slope,
        p_value=0.5,
        level=level,
        pivot=100.0,
        covariance=np.array([[sd_level**2, mixed], [mixed, sd_slope**2]]),
        phi=0.0,
        residual_sd=1.0,
        freedom=97,
    )


def set_by_search(of: Slope, limit: float, now: float, far: float = 1e5) -> np.ndarray:
    """Times at which the line is not told from the limit, by their definition."""
    times = np.concatenate([np.linspace(0, 2000, 200_001), np.linspace(2000, far, 1000)])
    at = np.stack([np.ones_like(times), now + times - of.pivot])
    value = of.level * at[0] + of.slope * at[1]
    variance = np.einsum("it,ij,jt->t", at, of.covariance, at)
    t = student_t.ppf(0.975, of.freedom)
    return times[(value - limit) ** 2 <= t**2 * variance]


@pytest.mark.parametrize("correlation", [0.0, 0.6, -0.8])
def test_its_ends_are_those_of_the_set(correlation: float) -> None:
    of = line(1.1, 0.001, 0.01, 0.0002, correlation)
    found = time_to_limit(of, 1.4, 150.0, 1825.0)
    times = set_by_search(of, 1.4, 150.0)
    assert found.status == "finite"
    assert found.time == pytest.approx((1.4 - 1.1 - 0.05) / 0.001)
    assert [found.lower, found.upper] == pytest.approx([times[0], times[-1]], abs=0.02)


@pytest.mark.parametrize("correlation", [0.0, 0.6, -0.8])
def test_a_rise_that_is_not_certain_has_an_earliest_time_and_no_latest(correlation: float) -> None:
    of = line(1.1, 0.001, 0.01, 0.0006, correlation)
    found = time_to_limit(of, 1.4, 150.0, 1825.0)
    times = set_by_search(of, 1.4, 150.0)
    assert (found.status, found.time, found.upper) == ("unbounded", None, None)
    assert found.lower == pytest.approx(times[0], abs=0.02)
    assert times[-1] == pytest.approx(1e5)


def test_the_other_statuses() -> None:
    crossed = time_to_limit(line(1.5, 0.001, 0.01, 0.0001), 1.4, 100.0, 1825.0)
    assert (crossed.status, crossed.lower, crossed.upper) == ("already_crossed", 0.0, 0.0)
    # At 1.39 at the pivot, and above the limit by now.
    assert time_to_limit(line(1.39, 0.001, 0.01, 1e-4), 1.4, 130.0, 1825.0).status == (
        "already_crossed"
    )
    falling = time_to_limit(line(1.1, -0.001, 0.01, 0.0001), 1.4, 100.0, 1825.0)
    assert (falling.status, falling.lower, falling.upper) == ("no_trend", None, None)
    far = time_to_limit(line(1.1, 0.0001, 0.001, 0.00001), 1.4, 100.0, 1825.0)
    assert (far.status, far.time) == ("beyond_horizon", None)
    assert far.lower < 3000 < far.upper
    # Not told from the limit even now, and no certain rise: every time is possible.
    nothing = time_to_limit(line(1.39, 0.0001, 0.05, 0.01), 1.4, 100.0, 1825.0)
    assert (nothing.status, nothing.lower) == ("no_trend", None)


def test_a_motor_close_to_its_limit_may_be_there_now() -> None:
    found = time_to_limit(line(1.395, 0.001, 0.01, 0.0001), 1.4, 100.0, 1825.0)
    assert (found.status, found.lower) == ("finite", 0.0)
    assert found.upper > found.time > 0.0


def test_without_a_line_there_is_no_time() -> None:
    few = fit_slope(np.arange(5), np.arange(5.0))
    assert time_to_limit(few, 9.0, 4.0, 1825.0).status == "no_trend"


def test_a_line_without_scatter_has_its_time_and_no_more() -> None:
    exact = fit_slope(np.arange(30), 1.0 + 0.01 * np.arange(30))
    found = time_to_limit(exact, 1.5, 29.0, 1825.0)
    assert found.status == "finite"
    assert [found.lower, found.time, found.upper] == pytest.approx([21.0] * 3)
    constant = fit_slope(np.arange(30), np.ones(30))
    assert time_to_limit(constant, 1.5, 29.0, 1825.0).status in {"no_trend", "beyond_horizon"}


@pytest.mark.parametrize("per_night", [0.02, 0.005])
def test_the_set_holds_the_true_time_certain_rise_or_not(per_night: float) -> None:
    generator = np.random.default_rng(1)
    nights = np.arange(120)
    truth = 6.0 / per_night - 119.0
    held = unbounded = 0
    for _ in range(400):
        of = fit_slope(nights, per_night * nights + autoregression(120, 0.3, generator))
        found = time_to_limit(of, 6.0, 119.0, 5000.0)
        upper = np.inf if found.upper is None else found.upper
        held += (found.lower or 0.0) <= truth <= upper
        unbounded += found.status == "unbounded"
    assert 0.91 <= held / 400 <= 0.985
    assert (unbounded > 100) == (per_night == 0.005)

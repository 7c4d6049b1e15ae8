"""Slopes and the memory of nights: against SciPy, and against least squares written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t

from leakage.course.slope import (
    correlation_to_previous,
    estimated_phi,
    fit_slope,
    variance_of_mean,
    whitened,
)
from tests.leakage.estimation.made_errors import autoregression


def generalised_least_squares(
    nights: np.ndarray, values: np.ndarray, phi: float
) -> tuple[np.ndarray, np.ndarray]:
    """Aitken's estimate and covariance, with the covariance of the errors inverted whole."""
    inverse = np.linalg.inv(phi ** np.abs(np.subtract.outer(nights, nights)))
    design = np.column_stack([np.ones(len(nights)), nights - nights.mean()])
    bread = np.linalg.inv(design.T @ inverse @ design)
    line = bread @ design.T @ inverse @ values
    error = values - design @ line
    return line, bread * (error @ inverse @ error) / (len(nights) - 3)


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_it_equals_generalised_least_squares_with_the_whole_covariance(missing: float) -> None:
    generator = np.random.default_rng(1)
    nights = np.flatnonzero(generator.random(150) >= missing)
    values = 3.0 + 0.02 * nights + autoregression(0.5, 150, generator)[nights]
    found = fit_slope(nights, values)
    line, covariance = generalised_least_squares(nights, values, found.phi)
    assert found.phi > 0.1
    assert found.slope == pytest.approx(line[1], rel=1e-9)
    half = student_t.ppf(0.975, len(nights) - 3) * np.sqrt(covariance[1, 1])
    assert [found.lower, found.upper] == pytest.approx([line[1] - half, line[1] + half])


@pytest.mark.parametrize(
    ("n", "missing", "status"),
    [
        (0, 0, "too_few_nights"),
        (19, 0, "too_few_nights"),
        (20, 0, "provisional"),
        (59, 0, "provisional"),
        (60, 0, "ok"),
        (79, 20, "provisional"),
        (80, 20, "ok"),
    ],
)
def test_status_goes_by_the_nights_that_count(n: int, missing: int, status: str) -> None:
    values = np.random.default_rng(7).standard_normal(n)
    values[5 : 5 + missing] = np.nan
    found = fit_slope(np.arange(n), values)
    assert (found.status, found.n) == (status, n - missing)
    assert (found.slope is None) == (status == "too_few_nights")


def test_series_without_scatter_or_span_are_told_so() -> None:
    nights = np.arange(30)
    constant = fit_slope(nights, np.full(30, 1.37))
    assert (constant.status, constant.lower, constant.upper) == ("no_scatter", None, None)
    assert constant.slope == pytest.approx(0.0, abs=1e-12)
    line = fit_slope(nights, 2.0 + 0.5 * nights)
    assert (line.status, line.slope) == ("no_scatter", pytest.approx(0.5))
    # The mean of so many times 0.1 is not 0.1 to the last bit.
    still = fit_slope(nights, np.arange(30.0), position=np.full(30, 0.1))
    assert (still.status, still.slope) == ("no_span", None)


UNEVEN = np.array([0, 1, 2, 5, 6, 20, 21, 23])


@pytest.mark.parametrize("phi", [0.0, 0.4, 0.95])
def test_whitening_and_the_variance_of_a_mean_are_those_of_the_covariance(phi: float) -> None:
    whole = phi ** np.abs(np.subtract.outer(UNEVEN, UNEVEN))
    transform = whitened(np.eye(len(UNEVEN)), correlation_to_previous(phi, UNEVEN))
    assert transform @ whole @ transform.T == pytest.approx(np.eye(len(UNEVEN)))
    assert variance_of_mean(phi, UNEVEN) == pytest.approx(whole.mean())


@pytest.mark.parametrize(("n", "phi"), [(30, 0.0), (30, 0.4), (60, 0.6), (200, 0.8)])
def test_phi_is_found_without_the_bias_of_a_fitted_line(n: int, phi: float) -> None:
    """The uncorrected estimate falls short by (2 + 4 φ) / n: 0.12 for n = 30, φ = 0.4."""
    generator = np.random.default_rng(n)
    nights = np.arange(n)
    found = []
    for _ in range(400):
        values = autoregression(phi, n, generator)
        residual = values - np.polyval(np.polyfit(nights, values, 1), nights)
        found.append(estimated_phi(residual, nights))
    # Clipped at 0, which lifts the mean of small ones.
    assert np.mean(found) == pytest.approx(phi, abs=0.04 if phi else 0.1)


def test_phi_is_one_nights_where_the_motor_runs_every_second() -> None:
    generator = np.random.default_rng(3)
    nights = 2 * np.arange(600)
    found = [estimated_phi(autoregression(0.6, 1200, generator)[::2], nights) for _ in range(20)]
    assert np.mean(found) == pytest.approx(0.6, abs=0.03)


def test_series_that_say_nothing_of_their_memory_have_none() -> None:
    assert estimated_phi(np.zeros(50), np.arange(50)) == 0.0
    assert estimated_phi(np.ones(5), np.arange(5)) == 0.0
    assert estimated_phi(np.empty(0), np.empty(0, dtype=np.int64)) == 0.0
    # Every distance between nights but once: no pairs to compare.
    triangular = np.cumsum(np.arange(1, 30))
    assert estimated_phi(np.random.default_rng(1).normal(size=29), triangular) == 0.0


def test_phi_stays_below_one() -> None:
    slow = np.cumsum(np.random.default_rng(5).standard_normal(400))
    assert 0.9 < estimated_phi(slow - slow.mean(), np.arange(400)) <= 0.95

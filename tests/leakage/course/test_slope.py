"""Slopes: against SciPy and least squares written out, and by how often intervals hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t
from scipy.stats import theilslopes

from leakage.course.slope import fit_slope, theil_sen
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
    t = abs(line[1]) / np.sqrt(covariance[1, 1])
    assert found.p_value == pytest.approx(2 * student_t.sf(t, len(nights) - 3))


@pytest.mark.parametrize("n", [2, 20, 150, 200])
def test_theil_sens_slope_is_scipys_up_to_two_hundred_points(n: int) -> None:
    generator = np.random.default_rng(n)
    x = np.sort(generator.uniform(0, 50, n))
    y = generator.standard_normal(n)
    assert theil_sen(x, y) == pytest.approx(theilslopes(y, x)[0], rel=1e-12)


def test_theil_sens_slope_of_ten_years_is_as_good_as_that_of_all_pairs() -> None:
    """All pairs are 2.3 % less efficient than least squares under normal errors (Sen 1968)."""
    generator = np.random.default_rng(4)
    x = np.arange(3650.0)
    centred = x - x.mean()
    found, best = [], []
    for _ in range(200):
        y = generator.standard_normal(3650)
        found.append(theil_sen(x, y))
        best.append(centred @ y / (centred @ centred))
    assert np.std(found) / np.std(best) < 1.2


@pytest.mark.parametrize(
    ("n", "phi", "least"), [(60, 0.0, 0.93), (60, 0.6, 0.90), (120, 0.3, 0.92), (120, 0.6, 0.91)]
)
def test_intervals_hold_the_truth(n: int, phi: float, least: float) -> None:
    generator = np.random.default_rng(n + int(10 * phi))
    nights = np.arange(n)
    held = 0
    for _ in range(500):
        found = fit_slope(nights, 0.01 * nights + autoregression(phi, n, generator))
        held += found.lower <= 0.01 <= found.upper
    assert least <= held / 500 <= 0.985


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
    assert (constant.status, constant.p_value, constant.lower) == ("no_scatter", None, None)
    assert constant.slope == pytest.approx(0.0, abs=1e-12)
    line = fit_slope(nights, 2.0 + 0.5 * nights)
    assert (line.status, line.theil_sen) == ("no_scatter", 0.5)
    # The mean of so many times 0.1 is not 0.1 to the last bit.
    still = fit_slope(nights, np.arange(30.0), position=np.full(30, 0.1))
    assert (still.status, still.slope) == ("no_span", None)


def test_weeks_without_nights_let_the_memory_fade() -> None:
    """Two clusters of nights half a year apart: the slope rests on their two levels."""
    generator = np.random.default_rng(8)
    nights = np.concatenate([np.arange(30), np.arange(200, 230)])
    values = 0.5 * (nights >= 200) + 0.1 * autoregression(0.3, 60, generator)
    found = fit_slope(nights, values)
    assert found.lower < 0.5 / 200 < found.upper
    assert found.p_value < 1e-6

"""The cumulative sum: run lengths from an integral equation, and its recursion written out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from leakage.course.baseline import BaselineSettings, fit_baseline
from leakage.course.cusum import BASELINE_ERRORS, REFERENCE_VALUE, WINSORISED_AT, cusum, cusum_limit
from leakage.course.cusum_limits import FLOOR_LIMITS, LENGTHS, LIMITS, PHI, RATES
from leakage.errors import ParameterError, ShapeError
from tests.leakage.made_nights import autoregression, known_baseline


def run_length(k: float, h: float, shift: float = 0.0, points: int = 80) -> float:
    """Mean run length from 0 of Page's sum on normal values, by its integral equation.

    L(s) = 1 + L(0) Φ(k − s − δ) + ∫₀ʰ L(x) φ(x + k − s − δ) dx, at the nodes of Gauss and Legendre.
    """
    nodes, weights = np.polynomial.legendre.leggauss(points)
    x, w = h / 2 * (nodes + 1), h / 2 * weights
    at = np.concatenate([[0.0], x])
    kernel = norm.pdf(x[None, :] + k - shift - at[:, None]) * w
    matrix = np.column_stack([norm.cdf(k - shift - at), kernel])
    return float(np.linalg.solve(np.eye(points + 1) - matrix, np.ones(points + 1))[0])


def markov_chain_run_length(k: float, h: float, states: int = 600) -> float:
    """The same by a Markov chain of many states (Brook and Evans 1972)."""
    width = 2 * h / (2 * states - 1)
    places = width * np.arange(states)
    upper = norm.cdf(places[None, :] + width / 2 + k - places[:, None])
    transition = np.diff(upper, axis=1, prepend=0.0)
    return float(np.linalg.solve(np.eye(states) - transition, np.ones(states))[0])


def test_published_run_lengths() -> None:
    """Two-sided ARL 168 and 465 for k = 0.5, h = 4 and 5; 10.4 for a shift of one σ, h = 5.

    Montgomery, Introduction to Statistical Quality Control, 6th ed., table 9.3; a one-sided sum
    runs twice as long in control.
    """
    assert run_length(0.5, 4.0) == pytest.approx(2 * 168, rel=0.005)
    assert run_length(0.5, 5.0) == pytest.approx(2 * 465, rel=0.005)
    assert run_length(0.5, 5.0, shift=1.0) == pytest.approx(10.4, rel=0.005)


@pytest.mark.parametrize(("k", "h"), [(0.25, 11.114), (0.5, 6.356)])
def test_the_known_limits_of_ten_years(k: float, h: float) -> None:
    assert run_length(k, h) == pytest.approx(3650, rel=0.002)
    assert markov_chain_run_length(k, h) == pytest.approx(3650, rel=0.005)


@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_run_lengths_of_the_package_with_a_known_baseline(shift: float) -> None:
    h = 4.0
    expected = run_length(REFERENCE_VALUE, h, shift)
    generator = np.random.default_rng(1)
    nights = np.arange(-1, int(12 * expected))
    found = []
    for _ in range(400):
        values = shift + generator.standard_normal(len(nights))
        told = cusum(nights, values, known_baseline(), h).is_on
        found.append(told.argmax() if told.any() else len(nights))
    assert np.mean(found) == pytest.approx(expected, rel=0.15)


def recursion(nights: np.ndarray, values: np.ndarray, baseline, h: float) -> np.ndarray:
    """S as the equations have it, night by night, until it exceeds h."""
    sums, before, last = [], None, None
    s = 0.0
    for night, value in zip(nights, values, strict=True):
        if not np.isfinite(value):
            sums.append(np.nan)
            continue
        z = (value - baseline.mean) / baseline.floored_sd
        if before is None:
            sums.append(np.nan)
        else:
            rho = baseline.floored_phi ** (night - last)
            w = np.clip((z - rho * before) / np.sqrt(1 - rho**2), -WINSORISED_AT, WINSORISED_AT)
            gain = np.sqrt((1 - rho) / (1 + rho))
            error = baseline.floored_mean_error / baseline.floored_sd
            s = max(0.0, s + w - REFERENCE_VALUE - BASELINE_ERRORS * gain * error)
            sums.append(s)
            if s > h:
                break
        before, last = z, night
    return np.array(sums)


@pytest.mark.parametrize("phi", [0.0, 0.4])
def test_it_is_the_recursion_over_uneven_nights(phi: float) -> None:
    generator = np.random.default_rng(2)
    nights = np.concatenate([[-1], np.flatnonzero(generator.random(300) > 0.3)])
    values = 5.0 + 2.0 * generator.standard_t(3, len(nights))
    values[5:40:7] = np.nan
    baseline = known_baseline(mean=5.0, sd=2.0, phi=phi, mean_error=0.3)
    expected = recursion(nights, values, baseline, np.inf)
    found = cusum(nights, values, baseline, np.inf)
    assert found.statistic == pytest.approx(expected, nan_ok=True)
    assert not found.is_on.any()
    h = float(np.nanmax(expected)) * 0.6
    told = cusum(nights, values, baseline, h)
    until = len(recursion(nights, values, baseline, h))
    assert int(told.is_on.argmax()) == until - 1
    assert told.statistic[until - 1] == 2 * h


def test_the_baselines_error_is_carried_at_one_over_the_root_of_its_nights() -> None:
    """k + c/√n for any φ, when the baseline is even and long."""
    generator = np.random.default_rng(3)
    for phi in (0.0, 0.3, 0.6):
        values = autoregression(400, phi, generator)
        baseline = fit_baseline(
            np.arange(400), values, BaselineSettings(nights=400, relative_floor=0.0)
        )
        rho = baseline.floored_phi
        carried = np.sqrt((1 - rho) / (1 + rho)) * baseline.floored_mean_error / baseline.floored_sd
        assert carried == pytest.approx(1 / np.sqrt(400), rel=0.02)


def test_a_lasting_change_stays_told_and_one_that_is_undone_is_taken_back() -> None:
    generator = np.random.default_rng(4)
    nights = np.arange(-1, 2000)
    values = generator.standard_normal(2001) + 3.0 * ((nights >= 500) & (nights < 1500))
    found = cusum(nights, values, known_baseline(), 15.0)
    switched = nights[1:][np.diff(found.is_on.astype(int)) != 0]
    assert len(switched) == 2
    assert 500 <= switched[0] <= 512
    # Undone at k a night: 15 / 0.25 nights.
    assert 1500 <= switched[1] <= 1500 + 2 * 15 / REFERENCE_VALUE
    assert found.onset[found.is_on].min() == found.onset[found.is_on].max()
    assert abs(nights[found.onset[1000]] - 500) < 10
    assert (found.onset[~found.is_on] == -1).all()


def test_nights_without_a_value_hold_and_add_nothing() -> None:
    nights = np.arange(-1, 100)
    values = np.full(101, 1.0)
    values[20:60] = np.nan
    found = cusum(nights, values, known_baseline(), 10.0)
    without = cusum(
        np.delete(nights, slice(20, 60)), np.delete(values, slice(20, 60)), known_baseline(), 10.0
    )
    assert np.delete(found.statistic, slice(20, 60)) == pytest.approx(
        without.statistic, nan_ok=True
    )
    assert np.isnan(found.statistic[20:60]).all()
    assert found.is_on[20:60].all() == found.is_on[19]


def test_one_odd_night_does_not_tell_a_change() -> None:
    values = np.zeros(200)
    values[100] = 1000.0
    found = cusum(np.arange(-1, 199), values, known_baseline(phi=0.3), 9.0)
    assert not found.is_on.any()
    assert np.nanmax(found.statistic) <= WINSORISED_AT


def test_series_without_anything_to_watch() -> None:
    nothing = fit_baseline(np.arange(5), np.ones(5))
    assert not cusum(np.arange(50), np.full(50, 9.0), nothing, 9.0).is_on.any()
    empty = cusum(np.empty(0, dtype=np.int64), np.empty(0), known_baseline(), 9.0)
    assert len(empty.statistic) == 0
    gone = cusum(np.arange(-1, 49), np.full(50, np.nan), known_baseline(), 9.0)
    assert not gone.is_on.any()
    with pytest.raises(ShapeError):
        cusum(np.arange(3), np.ones(2), known_baseline(), 9.0)


def test_a_series_that_never_scattered_tells_any_rise() -> None:
    baseline = fit_baseline(np.arange(60), np.full(60, 2.0), BaselineSettings(relative_floor=0.0))
    nights = np.arange(100)
    risen = np.where(nights < 80, 2.0, 2.001)
    assert cusum(nights, risen, baseline, 9.0).is_on[-1]
    assert not cusum(nights, np.full(100, 2.0), baseline, 9.0).is_on.any()


def bare(n: int, phi: float, sd: float = 1.0):
    """A baseline that no floor touches."""
    return known_baseline(mean=10.0, sd=sd, phi=phi, n=n)


def test_limits_are_the_calibrated_ones_at_their_nodes_and_lie_between_elsewhere() -> None:
    assert cusum_limit(0.02, bare(60, 0.3)) == pytest.approx(
        LIMITS[RATES.index(0.02)][LENGTHS.index(60)][PHI.index(0.3)]
    )
    for n, phi, rate in ((75, 0.3, 0.02), (60, 0.25, 0.02), (60, 0.3, 0.03)):
        assert LIMITS[-1][-1][0] < cusum_limit(rate, bare(n, phi)) < LIMITS[0][0][-1]
    assert cusum_limit(0.02, bare(500, 0.3)) == pytest.approx(cusum_limit(0.02, bare(120, 0.3)))
    well_below = dataclasses.replace(bare(60, 0.0, sd=0.1), floored_sd=1.0)
    assert cusum_limit(0.02, well_below) == pytest.approx(
        FLOOR_LIMITS[RATES.index(0.02)][LENGTHS.index(60)]
    )


def test_limits_rise_with_what_is_not_known() -> None:
    table = np.array(LIMITS)
    assert (np.diff(table, axis=2) >= 0).all()
    assert (np.diff(table, axis=0) <= 0).all()
    assert (np.array(FLOOR_LIMITS)[:, :, None] <= table).all()


def test_limits_that_were_not_calibrated_are_refused() -> None:
    for rate, n in ((0.5, 60), (1e-4, 60), (0.02, 14)):
        with pytest.raises(ParameterError) as caught:
            cusum_limit(rate, bare(n, 0.0))
        assert caught.value.code == "alarm_rate"


@pytest.mark.parametrize(("n", "phi"), [(30, 0.3), (60, 0.0), (60, 0.6)])
def test_healthy_years_are_told_changed_no_more_often_than_asked_for(n: int, phi: float) -> None:
    """Rate 0.1, no floor, everything estimated; 300 years of nights no calibration has seen."""
    generator = np.random.default_rng([11, n, int(10 * phi)])
    settings = BaselineSettings(nights=n, provisional_nights=30, relative_floor=0.0)
    nights = np.arange(n + 365)
    told = 0
    for _ in range(300):
        values = 50.0 + autoregression(len(nights), phi, generator)
        baseline = fit_baseline(nights, values, settings)
        told += cusum(nights, values, baseline, cusum_limit(0.1, baseline)).is_on.any()
    # Sought at half the rate; 0.1 is 5 standard errors above that.
    assert told / 300 <= 0.1

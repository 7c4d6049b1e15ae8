"""Residual analysis: series of known answers, its definition sum by sum, what cannot be tested."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from leakage.estimation.residual_analysis import LagTest, analyse_residuals
from leakage.estimation.transport_lag import transport_lag
from tests.leakage.made_samples import Array, Generator, autoregression

Places = NDArray[np.int64]


def independence(error: Array, u: Array, index: Places | None = None) -> LagTest:
    places = np.arange(len(error)) if index is None else index
    return analyse_residuals(error, {"u": u}, places).independence["u"]


@pytest.mark.parametrize("lag", [3, -3, 0, 25, -25])
def test_a_delayed_input_peaks_at_its_lag_alone(lag: int) -> None:
    """ε(t) = u(t − lag) + noise: model.md, section 8."""
    generator = np.random.default_rng(23)
    n = 10_000
    u = generator.normal(size=n + 60)
    error = u[30 - lag : n + 30 - lag] + 2.0 * generator.normal(size=n)
    test = independence(error, u[30 : n + 30])
    assert test.largest is not None
    assert test.largest[0] == lag
    assert test.largest[1] == pytest.approx(1 / math.sqrt(5), abs=4 / math.sqrt(n))
    outside = np.abs(test.values) > test.bounds
    # Of 50 others, half a lag is expected outside: 4 and more once in 500 times.
    assert outside[test.lags == lag].all()
    assert outside.sum() <= 4
    assert test.verdict == "failed"


@pytest.mark.parametrize(
    ("n", "error_of", "words"),
    [
        (0, np.arange, "0 samples, 1000 are needed"),
        (999, np.arange, "999 samples, 1000 are needed"),
        (2000, lambda n: np.full(n, 0.25), "rounding"),
        (2000, lambda n: 0.25 + 1e-12 * np.random.default_rng(41).normal(size=n), "rounding"),
    ],
)
def test_what_cannot_be_tested_says_why(
    n: int, error_of: Callable[[int], Array], words: str
) -> None:
    error = error_of(n).astype(float)
    found = analyse_residuals(error, {"u": np.arange(float(n))}, np.arange(n), rounding=1e-9)
    for test in (found.whiteness, found.independence["u"]):
        check_untested(test, words)
        assert len(test.lags) == 0
        assert test.largest is None
    assert (found.n, found.n_effective, found.memory) == (n, None, None)


def test_errors_beyond_rounding_are_tested() -> None:
    error = 3e-9 * np.random.default_rng(47).uniform(-1, 1, 2000)
    found = analyse_residuals(error, {}, np.arange(2000), rounding=1e-9)
    assert found.whiteness.verdict == "passed"


def test_a_lag_with_few_pairs_has_no_value() -> None:
    """Every second sample is there, and at the end all: odd lags have 199 of 1700 pairs."""
    index = np.append(2 * np.arange(1500), 3000 + np.arange(200))
    found = analyse_residuals(np.random.default_rng(48).normal(size=1700), {}, index).whiteness
    assert np.isnan(found.values[1::2]).all()
    assert np.isfinite(found.values[::2]).all()
    assert found.verdict == "passed"


def check_untested(test: LagTest, words: str) -> None:
    assert (test.verdict, test.p_value) == ("not_tested", None)
    assert words in (test.reason or "")


def test_a_thousand_samples_are_enough_and_an_input_that_does_not_vary_is_none() -> None:
    error, u = np.random.default_rng(42).normal(size=(2, 1000))
    found = analyse_residuals(error, {"still": np.full(1000, 180.3), "u": u}, np.arange(1000))
    assert found.whiteness.verdict == found.independence["u"].verdict == "passed"
    check_untested(found.independence["still"], "does not vary")


@pytest.mark.parametrize(("length", "tested"), [(99, False), (101, True)])
def test_half_of_the_samples_need_neighbours(length: int, tested: bool) -> None:
    """Of a stretch of 100, 50 have 25 others on either side."""
    error, u = np.random.default_rng(44).normal(size=(2, 40 * length))
    index = np.arange(40 * length) + np.arange(40 * length) // length
    test = independence(error, u, index)
    assert np.isfinite(test.bounds).sum() == 51
    if tested:
        assert test.verdict == "passed"
    else:
        check_untested(test, "without a gap")


def gappy(n: int, generator: Generator) -> Places:
    """Places of n samples: every hundredth or so is missing, and a long stretch in the middle."""
    steps = np.where(generator.uniform(size=n) < 0.01, generator.integers(2, 9, n), 1)
    steps[n // 2] = 40_000
    return np.cumsum(steps)


def covariance(a: Array, b: Array, lag: int, index: Places) -> tuple[float, int]:
    """Mean of a(t) b(t − lag) over the pairs there are, and how many."""
    _, late, early = np.intersect1d(index, index + lag, return_indices=True)
    return float(a[late] @ b[early]) / max(len(late), 1), len(late)


def test_correlations_of_a_long_series_are_those_of_the_definition() -> None:
    generator = np.random.default_rng(49)
    index = gappy(12_000, generator)
    error, u = autoregression(0.7, 12_000, generator), autoregression(0.9, 12_000, generator)
    found = analyse_residuals(error, {"u": u}, index)
    e, v = ((values - values.mean()) / values.std() for values in (error, u))
    for lag in (1, 13, 25):
        assert found.whiteness.values[lag] == pytest.approx(covariance(e, e, lag, index)[0])
    for lag in (-25, -3, 0, 25):
        expected = covariance(e, v, lag, index)[0]
        assert found.independence["u"].values[lag + 25] == pytest.approx(expected, abs=1e-12)


@pytest.fixture(scope="module", params=["whole", "gaps"])
def example(request: pytest.FixtureRequest) -> tuple[Array, Array, Places]:
    """Errors that remember, and an input that does too and of which they depend a little."""
    generator = np.random.default_rng(11)
    n = 1400
    index = np.arange(n) if request.param == "whole" else gappy(n, generator)
    u = 40.0 + 7.0 * autoregression(0.9, n, generator)
    error = 0.3 + 0.02 * autoregression(0.7, n, generator) + 0.0002 * np.roll(u, 4)
    return error, u, index


def test_without_gaps_the_figure_is_that_of_ljung_and_box() -> None:
    """(n + 2)/n Σ (n − k) r², r over n − k pairs, as Stoffer and Toloi have it."""
    series = autoregression(0.1, 1500, np.random.default_rng(3))
    z = series - series.mean()
    n = len(z)
    r = {k: float(np.mean(z[k:] * z[:-k]) / np.mean(z * z)) for k in range(1, 26)}
    q = (n + 2) / n * sum((n - k) * r[k] ** 2 for k in r)
    found = analyse_residuals(series, {}, np.arange(n)).whiteness
    assert found.p_value == pytest.approx(float(chi2.sf(q, 25)), rel=1e-6)


def test_cross_correlation_and_band_are_those_of_the_definition(
    example: tuple[Array, Array, Places],
) -> None:
    error, u, index = example
    e, v = error - error.mean(), u - u.mean()
    size = float(np.sqrt(np.mean(e**2) * np.mean(v**2)))
    test = independence(error, u, index)
    p = 1.0
    for lag in range(1, 351):
        own, pairs = covariance(e, e, lag, index)
        if pairs >= 0.2 * len(e):
            p += 2 * own * covariance(v, v, lag, index)[0] / size**2
    assert p > 1.5
    assert test.lags.tolist() == list(range(-25, 26))
    for lag, value, bound in zip(test.lags, test.values, test.bounds, strict=True):
        expected, pairs = covariance(e, v, int(lag), index)
        assert value == pytest.approx(expected / size, abs=1e-12)
        assert bound == pytest.approx(2.576 * math.sqrt(p / pairs), rel=1e-9)


def test_the_probability_of_independence_is_that_of_the_definition(
    example: tuple[Array, Array, Places],
) -> None:
    """Π by its double sum, r sample by sample, κ from all inner samples; LAPACK for the rest."""
    error, u, index = example
    e = (error - error.mean()) / error.std()
    v = (u - u.mean()) / u.std()
    n = len(index)
    inner = [t for t in range(25, n - 25) if index[t + 25] - index[t - 25] == 50]
    r = np.array([sum(e[t] * v[t - k] for t in inner) for k in range(-25, 26)]) / len(inner)

    def correlation(a: Array, lag: int) -> float:
        value, pairs = covariance(a, a, abs(lag), index)
        return value if pairs >= 0.2 * n else 0.0

    errors = {lag: correlation(e, lag) for lag in range(301)}
    inputs = {lag: correlation(v, lag) for lag in range(351)}
    places = set(index[inner].tolist())
    follows = [sum(t + lag in places for t in places) / len(places) for lag in range(51)]

    def pi(d: int) -> float:
        return sum(
            follows[min(abs(tau), 50)] * errors[abs(tau)] * inputs[abs(tau + d)]
            for tau in range(-300, 301)
        )

    matrix = np.array([[pi(abs(j - k)) for k in range(51)] for j in range(51)])
    size, axes = np.linalg.eigh(matrix)
    clear = size > 1e-3 * size.max()
    rows = np.array(inner)
    windows = np.stack([v[rows - k] for k in range(-25, 26)], axis=1)
    weighted = windows @ axes[:, clear]
    # Residuals of a regression by its normal equations.
    slopes = np.linalg.solve(weighted.T @ weighted, weighted.T @ e[rows])
    rest = e[rows] - weighted @ slopes
    statistic = 0.0
    for value, axis in zip(size[clear], axes[:, clear].T, strict=True):
        f = windows @ axis
        kappa = np.mean(rest**2 * f**2) / (np.mean(e[rows] ** 2) * np.mean(f**2))
        statistic += len(inner) * float(axis @ r) ** 2 / (value * max(kappa, 1.0))
    expected = float(chi2.sf(statistic, int(clear.sum())))
    assert independence(error, u, index).p_value == pytest.approx(expected, rel=1e-5)


def test_variance_is_summed_until_the_errors_correlations_end() -> None:
    """P of errors that remember for 200 samples needs more than 300 lags."""
    generator = np.random.default_rng(12)
    error, u = (autoregression(math.exp(-1 / 200), 60_000, generator) for _ in range(2))
    expected = (1 + math.exp(-2 / 200)) / (1 - math.exp(-2 / 200))
    found = analyse_residuals(error, {"u": u}, np.arange(60_000))
    variance = (found.independence["u"].bounds[25] / 2.576) ** 2 * 60_000
    assert variance == pytest.approx(expected, rel=0.25)
    assert found.n_effective == pytest.approx(60_000 / 400, rel=0.3)


def test_variance_has_a_floor() -> None:
    """Errors that swing to and fro in step with an input of another pace: P near or below 0."""
    generator = np.random.default_rng(13)
    error = np.cos(np.pi * np.arange(4000)) + 0.05 * generator.normal(size=4000)
    bounds = independence(error, autoregression(0.95, 4000, generator)).bounds
    assert bounds[25] == pytest.approx(2.576 * math.sqrt(0.1 / 4000), rel=0.01)


@pytest.mark.parametrize("gaps", [False, True])
def test_memory_of_an_autoregression_is_its_time_to_a_share_of_1_over_e(gaps: bool) -> None:
    generator = np.random.default_rng(14)
    n = 60_000
    index = gappy(n, generator) if gaps else np.arange(n)
    series = autoregression(math.exp(-1 / 20), int(index[-1]) + 1, generator)[index]
    found = analyse_residuals(series, {}, index)
    assert found.memory == pytest.approx(20.0, rel=0.15)
    assert found.n_effective == pytest.approx(n / 40.0, rel=0.15)


def test_of_very_many_samples_evenly_spread_stretches_are_tested() -> None:
    generator = np.random.default_rng(15)
    n = 200_000
    u = generator.normal(size=n)
    error = generator.normal(size=n)
    # What goes with the input does so at the very end alone.
    error[-8192:] += u[-8192:]
    found = analyse_residuals(error, {"u": u}, np.arange(n))
    assert found.n == n
    assert found.n_effective == pytest.approx(n, rel=0.1)
    assert found.independence["u"].verdict == "failed"
    assert found.independence["u"].largest == (0, pytest.approx(1 / 8, abs=0.03))


# The lag of the drain flow


SECONDS = np.arange(4000.0)
LEVELS = np.random.default_rng(7).uniform(20.0, 280.0, (300, 2))


def drivers(at_s: np.ndarray) -> np.ndarray:
    """Two loads that change every 15 s."""
    ends = 15.0 * np.arange(len(LEVELS))
    return np.column_stack([np.interp(at_s, ends, level) for level in LEVELS.T])


def flow(at_s: np.ndarray) -> np.ndarray:
    """A flow that the drivers do not explain whole."""
    return np.sqrt(drivers(at_s)) @ (1.0, 0.3) + np.random.default_rng(3).normal(size=len(at_s))


@pytest.mark.parametrize("lag_s", [-4.3, 0.0, 3.5, 8.0, 20.6])
@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_a_lag_is_found_whatever_the_rate_and_the_gaps(lag_s: float, period_s: float) -> None:
    index = np.arange(int(4000 / period_s))
    index = index[(index * period_s) % 500 > 60]
    time_s = index * period_s
    found = transport_lag(flow(time_s - lag_s), [*drivers(time_s).T], index, period_s)
    assert found is not None
    assert found.seconds == pytest.approx(lag_s, abs=0.15)
    assert (found.gain > 0.05) == (lag_s != 0.0)


def test_what_was_paired_before_is_part_of_it() -> None:
    found = transport_lag(
        flow(SECONDS - 8.0), [*drivers(SECONDS - 5.5).T], SECONDS.astype(int), 1.0, 5.5
    )
    assert found is not None
    assert found.seconds == pytest.approx(8.0, abs=0.15)
    assert found.gain > 0.2


@pytest.mark.parametrize(
    ("y", "u", "period_s"),
    [
        (np.ones(4000), drivers(SECONDS), 1.0),
        (flow(SECONDS), np.ones((4000, 2)), 1.0),
        (flow(SECONDS), drivers(SECONDS), 30.0),
        (flow(SECONDS - 60.0), drivers(SECONDS), 1.0),
    ],
    ids=["flow at rest", "drivers at rest", "samples far apart", "lag out of reach"],
)
def test_none_where_nothing_can_be_estimated(y: np.ndarray, u: np.ndarray, period_s: float) -> None:
    found = transport_lag(y, [*u.T], SECONDS.astype(int), period_s)
    assert found is None or found.gain < 0.05

"""Residual analysis: series of known answers, and what cannot be tested."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from leakage.errors import StatisticsError
from leakage.estimation.residual_analysis import LagTest, analyse_residuals
from tests.leakage.estimation.made_errors import Array, Generator, autoregression


def one(
    error: Array, u: Array, index: NDArray[np.int64] | None = None, memory: float = 0.0
) -> LagTest:
    """The test of one input."""
    places = np.arange(len(error)) if index is None else index
    return analyse_residuals(error, {"u": u}, places, memory).independence["u"]


@pytest.mark.parametrize("lag", [3, -3, 0, 25, -25])
def test_a_delayed_input_peaks_at_its_lag_alone(lag: int) -> None:
    """ε(t) = u(t − lag) + noise: model.md, section 8."""
    generator = np.random.default_rng(23)
    n = 10_000
    u = generator.normal(size=n + 60)
    error = u[30 - lag : n + 30 - lag] + 2.0 * generator.normal(size=n)
    test = one(error, u[30 : n + 30])
    assert test.largest[0] == lag
    assert test.largest[1] == pytest.approx(1 / math.sqrt(5), abs=4 / math.sqrt(n))
    others = test.outside & (test.lags != lag)
    assert test.outside[test.lags == lag].all()
    # Of 50 others, half a lag is expected outside: 4 and more once in 500 times.
    assert others.sum() <= 3
    assert np.abs(test.values[test.lags != lag]).max() < 0.05
    assert test.verdict == "failed"
    assert test.p_value == pytest.approx(0.0, abs=1e-100)


@pytest.mark.parametrize(
    ("n", "error_of", "words"),
    [
        (0, np.arange, "0 samples, 1000 are needed"),
        (999, np.arange, "999 samples, 1000 are needed"),
        (2000, lambda n: np.full(n, 0.25), "rounding"),
        (
            2000,
            lambda n: 0.25 + 1e-12 * np.random.default_rng(41).normal(size=n),
            "rounding",
        ),
    ],
)
def test_what_cannot_be_tested_says_why(
    n: int, error_of: Callable[[int], Array], words: str
) -> None:
    error = error_of(n).astype(float)
    found = analyse_residuals(error, {"u": np.arange(float(n))}, np.arange(n), rounding=1e-9)
    for test in (found.whiteness, found.independence["u"]):
        check_untested(test, words)
        assert test.n_judged == len(test.lags) == 0
        assert test.largest is None
    assert (found.n, found.n_effective) == (n, None)
    assert found.mean_l_per_min == pytest.approx(error.mean() if n else math.nan, nan_ok=True)


def test_a_thousand_samples_are_enough() -> None:
    error, u = np.random.default_rng(42).normal(size=(2, 1000))
    assert analyse_residuals(error, {"u": u}, np.arange(1000)).whiteness.verdict == "passed"


def check_untested(test: LagTest, words: str) -> None:
    assert test.verdict == "not_tested"
    assert (test.statistic, test.degrees_of_freedom, test.p_value) == (None, None, None)
    assert words in (test.reason or "")


def test_an_input_that_does_not_vary() -> None:
    error, u = np.random.default_rng(42).normal(size=(2, 2000))
    found = analyse_residuals(error, {"still": np.full(2000, 180.3), "u": u}, np.arange(2000))
    check_untested(found.independence["still"], "does not vary")
    assert list(found.independence) == ["still", "u"]
    assert found.independence["u"].p_value == pytest.approx(one(error, u).p_value, rel=1e-9)


@pytest.mark.parametrize(("length", "tested"), [(99, False), (101, True)])
def test_segments_need_half_of_their_samples_inside(length: int, tested: bool) -> None:
    """Of a segment of 100, 50 have 25 others on either side."""
    error, u = np.random.default_rng(44).normal(size=(2, 40 * length))
    index = np.arange(40 * length) + np.arange(40 * length) // length
    found = analyse_residuals(error, {"u": u}, index)
    assert found.independence["u"].n_judged == 51
    assert found.whiteness.verdict == "passed"
    if tested:
        assert found.independence["u"].verdict == "passed"
    else:
        check_untested(found.independence["u"], "without a gap")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(bad: float) -> None:
    error, u = np.random.default_rng(46).normal(size=(2, 2000))
    u[7] = bad
    with pytest.raises(StatisticsError) as refused:
        one(error, u)
    assert refused.value.code == "not_finite"


def gappy(n: int, generator: Generator) -> NDArray[np.int64]:
    """Places of n samples: every hundredth or so is missing, and a long stretch in the middle."""
    steps = np.where(generator.uniform(size=n) < 0.01, generator.integers(2, 9, n), 1)
    steps[n // 2] = 4000
    return np.cumsum(steps)


def segments_of(index: NDArray[np.int64]) -> list[NDArray[np.intp]]:
    return np.split(np.arange(len(index)), np.flatnonzero(np.diff(index) != 1) + 1)


def covariance(a: Array, b: Array, lag: int, segments: list[NDArray[np.intp]]) -> tuple[float, int]:
    """Mean of a(t) b(t − lag) over pairs within a segment, and how many there are."""
    late, early = max(lag, 0), max(-lag, 0)
    longer = [rows for rows in segments if len(rows) > abs(lag)]
    total = sum(
        float(a[rows[late : len(rows) - early]] @ b[rows[early : len(rows) - late]])
        for rows in longer
    )
    pairs = sum(len(rows) - abs(lag) for rows in longer)
    return total / max(pairs, 1), pairs


@pytest.fixture(scope="module", params=["whole", "gaps"])
def example(request: pytest.FixtureRequest) -> tuple[Array, Array, NDArray[np.int64]]:
    """Errors that remember, and an input that does too and of which they depend a little."""
    generator = np.random.default_rng(11)
    n = 1400
    index = np.arange(n) if request.param == "whole" else gappy(n, generator)
    u = 40.0 + 7.0 * autoregression(0.9, n, generator)
    error = 0.3 + 0.02 * autoregression(0.7, n, generator) + 0.0002 * np.roll(u, 4)
    return error, u, index


def test_without_gaps_the_figure_is_that_of_ljung_and_box() -> None:
    """n (n + 2) Σ r²/(n − k), r(k) = Σ ε(t) ε(t − k) / Σ ε², as in their paper."""
    series = np.random.default_rng(3).normal(size=1500)
    z = series - series.mean()
    n = len(z)
    r = [float(z[k:] @ z[:-k] / (z @ z)) for k in range(1, 26)]
    q = n * (n + 2) * sum(rk**2 / (n - k) for k, rk in enumerate(r, start=1))
    assert analyse_residuals(series, {}, np.arange(n)).whiteness.statistic == pytest.approx(q)


def test_cross_correlation_and_band_are_those_of_the_definition(
    example: tuple[Array, Array, NDArray[np.int64]],
) -> None:
    error, u, index = example
    segments = segments_of(index)
    e, v = error - error.mean(), u - u.mean()
    size = float(np.sqrt(np.mean(e**2) * np.mean(v**2)))
    test = one(error, u, index)
    p = 1.0
    for lag in range(1, 301):
        own, pairs = covariance(e, e, lag, segments)
        if pairs >= 0.2 * len(e):
            p += 2 * own * covariance(v, v, lag, segments)[0] / size**2
    assert p > 1.5
    assert test.lags.tolist() == list(range(-25, 26))
    for lag, value, bound in zip(test.lags, test.values, test.bounds, strict=True):
        expected, pairs = covariance(e, v, int(lag), segments)
        assert value == pytest.approx(expected / size, abs=1e-12)
        assert bound == pytest.approx(2.576 * math.sqrt(p / pairs), rel=1e-9)


def test_independence_statistic_is_that_of_the_definition(
    example: tuple[Array, Array, NDArray[np.int64]],
) -> None:
    """Π by its double sum, r sample by sample, κ from all inner samples; LAPACK for the rest."""
    error, u, index = example
    segments = segments_of(index)
    e = (error - error.mean()) / error.std()
    v = (u - u.mean()) / u.std()
    inner = {int(t) for rows in segments for t in rows if rows[0] + 25 <= t <= rows[-1] - 25}
    r = np.array([sum(e[t] * v[t - k] for t in inner) for k in range(-25, 26)]) / len(inner)

    def correlation(a: Array, lag: int) -> float:
        value, pairs = covariance(a, a, abs(lag), segments)
        return value if pairs >= 0.2 * len(a) else 0.0

    errors = {lag: correlation(e, lag) for lag in range(301)}
    inputs = {lag: correlation(v, lag) for lag in range(351)}
    follows = [sum(t + lag in inner for t in inner) / len(inner) for lag in range(51)]

    def pi(d: int) -> float:
        return sum(
            follows[min(abs(tau), 50)] * errors[abs(tau)] * inputs[abs(tau + d)]
            for tau in range(-300, 301)
        )

    matrix = np.array([[pi(abs(j - k)) for k in range(51)] for j in range(51)])
    size, axes = np.linalg.eigh(matrix)
    statistic, freedom = 0.0, 0
    rows = np.array(sorted(inner))
    windows = np.stack([v[rows - k] for k in range(-25, 26)], axis=1)
    weighted = windows @ axes[:, size > 1e-3 * size.max()]
    # Residuals of a regression by its normal equations.
    slopes = np.linalg.solve(weighted.T @ weighted, weighted.T @ e[rows])
    rest = e[rows] - weighted @ slopes
    for value, axis in zip(size, axes.T, strict=True):
        if value > 1e-3 * size.max():
            f = windows @ axis
            kappa = np.mean(rest**2 * f**2) / (np.mean(e[rows] ** 2) * np.mean(f**2))
            statistic += len(inner) * float(axis @ r) ** 2 / (value * max(kappa, 1.0))
            freedom += 1
    test = one(error, u, index)
    assert test.degrees_of_freedom == freedom
    assert test.statistic == pytest.approx(statistic, rel=1e-7)
    assert test.p_value == pytest.approx(float(chi2.sf(statistic, freedom)), rel=1e-5)


def test_variance_is_summed_over_ten_correlation_times() -> None:
    """P of errors that remember for 200 samples needs more than 300 lags."""
    generator = np.random.default_rng(12)
    n = 60_000
    error, u = (autoregression(math.exp(-1 / 200), n, generator) for _ in range(2))
    expected = (1 + math.exp(-2 / 200)) / (1 - math.exp(-2 / 200))
    for memory, share in ((0.0, 1 - math.exp(-2 * 300 / 200)), (200.0, 1.0)):
        found = (one(error, u, memory=memory).bounds[25] / 2.576) ** 2 * n
        assert found == pytest.approx(share * expected, rel=0.15)


def test_variance_has_a_floor() -> None:
    """Errors that swing to and fro in step with an input of another pace: P near or below 0."""
    t = np.arange(4000)
    generator = np.random.default_rng(13)
    error = np.cos(np.pi * t) + 0.05 * generator.normal(size=4000)
    u = autoregression(0.95, 4000, generator)
    bounds = one(error, u).bounds
    assert bounds[25] == pytest.approx(2.576 * math.sqrt(0.1 / 4000), rel=0.01)

"""Residual analysis: series of known answers, false alarms, and what cannot be tested."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from leakage.errors import StatisticsError
from leakage.estimation.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals
from tests.leakage.estimation.made_errors import Array, Generator, autoregression, one


def held(n: int, hold: int, generator: Generator) -> Array:
    """Load steps that a motor follows with some inertia."""
    steps = np.repeat(generator.uniform(15.0, 300.0, n // hold + 1), hold)[:n]
    series, _ = lfilter([0.05], [1.0, -0.95], steps, zi=[0.95 * steps[0]])
    return np.asarray(series)


# series with a known answer


def test_white_errors_pass_both() -> None:
    generator = np.random.default_rng(21)
    error, u = generator.normal(size=(2, 20_000))
    found = analyse_residuals(error, {"u": u}, np.arange(20_000))
    assert found.whiteness.verdict == found.independence["u"].verdict == "passed"
    assert found.whiteness.outside.sum() <= 2
    assert found.independence["u"].outside.sum() <= 3
    assert (found.whiteness.n_judged, found.independence["u"].n_judged) == (25, 51)
    assert found.independence["u"].degrees_of_freedom == 51


@pytest.mark.parametrize("lag", [3, -3, 0, 25, -25])
def test_a_delayed_input_peaks_at_its_lag_alone(lag: int) -> None:
    """ε(t) = u(t − lag) + noise: model.md, section 8."""
    generator = np.random.default_rng(23)
    n = 10_000
    u = generator.normal(size=n + 60)
    error = u[30 - lag : n + 30 - lag] + 2.0 * generator.normal(size=n)
    test = one(error, u[30 : n + 30])
    assert test.largest is not None
    assert test.largest[0] == lag
    assert test.largest[1] == pytest.approx(1 / math.sqrt(5), abs=4 / math.sqrt(n))
    others = test.outside & (test.lags != lag)
    assert test.outside[test.lags == lag].all()
    # Of 50 others, half a lag is expected outside: 4 and more once in 500 times.
    assert others.sum() <= 3
    assert np.abs(test.values[test.lags != lag]).max() < 0.05
    assert test.verdict == "failed"
    assert test.p_value == pytest.approx(0.0, abs=1e-100)


def test_a_delay_of_a_slow_input_is_found_although_the_bands_see_nothing() -> None:
    """y follows u 0.3 s late at 10 Hz: the level of the correlations is right, their slope not."""
    generator = np.random.default_rng(27)
    n = 36_000
    u = held(n, 600, generator)
    late = np.concatenate([np.full(3, u[0]), u[:-3]])
    error = 0.005 * (late - u) + 0.02 * autoregression(0.9, n, generator)
    test = one(error, u, memory=10.0)
    assert test.verdict == "failed"
    assert test.p_value is not None
    assert test.p_value < 1e-6
    assert test.outside.sum() < 26
    # The same errors without the delay pass.
    assert one(error - 0.005 * (late - u), u, memory=10.0).verdict == "passed"


def rate(draw: Callable[[Generator], tuple[ResidualAnalysis, str]], times: int) -> int:
    """In how many of `times` draws a test failed."""
    generator = np.random.default_rng(31)
    failed = 0
    for _ in range(times):
        found, which = draw(generator)
        test = found.whiteness if which == "whiteness" else found.independence[which]
        failed += test.verdict == "failed"
    return failed


def acceptable(times: int, level: float) -> tuple[float, float]:
    """Range of 99.9 % of counts at a failure rate of 1 %, the upper end at a rate of `level`."""
    return binom.ppf(0.0005, times, 0.01), binom.ppf(0.9995, times, level)


# how often errors that depend on nothing fail


RATES = [(0.0, 0.0, False), (0.0, 0.95, True), (0.9, 0.9, False), (0.97, 0.99, True)]


@pytest.mark.parametrize(("phi", "psi", "gaps"), RATES)
def test_false_alarms_of_independent_series(phi: float, psi: float, gaps: bool) -> None:
    """At most one and a half in a hundred, whatever both remember."""

    def draw(generator: Generator) -> tuple[ResidualAnalysis, str]:
        n = 4000
        error, u = autoregression(phi, n, generator), autoregression(psi, n, generator)
        kept = np.arange(n)
        if gaps:
            kept = np.flatnonzero(generator.uniform(size=n) > 1 / 500)
        memory = -1 / math.log(phi) if phi else 0.0
        return analyse_residuals(error[kept], {"u": u[kept]}, kept, memory), "u"

    assert rate(draw, 200) <= acceptable(200, 0.015)[1]


def test_errors_that_are_larger_at_some_pressures_are_no_dependence() -> None:
    """Their size follows the input, their sign does not."""

    def draw(generator: Generator) -> tuple[ResidualAnalysis, str]:
        u = held(6000, 300, generator)
        error = autoregression(0.9, 6000, generator) * np.where(u < 100, 3.0, 1.0)
        return analyse_residuals(error, {"u": u}, np.arange(6000), 10.0), "u"

    assert rate(draw, 120) <= acceptable(120, 0.02)[1]


def check_untested(test: LagTest, words: str) -> None:
    assert test.verdict == "not_tested"
    assert (test.statistic, test.degrees_of_freedom, test.p_value) == (None, None, None)
    assert words in (test.reason or "")


# what cannot be tested


@pytest.mark.parametrize("n", [0, 1, 999])
def test_too_few_samples(n: int) -> None:
    found = analyse_residuals(np.arange(float(n)), {"u": np.arange(float(n))}, np.arange(n))
    for test in (found.whiteness, found.independence["u"]):
        check_untested(test, f"{n} samples, 1000 are needed")
        assert test.n_judged == len(test.lags) == 0
        assert test.largest is None
    assert found.n == n
    assert math.isnan(found.mean_l_per_min) == (n == 0)
    assert found.n_effective is None


@pytest.mark.parametrize("scale", [0.0, 1e-12])
def test_errors_that_are_rounding(scale: float) -> None:
    error = 0.25 + scale * np.random.default_rng(41).normal(size=2000)
    found = analyse_residuals(error, {"u": np.arange(2000.0)}, np.arange(2000), rounding=1e-9)
    check_untested(found.whiteness, "rounding")
    check_untested(found.independence["u"], "rounding")
    assert found.mean_l_per_min == pytest.approx(0.25)


@pytest.mark.parametrize("value", [0.0, 180.3])
def test_an_input_that_does_not_vary(value: float) -> None:
    error, u = np.random.default_rng(42).normal(size=(2, 2000))
    found = analyse_residuals(error, {"still": np.full(2000, value), "u": u}, np.arange(2000))
    check_untested(found.independence["still"], "does not vary")
    assert list(found.independence) == ["still", "u"]
    assert found.independence["u"].p_value == pytest.approx(one(error, u).p_value, rel=1e-9)


def test_short_segments_keep_their_bands_but_have_no_statistic() -> None:
    """Segments of 40: no sample has 25 others on either side."""
    error, u = np.random.default_rng(44).normal(size=(2, 4000))
    index = np.arange(4000) + np.arange(4000) // 40
    found = analyse_residuals(error, {"u": u}, index)
    check_untested(found.independence["u"], "without a gap")
    assert found.independence["u"].n_judged == 51
    assert found.whiteness.verdict == "passed"


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(bad: float) -> None:
    error, u = np.random.default_rng(46).normal(size=(2, 2000))
    u[7] = bad
    with pytest.raises(StatisticsError) as refused:
        one(error, u)
    assert refused.value.code == "not_finite"


# how much the errors tell

"""Residual analysis: series of known answers, false alarms, and what cannot be tested."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from leakage.errors import StatisticsError
from leakage.estimation.residual_analysis import LagTest, analyse_residuals
from tests.leakage.estimation.made_errors import Array, Generator, autoregression, one


def held(n: int, hold: int, generator: Generator) -> Array:
    """Load steps that a motor follows with some inertia."""
    steps = np.repeat(generator.uniform(15.0, 300.0, n // hold + 1), hold)[:n]
    series, _ = lfilter([0.05], [1.0, -0.95], steps, zi=[0.95 * steps[0]])
    return np.asarray(series)


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


RATES = [(0.0, 0.95, True, False), (0.97, 0.99, True, False), (0.9, 0.0, False, True)]


@pytest.mark.parametrize(("phi", "psi", "gaps", "uneven"), RATES)
def test_errors_that_depend_on_nothing_rarely_fail(
    phi: float, psi: float, gaps: bool, uneven: bool
) -> None:
    """At most one and a half in a hundred, two where errors are larger at some inputs.

    Whatever both remember; the size of uneven errors follows the input, their sign does not.
    """
    generator, times, n, failed = np.random.default_rng(31), 150, 4000, 0
    for _ in range(times):
        error = autoregression(phi, n, generator)
        u = held(n, 300, generator) if uneven else autoregression(psi, n, generator)
        if uneven:
            error *= np.where(u < 100, 3.0, 1.0)
        kept = np.flatnonzero(generator.uniform(size=n) > 1 / 500) if gaps else np.arange(n)
        memory = -1 / math.log(phi) if phi else 0.0
        found = analyse_residuals(error[kept], {"u": u[kept]}, kept, memory)
        failed += found.independence["u"].verdict == "failed"
    # 99.9 % of counts are below.
    assert failed <= binom.ppf(0.9995, times, 0.02 if uneven else 0.015)


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

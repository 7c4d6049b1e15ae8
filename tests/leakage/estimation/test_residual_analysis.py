"""Residual analysis: series of known answers, false alarms, and what cannot be tested."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from leakage.errors import ShapeError, StatisticsError
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


@pytest.mark.parametrize("phi", [-0.5, 0.3, 0.9])
def test_coloured_errors_show_their_coefficient_and_stay_independent(phi: float) -> None:
    generator = np.random.default_rng(22)
    n = 40_000
    error, u = autoregression(phi, n, generator), autoregression(0.8, n, generator)
    found = analyse_residuals(error, {"u": u}, np.arange(n))
    assert found.whiteness.verdict == "failed"
    assert found.whiteness.values[:6] == pytest.approx(phi ** np.arange(6.0), abs=0.04)
    assert found.independence["u"].verdict == "passed"
    # P of two autoregressions: (1 + φψ)/(1 − φψ).
    widened = (1 + 0.8 * phi) / (1 - 0.8 * phi)
    assert found.independence["u"].bounds == pytest.approx(2.576 * math.sqrt(widened / n), rel=0.06)


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


def test_a_delay_that_spans_a_gap_is_not_seen_across_it() -> None:
    """Segments of 100 samples; the input of the segment before, 10 samples off, tells nothing."""
    generator = np.random.default_rng(24)
    u = generator.normal(size=(200, 100))
    error = generator.normal(size=(200, 100))
    error[1:, :10] += 3.0 * u[:-1, -10:]
    index = (np.arange(200)[:, None] * 101 + np.arange(100)).ravel()
    joined = one(error.ravel(), u.ravel())
    apart = one(error.ravel(), u.ravel(), index)
    assert joined.outside[joined.lags == 10].all()
    assert not apart.outside[apart.lags == 10].any()
    assert (joined.verdict, apart.verdict) == ("failed", "passed")


def test_the_order_of_segments_does_not_matter() -> None:
    generator = np.random.default_rng(25)
    parts = [
        np.stack([autoregression(0.8, n, generator), autoregression(0.9, n, generator)])
        for n in (400, 90, 700, 300)
    ]
    found = []
    for order in ((0, 1, 2, 3), (2, 0, 3, 1)):
        error, u = np.hstack([parts[k] for k in order])
        index = np.concatenate(
            [2000 * k + np.arange(parts[o].shape[1]) for k, o in enumerate(order)]
        )
        found.append(analyse_residuals(error, {"u": u}, index))
    first, second = found
    assert first.whiteness.values == pytest.approx(second.whiteness.values, abs=1e-12)
    assert first.whiteness.statistic == pytest.approx(second.whiteness.statistic, rel=1e-9)
    for a, b in ((first.independence["u"], second.independence["u"]),):
        assert a.values == pytest.approx(b.values, abs=1e-12)
        assert a.bounds == pytest.approx(b.bounds, rel=1e-9)
        assert a.statistic == pytest.approx(b.statistic, rel=1e-6)


def test_an_input_that_the_law_has_wrong_shows_at_every_lag() -> None:
    """ε = a u + noise of an input that hardly changes in 25 samples: corr = a sd(u)/sd(ε)."""
    generator = np.random.default_rng(26)
    n = 36_000
    u = held(n, 600, generator)
    error = 0.02 * (u - u.mean()) / u.std() + 0.05 * autoregression(0.9, n, generator)
    test = one(error, u, memory=10.0)
    assert test.verdict == "failed"
    assert test.outside.all()
    expected = 0.02 / math.hypot(0.02, 0.05)
    assert test.values == pytest.approx(expected, abs=0.06)


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


def test_units_and_offsets_change_nothing() -> None:
    generator = np.random.default_rng(28)
    error, u = autoregression(0.7, 3000, generator), autoregression(0.9, 3000, generator)
    plain, other = one(error, u), one(1e-3 * error + 5.0, 1e5 * u + 2e7)
    assert other.values == pytest.approx(plain.values, abs=1e-9)
    assert other.bounds == pytest.approx(plain.bounds, rel=1e-9)
    assert other.p_value == pytest.approx(plain.p_value, rel=1e-6)
    turned = one(error, -u)
    assert turned.values == pytest.approx(-plain.values, abs=1e-12)
    assert turned.statistic == pytest.approx(plain.statistic, rel=1e-9)
    backwards = one(error[::-1], u[::-1])
    assert backwards.values == pytest.approx(plain.values[::-1], abs=1e-12)
    assert backwards.statistic == pytest.approx(plain.statistic, rel=1e-6)


def test_a_seldom_pulse_has_one_statistic_in_any_unit() -> None:
    """Of surroundings that few samples see, rounding is no regressor."""
    speed, generator = np.full(60_000, 30.0), np.random.default_rng(3)
    speed[20_000:20_029] = speed[41_000:41_029] = 40.0
    error = autoregression(0.5, 60_000, generator) + 0.2 * np.roll(speed, 3)
    statistics = [one(error, factor * speed).statistic for factor in (1.0, 3.0, math.pi / 30)]
    assert statistics == pytest.approx([statistics[0]] * 3, rel=1e-9)


def test_errors_far_from_zero_are_judged_by_their_scatter() -> None:
    error = autoregression(0.9, 5000, np.random.default_rng(6))
    input_ = np.random.default_rng(7).normal(size=5000)
    found = [
        analyse_residuals(1.0 + scale * error, {"u": input_}, np.arange(5000)).whiteness.statistic
        for scale in (1.0, 1e-11, 1e-13)
    ]
    assert found == pytest.approx([found[0]] * 3, rel=0.02)


def test_arguments_are_not_changed() -> None:
    error, u = np.random.default_rng(29).normal(size=(2, 1500))
    kept = error.copy(), u.copy()
    for array in (error, u):
        array.flags.writeable = False
    one(error, u)
    assert (error == kept[0]).all()
    assert (u == kept[1]).all()


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


def test_false_alarms_of_white_series() -> None:
    def draw(generator: Generator) -> tuple[ResidualAnalysis, str]:
        return analyse_residuals(generator.normal(size=2000), {}, np.arange(2000)), "whiteness"

    low, high = acceptable(600, 0.01)
    assert low <= rate(draw, 600) <= high


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


def test_share_of_lags_outside_is_one_in_a_hundred() -> None:
    generator = np.random.default_rng(32)
    shares = []
    for _ in range(150):
        error, u = autoregression(0.8, 3000, generator), autoregression(0.8, 3000, generator)
        shares.append(one(error, u).outside.mean())
    assert np.mean(shares) == pytest.approx(0.01, abs=0.004)


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


def test_samples_that_stand_alone() -> None:
    error, u = np.random.default_rng(43).normal(size=(2, 3000))
    found = analyse_residuals(error, {"u": u}, np.arange(0, 6000, 2))
    check_untested(found.whiteness, "without a gap")
    check_untested(found.independence["u"], "without a gap")
    assert np.flatnonzero(np.isfinite(found.independence["u"].values)).tolist() == [25]


def test_short_segments_keep_their_bands_but_have_no_statistic() -> None:
    """Segments of 40: no sample has 25 others on either side."""
    error, u = np.random.default_rng(44).normal(size=(2, 4000))
    index = np.arange(4000) + np.arange(4000) // 40
    found = analyse_residuals(error, {"u": u}, index)
    check_untested(found.independence["u"], "without a gap")
    assert found.independence["u"].n_judged == 51
    assert found.whiteness.verdict == "passed"


def test_one_jump_of_an_input_is_enough_to_be_tested() -> None:
    error = np.random.default_rng(45).normal(size=2000)
    u = np.zeros(2000)
    u[-1] = 1.0
    test = one(error, u)
    assert test.verdict == "passed"
    assert np.isfinite(test.bounds).all()


def test_arrays_of_different_length_are_refused() -> None:
    with pytest.raises(ShapeError) as refused:
        analyse_residuals(np.ones(5), {"u": np.ones(4)}, np.arange(5))
    assert refused.value.code == "shape"


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(bad: float) -> None:
    error, u = np.random.default_rng(46).normal(size=(2, 2000))
    u[7] = bad
    with pytest.raises(StatisticsError) as refused:
        one(error, u)
    assert refused.value.code == "not_finite"


# how much the errors tell


@pytest.mark.parametrize(("phi", "white"), [(0.0, 0.0), (0.9, 0.0), (0.98, 1.0)])
def test_effective_number_counts_all_correlations(phi: float, white: float) -> None:
    """Of an autoregression with white noise of size w on top: N/(1 + 2φ/(1 − φ)/(1 + w²))."""
    generator = np.random.default_rng(51)
    n = 60_000
    found = []
    for _ in range(8):
        error = autoregression(phi, n, generator) + white * generator.normal(size=n)
        memory = -1 / math.log(phi) if phi else 0.0
        found.append(analyse_residuals(error, {}, np.arange(n), memory).n_effective)
    expected = n / (1 + 2 * phi / (1 - phi) / (1 + white**2))
    assert np.mean([one for one in found if one is not None]) == pytest.approx(expected, rel=0.1)


def test_errors_that_never_forget_have_no_effective_number() -> None:
    drift = np.linspace(-1.0, 1.0, 5000)
    assert analyse_residuals(drift, {}, np.arange(5000), math.inf).n_effective is None

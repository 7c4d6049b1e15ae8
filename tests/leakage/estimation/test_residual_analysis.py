"""Residual analysis: the definitions pair by pair, series of known answers, and false alarms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import binom, chi2
from threadpoolctl import threadpool_limits

from leakage.errors import ShapeError, StatisticsError
from leakage.estimation.residual_analysis import LagTest, ResidualAnalysis, analyse_residuals

Array = NDArray[np.float64]
Generator = np.random.Generator


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    """As in a run; many small products would wait for one another."""
    with threadpool_limits(1):
        yield


def autoregression(phi: float, n: int, generator: Generator) -> Array:
    """Stationary AR(1) of unit variance."""
    start = [phi * generator.normal()]
    series, _ = lfilter([math.sqrt(1 - phi * phi)], [1.0, -phi], generator.normal(size=n), zi=start)
    return np.asarray(series)


def held(n: int, hold: int, generator: Generator) -> Array:
    """Load steps that a motor follows with some inertia."""
    steps = np.repeat(generator.uniform(15.0, 300.0, n // hold + 1), hold)[:n]
    series, _ = lfilter([0.05], [1.0, -0.95], steps, zi=[0.95 * steps[0]])
    return np.asarray(series)


def one(
    error: Array, u: Array, index: NDArray[np.int64] | None = None, memory: float = 0.0
) -> LagTest:
    places = np.arange(len(error), dtype=np.int64) if index is None else index
    return analyse_residuals(error, {"u": u}, places, memory).independence["u"]


# --- the definitions, pair by pair ------------------------------------------------------------


def gappy(n: int, generator: Generator) -> NDArray[np.int64]:
    """Places of n samples: every hundredth or so is missing, and a long stretch in the middle."""
    steps = np.where(generator.uniform(size=n) < 0.01, generator.integers(2, 9, n), 1)
    steps[n // 2] = 4000
    return np.cumsum(steps)


def segments_of(index: NDArray[np.int64]) -> list[NDArray[np.intp]]:
    return np.split(np.arange(len(index)), np.flatnonzero(np.diff(index) != 1) + 1)


def covariance(a: Array, b: Array, lag: int, segments: list[NDArray[np.intp]]) -> tuple[float, int]:
    """Mean of a(t) b(t − lag) over pairs within a segment, and how many there are."""
    total, pairs = 0.0, 0
    for rows in segments:
        for t in rows:
            if rows[0] <= t - lag <= rows[-1]:
                total += a[t] * b[t - lag]
                pairs += 1
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


def test_autocorrelation_is_that_of_the_definition(
    example: tuple[Array, Array, NDArray[np.int64]],
) -> None:
    error, _, index = example
    found = analyse_residuals(error, {}, index)
    assert found.mean_l_per_min == pytest.approx(sum(error) / len(error), rel=1e-12)
    centred = error - error.mean()
    variance = float(np.mean(centred**2))
    statistic = 0.0
    n, test = len(error), found.whiteness
    assert test.lags.tolist() == list(range(26))
    assert test.values[0] == pytest.approx(1.0, rel=1e-12)
    assert np.isnan(test.bounds[0])
    for lag in range(1, 26):
        value, pairs = covariance(centred, centred, lag, segments_of(index))
        assert test.values[lag] == pytest.approx(value / variance, abs=1e-12)
        assert test.bounds[lag] == pytest.approx(2.576 / math.sqrt(pairs), rel=1e-12)
        statistic += (n + 2) / n * pairs * (value / variance) ** 2
    assert test.statistic == pytest.approx(statistic, rel=1e-11)
    assert test.degrees_of_freedom == 25
    assert test.p_value == pytest.approx(float(chi2.sf(statistic, 25)), rel=1e-9)


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


# --- series with a known answer ---------------------------------------------------------------


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


def test_arguments_are_not_changed() -> None:
    error, u = np.random.default_rng(29).normal(size=(2, 1500))
    kept = error.copy(), u.copy()
    for array in (error, u):
        array.flags.writeable = False
    one(error, u)
    assert (error == kept[0]).all()
    assert (u == kept[1]).all()


# --- how often errors that depend on nothing fail ---------------------------------------------


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


# --- what cannot be tested --------------------------------------------------------------------


def check_untested(test: LagTest, words: str) -> None:
    assert test.verdict == "not_tested"
    assert (test.statistic, test.degrees_of_freedom, test.p_value) == (None, None, None)
    assert words in (test.reason or "")


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


# --- how much the errors tell -----------------------------------------------------------------


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

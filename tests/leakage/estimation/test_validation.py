"""Fit percent, information criteria and correlation: worked values, definitions and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.estimation.block_statistics import Array, factor, factors, merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from leakage.estimation.validation import (
    Agreement,
    Criteria,
    agreement,
    criteria,
    effective_sample_count,
    lag_one_autocorrelation,
    summed_effective_sample_count,
)
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import placeholder_motor

MOTOR = placeholder_motor(flushing="estimated", flushing_l_per_min=2.0)
TRUTH = true_coefficients(MOTOR)
SEEDS = st.integers(0, 10_000)


def fit_percent(measured: Array, predicted: Array) -> float:
    """Equation (23), over the samples."""
    error = np.linalg.norm(measured - predicted)
    return float(100.0 * (1.0 - error / np.linalg.norm(measured - measured.mean())))


# --- fit percent ----------------------------------------------------------------------------


@given(seed=SEEDS, share=st.floats(0.0, 5.0), noise=st.sampled_from([0.0, 0.02, 1.0]))
def test_fit_from_statistics_is_the_fit_by_definition(
    seed: int, share: float, noise: float
) -> None:
    z = made_samples(MOTOR, 200, seed, noise_l_per_min=noise)
    theta = share * TRUTH
    predicted = z[:, :4] @ theta + z[:, 4]
    found = agreement(merge(factors(z, np.array([0, 1, 1, 4, 200]))), theta)
    assert found.n == 200
    assert found.fit_percent == pytest.approx(fit_percent(z[:, 5], predicted), rel=1e-11)
    assert found.mean_error_l_per_min == pytest.approx(
        np.mean(z[:, 5] - predicted), rel=1e-9, abs=1e-12
    )
    rmse = np.sqrt(np.mean((z[:, 5] - predicted) ** 2))
    assert found.rmse_l_per_min == pytest.approx(rmse, rel=1e-11, abs=1e-13)
    assert found.fit_percent is not None
    assert found.fit_percent <= 100.0


def test_a_perfect_model_fits_a_hundred_percent() -> None:
    found = agreement(factor(made_samples(MOTOR, noise_l_per_min=0.0)), TRUTH)
    assert found.fit_percent == pytest.approx(100.0, abs=1e-10)
    assert found.rmse_l_per_min == pytest.approx(0.0, abs=1e-13)


def test_the_mean_fits_zero_percent_and_worse_is_negative() -> None:
    z = made_samples(MOTOR)
    z[:, 4] = 0.0  # no known flow, so that a constant predicts the mean exactly
    mean = z[:, 5].mean()
    at_mean = agreement(factor(z), np.array([0.0, 0.0, 0.0, mean]))
    assert at_mean.fit_percent == pytest.approx(0.0, abs=1e-10)
    # Off by k standard deviations: 100 (1 - sqrt(1 + k²)).
    worse = agreement(factor(z), np.array([0.0, 0.0, 0.0, mean + 3.0 * z[:, 5].std()]))
    assert worse.fit_percent == pytest.approx(100.0 * (1.0 - math.sqrt(10.0)), rel=1e-10)


def test_the_mean_is_that_of_the_data_judged() -> None:
    # Last night's model on tonight's samples, whose mean is another.
    tonight = made_samples(MOTOR, 400, conditions=made_conditions(400, 5, (20.0, 90.0)))
    last_night = certify(
        factor(made_samples(MOTOR, 400)), *Parametrisation.of(MOTOR).coefficient_bounds()
    ).coefficients
    expected = fit_percent(tonight[:, 5], tonight[:, :4] @ last_night + tonight[:, 4])
    assert agreement(factor(tonight), last_night).fit_percent == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("flow", [0.0, 0.1, 2.0, 1e3])
@pytest.mark.parametrize("n", [1, 2, 1000])
def test_a_motor_at_rest_has_no_shape_to_fit(flow: float, n: int) -> None:
    z = made_samples(MOTOR, conditions=made_conditions(n, pressure_bar=(0.0, 0.0)))
    z[:, 5] = flow
    found = agreement(factor(z), TRUTH)
    assert found.fit_percent is None
    assert found.n == n
    assert found.rmse_l_per_min == pytest.approx(abs(flow - 2.0), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize(("resolution", "has_fit"), [(0.0, True), (0.0099, True), (0.0101, False)])
def test_a_flow_that_moves_less_than_the_sensor_resolves_has_no_fit(
    resolution: float, has_fit: bool
) -> None:
    z = made_samples(MOTOR, 1000)
    z[:, 5] = 2.0 + 0.01 * np.where(np.arange(1000) % 2, 1.0, -1.0)  # standard deviation 0.01
    found = agreement(factor(z), TRUTH, resolution)
    assert (found.fit_percent is not None) == has_fit
    assert found.rmse_l_per_min is not None


def test_no_samples_agree_with_nothing() -> None:
    assert agreement(np.zeros((6, 6)), TRUTH) == Agreement(0, None, None, None)


# --- information criteria -------------------------------------------------------------------


def test_worked_values() -> None:
    # Model, section 6: N = 100, V = 0.5, d = 3.
    found = criteria(0.5, 3, 100)
    assert found.fpe == pytest.approx(0.530928, abs=5e-7)
    assert found.aic == pytest.approx(220.4730, abs=5e-5)
    assert found.aicc == pytest.approx(220.7230, abs=5e-5)
    assert found.bic == pytest.approx(228.2885, abs=5e-5)


@given(
    cost=st.floats(1e-12, 1e3),
    d=st.integers(0, 8),
    n=st.floats(20.0, 1e6),
    factor_on_cost=st.floats(1.01, 100.0),
)
def test_criteria_grow_with_the_cost(cost: float, d: int, n: float, factor_on_cost: float) -> None:
    good, bad = criteria(cost, d, n), criteria(cost * factor_on_cost, d, n)
    for name in ("aic", "aicc", "bic"):
        difference = getattr(bad, name) - getattr(good, name)
        assert difference == pytest.approx(n * math.log(factor_on_cost), rel=1e-6)
    assert good.fpe is not None
    assert bad.fpe == pytest.approx(good.fpe * factor_on_cost)


@given(cost=st.floats(1e-12, 1e3), d=st.integers(0, 8), n=st.floats(20.0, 1e6))
def test_a_parameter_costs_two_or_the_logarithm_of_the_samples(
    cost: float, d: int, n: float
) -> None:
    small, large = criteria(cost, d, n), criteria(cost, d + 1, n)
    assert None not in (small.aic, small.aicc, small.bic, small.fpe)
    assert large.aic - small.aic == pytest.approx(2.0, rel=1e-6, abs=1e-6)  # type: ignore[operator]
    assert large.bic - small.bic == pytest.approx(  # type: ignore[operator]
        math.log(n), rel=1e-6, abs=1e-6
    )
    assert large.fpe > small.fpe >= cost  # type: ignore[operator]
    assert small.aicc >= small.aic  # type: ignore[operator]


@given(n=st.integers(50, 10**9))
def test_criteria_of_many_samples_agree(n: int) -> None:
    # FPE → V (1 + 2d/N), AICc → AIC.
    found = criteria(0.3, 4, n)
    assert found.fpe == pytest.approx(0.3 * (1 + 8 / n), rel=50 / n**2 + 1e-14)
    assert found.aicc == pytest.approx(found.aic, abs=40.0 / (n - 5) + 1e-15 * n)


@pytest.mark.parametrize(
    ("cost", "d", "n"),
    [(0.0, 3, 100), (-1.0, 3, 100), (math.nan, 3, 100), (0.5, 3, 3), (0.5, 3, 2.5), (0.5, 0, 0)],
)
def test_criteria_that_are_undefined_are_none(cost: float, d: int, n: float) -> None:
    assert criteria(cost, d, n) == Criteria(None, None, None, None)


def criteria_by_flushing(constant_error_l_per_min: float) -> tuple[Criteria, Criteria]:
    """A night without flushing, fitted without and with one; its noise tells of no column."""
    n = 1000
    z = made_samples(placeholder_motor(), n)
    columns = z[:, :4] / np.linalg.norm(z[:, :4], axis=0)
    noise = 0.02 * np.random.default_rng(2).standard_normal(n)
    noise -= columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    truth = true_coefficients(placeholder_motor())
    z[:, 5] = z[:, :4] @ truth + z[:, 4] + noise + constant_error_l_per_min
    found = []
    for motor in (placeholder_motor(), placeholder_motor(flushing="estimated")):
        minimum = certify(factor(z), *Parametrisation.of(motor).coefficient_bounds())
        found.append(criteria(minimum.cost, minimum.n_estimated, n))
    return found[0], found[1]


def test_a_flushing_that_is_not_there_is_worse_by_the_price_of_a_parameter() -> None:
    none, estimated = criteria_by_flushing(1e-6)
    assert estimated.aic == pytest.approx(none.aic + 2.0, abs=1e-3)  # type: ignore[operator]
    assert estimated.bic == pytest.approx(none.bic + math.log(1000), abs=1e-3)  # type: ignore[operator]
    assert estimated.fpe == pytest.approx(none.fpe * (1 + 2 / 1000), rel=1e-5)  # type: ignore[operator]


def test_a_flushing_on_its_bound_costs_nothing() -> None:
    none, estimated = criteria_by_flushing(-0.01)
    assert estimated.aic == pytest.approx(none.aic, abs=1e-6)


def test_corrected_criterion_needs_more_than_one_sample_more_than_parameters() -> None:
    found = criteria(0.5, 3, 4)
    assert found.aicc is None
    assert found.aic is not None
    assert criteria(0.5, 3, 4.5).aicc is not None


# --- correlation ----------------------------------------------------------------------------


def autoregression(phi: float, n: int, seed: int) -> Array:
    """Stationary AR(1) of unit variance."""
    draws = np.random.default_rng(seed).standard_normal(n)
    series = np.empty(n)
    series[0] = draws[0]
    for index in range(1, n):
        series[index] = phi * series[index - 1] + math.sqrt(1 - phi * phi) * draws[index]
    return series


@pytest.mark.parametrize("phi", [-0.5, 0.0, 0.3, 0.6, 0.9, 0.99])
def test_lag_one_of_an_autoregression_is_its_coefficient(phi: float) -> None:
    series = autoregression(phi, 60_000, 4)
    found = lag_one_autocorrelation(series, np.array([0]))
    # Standard error sqrt((1 - φ²)/N).
    assert found == pytest.approx(phi, abs=4.0 * math.sqrt((1 - phi**2) / len(series)) + 1e-4)


def test_the_mean_of_the_residuals_does_not_correlate_them() -> None:
    series = autoregression(0.3, 5000, 4)
    begins = np.array([0])
    assert lag_one_autocorrelation(series + 1e3, begins) == pytest.approx(
        lag_one_autocorrelation(series, begins), rel=1e-9
    )


def test_pairs_across_gaps_do_not_count() -> None:
    # Pairs of opposite sign, then a gap: within a pair -1, across a gap +1.
    residual = np.tile([1.0, -1.0, -1.0, 1.0], 100)
    begins = np.arange(0, 400, 2)
    assert lag_one_autocorrelation(residual, begins) == pytest.approx(-1.0)
    assert lag_one_autocorrelation(residual, np.append(0, begins + 1)) == pytest.approx(1.0)


@given(seed=SEEDS, sizes=st.lists(st.integers(1, 30), min_size=2, max_size=10))
def test_gaps_pool_the_pairs_of_their_stretches(seed: int, sizes: list[int]) -> None:
    residual = np.random.default_rng(seed).standard_normal(sum(sizes))
    stretches = np.split(residual - residual.mean(), np.cumsum(sizes)[:-1])
    products = np.concatenate([one[1:] * one[:-1] for one in stretches])
    found = lag_one_autocorrelation(residual, np.cumsum([0, *sizes[:-1]]))
    if len(products):
        assert found == pytest.approx(products.mean() / residual.var(), rel=1e-9, abs=1e-12)
    else:
        assert found is None


@pytest.mark.parametrize("value", [0.0, 0.1, -0.0123, 1e3])
def test_equal_residuals_have_no_correlation(value: float) -> None:
    # Their mean is off by rounding, which is the same for all and would correlate perfectly.
    assert lag_one_autocorrelation(np.full(1001, value), np.array([0])) is None


@pytest.mark.parametrize("n", [0, 1])
def test_residuals_without_a_pair_have_no_correlation(n: int) -> None:
    assert lag_one_autocorrelation(np.ones(n), np.arange(n)) is None
    assert lag_one_autocorrelation(np.arange(4.0), np.arange(4)) is None


@pytest.mark.parametrize(
    ("phi", "expected"), [(0.0, 1000.0), (0.5, 1000 / 3), (0.9, 1000 / 19), (0.99, 1000 / 199)]
)
def test_effective_count(phi: float, expected: float) -> None:
    assert effective_sample_count(1000, phi) == pytest.approx(expected)


@given(n=st.integers(1, 10**7), phi=st.floats(-1.5, 1.5))
def test_effective_count_is_above_none_and_at_most_all(n: int, phi: float) -> None:
    found = effective_sample_count(n, phi)
    assert found is not None
    assert 0.0 < found <= n
    if phi <= 0.0:
        assert found == n


def test_effective_count_is_that_of_the_variance_of_a_mean() -> None:
    # The definition: var of the mean of N correlated values = var / N_eff.
    means = [autoregression(0.6, 400, seed).mean() for seed in range(600)]
    assert 1.0 / np.var(means) == pytest.approx(effective_sample_count(400, 0.6), rel=0.2)


def test_no_correlation_has_no_effective_count() -> None:
    assert effective_sample_count(1000, None) is None


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.99])
def test_both_effective_counts_agree_on_an_autoregression(phi: float) -> None:
    rho = np.append(phi ** np.arange(4000.0), [0.0, 0.0])
    assert summed_effective_sample_count(10_000, rho) == pytest.approx(
        effective_sample_count(10_000, phi)
    )


def test_the_summed_count_is_that_of_the_variance_of_a_mean_under_white_noise_too() -> None:
    # An autoregression with as much white noise: lag one alone would count five times too many.
    means, counts = [], []
    for seed in range(400):
        noise = np.random.default_rng(10_000 + seed).standard_normal(2000)
        series = autoregression(0.9, 2000, seed) + noise
        means.append(series.mean())
        centred = series - series.mean()
        rho = np.array([centred[k:] @ centred[: 2000 - k] for k in range(200)]) / (
            centred @ centred
        )
        counts.append(summed_effective_sample_count(2000, rho))
    assert None not in counts
    assert 2.0 / np.var(means) == pytest.approx(np.mean(counts), rel=0.2)  # type: ignore[arg-type]


def test_the_summed_count_is_at_most_all_samples() -> None:
    assert summed_effective_sample_count(1000, np.array([1.0, -0.6, 0.3, -0.4])) == 1000


@pytest.mark.parametrize("rho", [[], [1.0], [1.0, 0.9, 0.8, 0.7], [1.0, 0.5, 0.0]])
def test_correlations_that_do_not_end_have_no_summed_count(rho: list[float]) -> None:
    assert summed_effective_sample_count(1000, np.array(rho)) is None

"""Triangular factors: exact at any parameters, for any blocks, merged in any way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from leakage.errors import StatisticsError
from leakage.estimation.block_statistics import (
    Array,
    column_means,
    criterion,
    factor,
    factors,
    flow_summary,
    merge,
    sample_count,
    squared_error,
)
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import placeholder_motor

MOTOR = placeholder_motor(flushing="estimated", flushing_l_per_min=2.0)
SEEDS = st.integers(0, 2**32 - 1)
BLOCK_SIZES = st.lists(st.sampled_from([0, 1, 2, 3, 5, 6, 7, 60]), min_size=1, max_size=12)


def borders_of(sizes: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def random_coefficients(seed: int) -> Array:
    """Loss factors over four orders of magnitude and a constant flow, far from any minimum."""
    generator = np.random.default_rng(seed)
    return np.append(10.0 ** generator.uniform(-16.0, -12.0, 3), generator.uniform(0.0, 20.0))


def sum_over_samples(z: Array, coefficients: Array) -> float:
    """The criterion's sum in extended precision, sample by sample."""
    v = np.append(coefficients, (1.0, -1.0)).astype(np.longdouble)
    residual = (z.astype(np.longdouble) * v).sum(axis=1)
    return float((residual * residual).sum())


# --- the criterion --------------------------------------------------------------------------


def test_regressors_of_the_tests_are_of_realistic_size() -> None:
    # ΔP/η·60 000 at 200 bar and 0.055 Pa·s: 2e13 l/min per m³.
    balance_piston = made_samples(MOTOR)[:, 1]
    assert 5e12 < np.median(balance_piston) < 5e13


@given(sizes=BLOCK_SIZES, seed=SEEDS)
def test_criterion_from_merged_blocks_is_the_mean_over_the_samples(
    sizes: list[int], seed: int
) -> None:
    n = sum(sizes)
    z = made_samples(MOTOR, n, seed % 1000)
    coefficients = random_coefficients(seed)
    shuffled = np.random.default_rng(seed).permutation(len(sizes))
    r = merge(factors(z, borders_of(sizes))[shuffled])
    expected = sum_over_samples(z, coefficients)
    assert squared_error(r, coefficients) == pytest.approx(expected, rel=1e-12, abs=0.0)
    assert sample_count(r) == n
    if n:
        assert criterion(r, coefficients) == pytest.approx(expected / n, rel=1e-12, abs=0.0)


@given(seed=SEEDS, offset=st.floats(0.0, 1e-3))
def test_criterion_is_exact_at_and_around_the_truth(seed: int, offset: float) -> None:
    # Near the truth flow and prediction cancel to the noise: there digits would go first.
    z = made_samples(MOTOR, 400, seed % 1000, noise_l_per_min=0.02)
    coefficients = true_coefficients(MOTOR) * (1.0 + offset)
    r = merge(factors(z, borders_of([150, 0, 1, 3, 246])))
    expected = sum_over_samples(z, coefficients)
    assert squared_error(r, coefficients) == pytest.approx(expected, rel=1e-12)


def test_criterion_of_a_noise_free_truth_is_rounding() -> None:
    z = made_samples(MOTOR, 5000, noise_l_per_min=0.0)
    assert criterion(factor(z), true_coefficients(MOTOR)) < 1e-28


def test_factor_keeps_what_the_criterion_needs_and_no_more() -> None:
    z = made_samples(MOTOR, 864)
    r = factor(z)
    scale = np.linalg.norm(z, axis=0)
    np.testing.assert_allclose(
        r.T @ r / np.outer(scale, scale), (z / scale).T @ (z / scale), atol=1e-14
    )
    assert r.shape == (6, 6)


def test_no_samples_have_no_criterion() -> None:
    assert math.isnan(criterion(np.zeros((6, 6)), random_coefficients(1)))
    assert squared_error(np.zeros((6, 6)), random_coefficients(1)) == 0.0


# --- factors --------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5, 6, 7, 100])
def test_factor_is_triangular_with_a_diagonal_not_negative(n: int) -> None:
    r = factor(made_samples(MOTOR, n))
    assert r.shape == (6, 6)
    np.testing.assert_array_equal(r, np.triu(r))
    assert (np.diag(r) >= 0.0).all()


@example(sizes=[12_000, 3, 0, 40], seed=0)
@given(sizes=BLOCK_SIZES, seed=st.integers(0, 1000))
def test_each_of_many_factors_is_that_of_its_block(sizes: list[int], seed: int) -> None:
    # Rows must not slip into their neighbours.
    z = made_samples(MOTOR, sum(sizes), seed)
    borders = borders_of(sizes)
    scale = np.linalg.norm(z, axis=0) + 1e-300
    for r, first, end in zip(factors(z, borders), borders[:-1], borders[1:], strict=True):
        part = z[first:end]
        np.testing.assert_allclose(
            (r / scale).T @ (r / scale), (part / scale).T @ (part / scale), atol=1e-14
        )


def test_borders_may_leave_out_rows_at_both_ends() -> None:
    z = made_samples(MOTOR, 50)
    some = factors(z, np.array([10, 20, 20, 40]))
    assert [sample_count(r) for r in some] == [10, 0, 20]
    np.testing.assert_array_equal(some[2], factor(z[20:40]))


def test_no_blocks_give_no_factors() -> None:
    z = made_samples(MOTOR, 5)
    assert factors(z, np.array([0])).shape == (0, 6, 6)
    np.testing.assert_array_equal(merge(np.empty((0, 6, 6))), np.zeros((6, 6)))


@given(sizes=BLOCK_SIZES, seed=st.integers(0, 1000))
def test_merging_equals_the_factor_of_all_samples(sizes: list[int], seed: int) -> None:
    z = made_samples(MOTOR, sum(sizes) + 50, seed)
    borders = borders_of([*sizes, 50])
    scale = np.linalg.norm(z, axis=0)
    parts = factors(z, borders)
    np.testing.assert_allclose(merge(parts) / scale, factor(z) / scale, atol=1e-13)


def test_merging_in_steps_equals_merging_at_once() -> None:
    # Blocks of nights merge to nights, nights to windows.
    z = made_samples(MOTOR, 3000)
    parts = factors(z, np.arange(0, 3001, 100))
    scale = np.linalg.norm(z, axis=0)
    nights = np.stack([merge(parts[:7]), merge(parts[7:8]), merge(parts[8:])])
    np.testing.assert_allclose(merge(nights) / scale, merge(parts) / scale, atol=1e-13)


@pytest.mark.parametrize("n", [0, 1, 3, 4, 40])
def test_a_motor_at_rest_has_factors_too(n: int) -> None:
    # Without pressure every regressor is 0, and R is not unique.
    z = made_samples(MOTOR, conditions=made_conditions(n, pressure_bar=(0.0, 0.0)))
    r = factor(z)
    assert not z[:, :3].any()
    assert (np.diag(r) >= 0.0).all()
    coefficients = random_coefficients(4)
    expected = sum_over_samples(z, coefficients)
    assert squared_error(merge(np.stack([r, r])), coefficients) == pytest.approx(
        2 * expected, rel=1e-12
    )


@given(sizes=BLOCK_SIZES, seed=st.integers(0, 1000))
def test_zeros_have_no_sign(sizes: list[int], seed: int) -> None:
    # -0 and 0 are equal but not the same bytes: statistics are compared by their bytes.
    z = made_samples(MOTOR, sum(sizes), seed)
    z[::2, :3] = 0.0
    parts = factors(z, borders_of(sizes))
    for r in (parts, merge(parts)):
        assert not np.signbit(r[r == 0.0]).any()


def test_same_samples_give_the_same_bytes() -> None:
    z = made_samples(MOTOR, 500)
    borders = borders_of([120, 0, 3, 377])
    assert factors(z, borders).tobytes() == factors(z.copy(), borders).tobytes()
    assert merge(factors(z, borders)).tobytes() == merge(factors(z, borders)).tobytes()


def test_arguments_stay_as_they_are() -> None:
    z = made_samples(MOTOR, 20)
    before = z.copy()
    r = factor(z)
    merged_from = np.stack([r, r])
    merge(merged_from)
    flow_summary(r)
    np.testing.assert_array_equal(z, before)
    np.testing.assert_array_equal(merged_from, np.stack([r, r]))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_samples_that_are_not_finite_are_refused(value: float) -> None:
    z = made_samples(MOTOR, 20)
    z[7, 3] = value
    for refused in (lambda: factor(z), lambda: factors(z, np.array([0, 3, 20]))):
        with pytest.raises(StatisticsError, match="not finite") as caught:
            refused()
        assert caught.value.code == "not_finite"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_factors_that_are_not_finite_are_refused(value: float) -> None:
    # A damaged row of a store must not become a window that is nan.
    parts = factors(made_samples(MOTOR, 20), np.array([0, 10, 20]))
    parts[1, 2, 4] = value
    with pytest.raises(StatisticsError, match="not finite"):
        merge(parts)


def test_samples_that_are_no_matrix_are_refused() -> None:
    with pytest.raises(StatisticsError, match="matrix") as caught:
        factor(np.ones(6))
    assert caught.value.code == "shape"


# --- size, mean and spread ------------------------------------------------------------------


@given(
    sizes=BLOCK_SIZES,
    mean=st.sampled_from([0.0, 2.0, -3.0, 1e3]),
    spread=st.sampled_from([1e-2, 1.0, 30.0]),
    seed=st.integers(0, 1000),
)
def test_size_mean_and_spread_are_those_of_the_samples(
    sizes: list[int], mean: float, spread: float, seed: int
) -> None:
    z = made_samples(MOTOR, sum(sizes) + 2, seed)
    z[:, -1] = mean + spread * np.random.default_rng(seed).standard_normal(len(z))
    found = flow_summary(merge(factors(z, borders_of([*sizes, 2]))))
    y = z[:, -1]
    assert found.n == len(z)
    assert found.mean_l_per_min == pytest.approx(y.mean(), rel=1e-12, abs=1e-12 * spread)
    assert found.centred_norm_l_per_min == pytest.approx(
        np.linalg.norm(y - y.mean()), rel=1e-9, abs=1e-12 * abs(mean)
    )


def test_a_huge_mean_costs_the_spread_no_more_than_its_own_digits() -> None:
    # Mean 1e6, spread 1e-3: nine of sixteen digits are gone, and R'R would lose eighteen.
    z = made_samples(MOTOR, 4000)
    z[:, -1] = 1e6 + 1e-3 * np.random.default_rng(2).standard_normal(len(z))
    r = merge(factors(z, np.arange(0, 4001, 250)))
    y = z[:, -1].astype(np.longdouble)
    expected = float(np.sqrt(((y - y.mean()) ** 2).sum()))
    found = flow_summary(r)
    assert found.centred_norm_l_per_min == pytest.approx(expected, rel=1e-5)
    assert found.mean_l_per_min == pytest.approx(float(y.mean()), rel=1e-15, abs=0.0)
    squares = r.T @ r
    lost = squares[-1, -1] - squares[-3, -1] ** 2 / squares[-3, -3]
    assert abs(lost - expected**2) > 0.1 * expected**2


@pytest.mark.parametrize("n", [1, 2, 3])
def test_size_mean_and_spread_of_few_samples(n: int) -> None:
    z = made_samples(MOTOR, n)
    found = flow_summary(factor(z))
    assert found.n == n
    assert found.mean_l_per_min == pytest.approx(z[:, -1].mean(), rel=1e-13)
    assert found.centred_norm_l_per_min == pytest.approx(
        np.linalg.norm(z[:, -1] - z[:, -1].mean()), abs=1e-13
    )


def test_no_samples_have_no_mean() -> None:
    empty = flow_summary(np.zeros((6, 6)))
    assert (empty.n, empty.centred_norm_l_per_min) == (0, 0.0)
    assert math.isnan(empty.mean_l_per_min)
    assert np.isnan(column_means(np.zeros((6, 6)))).all()


def test_means_of_all_columns_are_those_of_the_samples() -> None:
    z = made_samples(MOTOR, 700)
    means = column_means(merge(factors(z, borders_of([1, 0, 3, 696]))))
    np.testing.assert_allclose(means, z.mean(axis=0), rtol=1e-12)


def test_sample_count_survives_a_year_of_nights() -> None:
    # 2.6e8 samples: the norm of a column of ones is exact to the unit.
    one_night = factor(made_samples(MOTOR, 2000))
    one_night = one_night * math.sqrt(720_000 / 2000)
    assert sample_count(merge(np.repeat(one_night[None], 365, axis=0))) == 365 * 720_000

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
    criterion,
    factor,
    factors,
    flow_summary,
    merge,
    sample_count,
    squared_error,
)
from tests.leakage.made_samples import made_samples
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


@given(sizes=BLOCK_SIZES, seed=st.integers(0, 1000))
def test_merging_equals_the_factor_of_all_samples(sizes: list[int], seed: int) -> None:
    z = made_samples(MOTOR, sum(sizes) + 50, seed)
    borders = borders_of([*sizes, 50])
    scale = np.linalg.norm(z, axis=0)
    parts = factors(z, borders)
    np.testing.assert_allclose(merge(parts) / scale, factor(z) / scale, atol=1e-13)


@given(sizes=BLOCK_SIZES, seed=st.integers(0, 1000))
def test_zeros_have_no_sign(sizes: list[int], seed: int) -> None:
    # -0 and 0 are equal but not the same bytes: statistics are compared by their bytes.
    z = made_samples(MOTOR, sum(sizes), seed)
    z[::2, :3] = 0.0
    parts = factors(z, borders_of(sizes))
    for r in (parts, merge(parts)):
        assert not np.signbit(r[r == 0.0]).any()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused(value: float) -> None:
    z = made_samples(MOTOR, 20)
    # A damaged row of a store must not become a window that is nan.
    parts = factors(z, np.array([0, 10, 20]))
    parts[1, 2, 4] = z[7, 3] = value
    for refused in (
        lambda: factor(z),
        lambda: factors(z, np.array([0, 3, 20])),
        lambda: merge(parts),
    ):
        with pytest.raises(StatisticsError, match="not finite") as caught:
            refused()
        assert caught.value.code == "not_finite"
    with pytest.raises(StatisticsError, match="must be a matrix"):
        factor(z[0])


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


def test_sample_count_survives_a_year_of_nights() -> None:
    # 2.6e8 samples: the norm of a column of ones is exact to the unit.
    one_night = factor(made_samples(MOTOR, 2000))
    one_night = one_night * math.sqrt(720_000 / 2000)
    assert sample_count(merge(np.repeat(one_night[None], 365, axis=0))) == 365 * 720_000

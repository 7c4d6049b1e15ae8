"""Triangular factors of blocks, and what they tell of a fit: exact at any parameters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.arrays import Array
from leakage.errors import StatisticsError
from leakage.estimation.blocks import (
    criterion,
    factor,
    factors,
    merge,
    sample_count,
    smooth,
    squared_error,
)
from leakage.estimation.validation import agreement, criteria, effective_sample_count
from tests.leakage.made_samples import (
    autoregression,
    made_conditions,
    made_samples,
    true_coefficients,
)
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


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused(value: float) -> None:
    z = made_samples(MOTOR, 20)
    # A damaged row of a store must not become a window that is nan.
    parts = factors(z, np.array([0, 10, 20]))
    parts[1, 2, 4] = z[7, 3] = value
    for refused in (lambda: factors(z, np.array([0, 3, 20])), lambda: merge(parts)):
        with pytest.raises(StatisticsError) as caught:
            refused()
        assert caught.value.code == "not_finite"


def test_sample_count_survives_a_year_of_nights() -> None:
    # 2.6e8 samples: the norm of a column of ones is exact to the unit.
    one_night = factor(made_samples(MOTOR, 2000))
    one_night = one_night * math.sqrt(720_000 / 2000)
    assert sample_count(merge(np.repeat(one_night[None], 365, axis=0))) == 365 * 720_000


TRUTH = true_coefficients(MOTOR)


def fit_percent(measured: Array, predicted: Array) -> float:
    """Equation (23), over the samples."""
    error = np.linalg.norm(measured - predicted)
    return float(100.0 * (1.0 - error / np.linalg.norm(measured - measured.mean())))


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
    assert found.fit_percent <= 100.0


@pytest.mark.parametrize(
    ("flow", "swing", "n", "resolution", "has_fit"),
    [
        (0.0, 0.0, 1, 0.0, False),
        (0.1, 0.0, 2, 0.0, False),
        (1e3, 0.0, 1000, 0.0, False),
        (2.0, 0.01, 1000, 0.0, True),
        (2.0, 0.01, 1000, 0.0099, True),
        (2.0, 0.01, 1000, 0.0101, False),
    ],
)
def test_a_flow_that_moves_less_than_the_sensor_resolves_has_no_fit(
    flow: float, swing: float, n: int, resolution: float, has_fit: bool
) -> None:
    z = made_samples(MOTOR, conditions=made_conditions(n, pressure_bar=(0.0, 0.0)))
    z[:, 5] = flow + swing * np.where(np.arange(n) % 2, 1.0, -1.0)
    found = agreement(factor(z), TRUTH, resolution)
    assert (found.n, found.fit_percent is not None) == (n, has_fit)
    # Two litres of flushing are expected.
    rmse = math.hypot(flow - 2.0, swing)
    assert found.rmse_l_per_min == pytest.approx(rmse, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize(
    ("cost", "d", "n", "expected"),
    [
        # Model, section 6, and N = d + 1, d + 2: FPE is V (2 d + 1); AICc would divide by 0, and
        # then adds 2 d (d + 1).
        (0.5, 3, 100, (0.530928, 220.4730, 220.7230, 228.2885)),
        (1.0, 3, 4, (7.0, 17.3515, None, 15.5104)),
        (1.0, 3, 5, (4.0, 20.1894, 44.1894, 19.0177)),
        *((cost, d, n, (None,) * 4) for cost, d, n in ((0.0, 3, 100), (-1.0, 3, 100))),
        *((cost, d, n, (None,) * 4) for cost, d, n in ((math.nan, 3, 100), (0.5, 3, 2.5))),
        *((0.5, d, n, (None,) * 4) for d, n in ((3, 3), (0, 0))),
    ],
)
def test_criteria_by_hand(
    cost: float, d: int, n: float, expected: tuple[float | None, ...]
) -> None:
    found = criteria(cost, d, n)
    for value, wanted in zip((found.fpe, found.aic, found.aicc, found.bic), expected, strict=True):
        assert value == (wanted if wanted is None else pytest.approx(wanted, abs=1e-4))


def test_the_summed_count_is_that_of_the_variance_of_a_mean_under_white_noise_too() -> None:
    # An autoregression with as much white noise: lag one alone would count five times too many.
    means, counts = [], []
    for seed in range(400):
        generator = np.random.default_rng(seed)
        series = autoregression(0.9, 2000, generator) + generator.standard_normal(2000)
        means.append(series.mean())
        centred = series - series.mean()
        rho = np.array([centred[k:] @ centred[: 2000 - k] for k in range(200)]) / (
            centred @ centred
        )
        counts.append(effective_sample_count(2000, rho))
    assert None not in counts
    assert 2.0 / np.var(means) == pytest.approx(np.mean(counts), rel=0.2)  # type: ignore[arg-type]


@pytest.mark.parametrize("rho", [[], [1.0], [1.0, 0.9, 0.8, 0.7], [1.0, 0.5, 0.0]])
def test_correlations_that_do_not_end_have_no_summed_count(rho: list[float]) -> None:
    assert effective_sample_count(1000, np.array(rho)) is None


# Averages


Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STEP = 100_000


def slow_average(z: Floats, index: Ints, block: Ints, half: int) -> Floats:
    """The definition: the mean of all samples within reach that nothing stands between."""

    def reach(row: int, step: int) -> int:
        end = row
        while (
            0 <= end + step < len(z)
            and index[end + step] - index[end] == step
            and block[end + step] == block[row]
            and abs(index[end + step] - index[row]) <= half
        ):
            end += step
        return end

    return np.array([z[reach(row, -1) : reach(row, 1) + 1].mean(axis=0) for row in range(len(z))])


def some_samples(seed: int, n: int = 80) -> tuple[Floats, Ints, Ints]:
    rng = np.random.default_rng(seed)
    index = np.sort(rng.choice(round(1.15 * n), n, replace=False)).astype(np.int64)
    return rng.normal(0, 1, (n, 4)), index, index // 25


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.19, 0.2, 0.5, 2.0, 50.0]))
def test_as_the_slow_definition(seed: int, window_s: float) -> None:
    z, index, block = some_samples(seed)
    got = smooth(z, index, block, STEP, window_s)
    expected = slow_average(z, index, block, round(window_s * 1e6) // 2 // STEP)
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13)

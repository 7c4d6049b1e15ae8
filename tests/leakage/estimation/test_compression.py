"""Huber's weights against SciPy's; the moving average against a slow reference."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares

from leakage.estimation.block_statistics import factor
from leakage.estimation.compression import (
    MAD_TO_SD,
    TUNING,
    compress,
    huber_weights,
    smooth,
    weight_inflation,
)
from leakage.estimation.proven_minimum import certify
from leakage.estimation.sample_blocks import TRAINING, VALIDATION, Block

FREE = np.array([-99.0, -99.0]), np.array([99.0, 99.0])


def made(seed: int, spoilt: float) -> np.ndarray:
    """y = 2 x + 1 with noise of 0.1, and a share of samples that are 5 too high."""
    generator = np.random.default_rng(seed)
    x = generator.uniform(0, 10, 2000)
    y = 2 * x + 1 + 0.1 * generator.normal(size=2000)
    y[generator.random(2000) < spoilt] += 5.0
    return np.column_stack([x, np.ones(2000), np.zeros(2000), y])


def weighted_fit(z: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return certify(factor(z * np.sqrt(weights)[:, None]), *FREE).coefficients


def test_it_ends_where_scipys_huber_loss_does() -> None:
    z = made(1, 0.05)
    weights = huber_weights(z, *FREE)
    found = weighted_fit(z, weights)
    error = z @ np.concatenate([found, (1.0, -1.0)])
    scale = MAD_TO_SD * np.median(np.abs(error))
    scipy = least_squares(
        lambda p: z[:, 0] * p[0] + p[1] - z[:, -1],
        [0.0, 0.0],
        loss="huber",
        f_scale=TUNING * scale,
        xtol=1e-14,
        ftol=1e-14,
    )
    assert found == pytest.approx(scipy.x, rel=1e-5)


def test_samples_are_weighed_by_those_of_the_parts_that_are_named() -> None:
    z, index = made(2, 0.2), np.arange(2000)
    halves = ((0, 1000, TRAINING), (1000, 2000, VALIDATION))
    blocks = tuple(Block(first, end, first, end, part) for first, end, part in halves)
    for parts, n in ((None, 2000), ((TRAINING,), 1000)):
        weights = np.append(huber_weights(z[:n], *FREE), np.ones(2000 - n))
        found = compress(
            z, index, 1, blocks, FREE, maximum_blocks=2, loss="huber", weighted_parts=parts
        )
        wanted = [factor((z * np.sqrt(weights)[:, None])[first:end]) for first, end, _ in halves]
        assert np.abs(found.factors) == pytest.approx(np.abs(wanted), abs=1e-9)
        assert found.inflation == weight_inflation(weights[:n])


def test_errors_without_spread_all_count() -> None:
    x = np.arange(10.0)
    z = np.column_stack([x, np.ones(10), np.zeros(10), 2 * x + 1])
    assert weighted_fit(z, huber_weights(z, *FREE)) == pytest.approx([2.0, 1.0])


def test_standard_errors_are_inflated_by_what_theory_says_of_normal_errors() -> None:
    """E ψ' = P(|e| < 1.345) = 0.8214; E w = that + 1.345 E(1/|e|; |e| > 1.345) = 0.9599."""
    weights = np.concatenate([huber_weights(made(seed, 0.0), *FREE) for seed in range(20)])
    assert weight_inflation(weights) == pytest.approx(0.9599 / 0.8214, rel=0.02)
    assert weight_inflation(np.ones(5)) == 1.0


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


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.19, 0.2, 0.5, 2.0, 50.0]),
    st.sampled_from(["all", "leakage"]),
)
def test_as_the_slow_definition(
    seed: int, window_s: float, apply_to: Literal["all", "leakage"]
) -> None:
    z, index, block = some_samples(seed)
    got = smooth(z, index, block, STEP, window_s, apply_to)
    expected = slow_average(z, index, block, round(window_s * 1e6) // 2 // STEP)
    if apply_to == "leakage":
        expected[:, :-1] = z[:, :-1]
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13)

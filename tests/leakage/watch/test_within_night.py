"""Errors within a night, and blocks that the others of their night contradict."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.watch.within_night import START, BlockErrors, estimate_errors, night_information
from tests.leakage.watch.made_machine import slow_errors

Array = NDArray[np.float64]

MIDDLE_S: Array = np.linspace(60.0, 3540.0, 30)
TRUTH = BlockErrors(0.012, 0.006, 0.01, 700.0)


def made_nights(n: int, seed: int) -> list[tuple[Array, Array]]:
    generator = np.random.default_rng(seed)
    made = []
    for _ in range(n):
        residuals = slow_errors(MIDDLE_S, TRUTH.slow, TRUTH.memory_s, generator)
        residuals += TRUTH.block * generator.standard_normal(len(MIDDLE_S))
        made.append((MIDDLE_S, residuals + TRUTH.night * generator.standard_normal()))
    return made


def test_errors_are_found_again() -> None:
    found = estimate_errors(made_nights(60, 1), BlockErrors.of(START))
    assert found.block == pytest.approx(TRUTH.block, rel=0.1)
    assert found.slow == pytest.approx(TRUTH.slow, rel=0.2)
    assert found.memory_s == pytest.approx(TRUTH.memory_s, rel=0.4)
    assert found.night == pytest.approx(TRUTH.night, rel=0.4)


def test_information_is_that_of_generalised_least_squares() -> None:
    generator = np.random.default_rng(3)
    design = generator.uniform(0.2, 0.5, (len(MIDDLE_S), 3))
    residuals = made_nights(1, 4)[0][1] - design @ np.array([0.1, -0.2, 0.0])
    apart = np.abs(np.subtract.outer(MIDDLE_S, MIDDLE_S))
    covariance = TRUTH.slow**2 * np.exp(-apart / TRUTH.memory_s)
    covariance += TRUTH.block**2 * np.eye(len(MIDDLE_S))
    precise = np.linalg.inv(covariance)
    information, score = night_information(design, residuals, MIDDLE_S, TRUTH, 2)
    assert information == pytest.approx(design.T @ precise @ design, rel=1e-9)
    assert score == pytest.approx(design.T @ precise @ residuals, rel=1e-9)


def test_one_odd_block_counts_less() -> None:
    generator = np.random.default_rng(5)
    design = generator.uniform(0.2, 0.5, (len(MIDDLE_S), 2))
    residuals = made_nights(1, 6)[0][1]
    odd = residuals.copy()
    odd[11] += 0.4
    kept = np.arange(len(MIDDLE_S)) != 11
    without = np.linalg.solve(
        *night_information(design[kept], residuals[kept], MIDDLE_S[kept], TRUTH, 2)
    )
    weighed = np.linalg.solve(*night_information(design, odd, MIDDLE_S, TRUTH, 2))
    whole = np.linalg.inv(TRUTH.covariance(MIDDLE_S))
    believed = np.linalg.solve(design.T @ whole @ design, design.T @ whole @ odd)
    assert np.abs(weighed - without).max() < 0.15 * np.abs(believed - without).max()


def test_a_broken_path_makes_no_block_odd() -> None:
    """Against the night's mean its busy blocks would be outliers of thirty standard deviations."""
    share = np.zeros(len(MIDDLE_S))
    share[::10] = 0.4
    design = np.column_stack([share, 0.6 - 0.3 * share])
    broken = made_nights(1, 7)[0][1] + 2.0 * share
    information, score = night_information(design, broken, MIDDLE_S, TRUTH, 2)
    precise = np.linalg.inv(TRUTH.covariance(MIDDLE_S))
    assert information == pytest.approx(design.T @ precise @ design, rel=1e-9)
    assert np.linalg.solve(information, score)[0] == pytest.approx(2.0, abs=0.1)

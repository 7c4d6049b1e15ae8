"""Noise with a memory against its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.demo.recording import autoregression, correlated_noise, phi_of

SERIES = 20_000


def white(n: int, series: int = SERIES, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, series))


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.95, 0.999])
def test_autoregression_has_variance_one_from_the_start_and_forgets_by_phi_a_step(
    phi: float,
) -> None:
    noise = autoregression(white(41), phi)
    covariance = noise @ noise.T / SERIES
    lags = np.abs(np.subtract.outer(np.arange(41), np.arange(41)))
    # Standard error of a covariance of unit normals: at most √(2 / SERIES).
    assert covariance == pytest.approx(phi**lags, abs=5 * math.sqrt(2 / SERIES))
    assert phi_of(0.1, -0.1 / math.log(0.95)) == pytest.approx(0.95)


def test_correlated_noise_falls_to_1_over_e_in_its_time_constant() -> None:
    noise = correlated_noise(np.random.default_rng(3), 400_000, 0.5, 5.0)
    assert np.mean(noise[10:] * noise[:-10]) == pytest.approx(1 / math.e, abs=0.03)

"""How long errors remember: against the definition, and series of known memory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from leakage.correlation import autocorrelation, correlation_time


def test_it_equals_the_sum_over_pairs_across_no_gap() -> None:
    generator = np.random.default_rng(1)
    index = np.sort(generator.choice(120, size=70, replace=False))
    values = generator.normal(size=70)
    centred = dict(zip(index.tolist(), (values - values.mean()).tolist(), strict=True))
    variance = sum(value * value for value in centred.values()) / 70
    for lag, found in enumerate(autocorrelation(values, index, 15)):
        pairs = [centred[i] * centred[i + lag] for i in centred if i + lag in centred]
        assert found == pytest.approx(sum(pairs) / len(pairs) / variance, abs=1e-12)


@pytest.mark.parametrize("phi", [0.9, 0.95, 0.99])
@pytest.mark.parametrize("white", [0.0, 1.0])
def test_the_time_of_an_autoregression_is_known_with_white_noise_on_top_too(
    phi: float, white: float
) -> None:
    generator = np.random.default_rng(2)
    times = []
    for _ in range(10):
        slow = lfilter([1.0], [1.0, -phi], generator.normal(size=41_000))[1000:]
        slow /= slow.std()
        noisy = slow + white * generator.normal(size=40_000)
        times.append(correlation_time(noisy, np.arange(40_000), 4000))
    assert np.median(times) == pytest.approx(-1 / math.log(phi), rel=0.1)


def test_white_errors_have_no_memory() -> None:
    generator = np.random.default_rng(3)
    times = [
        correlation_time(generator.normal(size=5000), np.arange(5000), 500) for _ in range(100)
    ]
    # The band at lag one is one-sided 99.5 %.
    assert np.mean(np.array(times) > 0) <= 0.03


def test_a_memory_longer_than_looked_at_is_the_longest_lag() -> None:
    drift = np.linspace(-1, 1, 2000)
    assert correlation_time(drift, np.arange(2000), 100) == 100.0


def test_errors_without_spread_have_no_memory() -> None:
    assert correlation_time(np.full(100, 3.0), np.arange(100), 10) == 0.0

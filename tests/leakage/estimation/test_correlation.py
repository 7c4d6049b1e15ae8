"""Autocorrelation of errors: against the definition, and on series of known correlation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from leakage.estimation.correlation import (
    autocorrelation,
    correlation_time,
    memory_s,
    slowest_correlation_time,
)


@pytest.mark.parametrize("n", [70, 115])
def test_it_equals_the_sum_over_pairs_with_many_gaps_or_few(n: int) -> None:
    generator = np.random.default_rng(1)
    index = np.sort(generator.choice(120, size=n, replace=False))
    values = generator.normal(size=n)
    centred = dict(zip(index.tolist(), (values - values.mean()).tolist(), strict=True))
    variance = sum(value * value for value in centred.values()) / n
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


def test_every_second_sample_remembers_as_long() -> None:
    generator = np.random.default_rng(4)
    slow = lfilter([1.0], [1.0, -0.98], generator.normal(size=41_000))[1000:]
    every_second = correlation_time(slow[::2], np.arange(0, 40_000, 2), 4000)
    assert every_second == pytest.approx(-1 / math.log(0.98), rel=0.15)


def test_a_slow_error_under_a_larger_fast_one_is_found() -> None:
    """Errors of 2 s and, at a third of their size, of 200 s, over 4 hours at 10 Hz."""
    generator = np.random.default_rng(5)
    n = 144_000

    def errors(time_s: float) -> np.ndarray:
        phi = math.exp(-0.1 / time_s)
        made = lfilter([1.0], [1.0, -phi], generator.normal(size=n + 20_000))[20_000:]
        return made / made.std()

    mixed = errors(2.0) + 0.3 * errors(200.0)
    index = np.arange(n)
    assert correlation_time(mixed, index, 6000) < 100
    slowest = slowest_correlation_time(mixed, index, 6000, 150)
    assert slowest > 500
    # Two hours without a sample, in which there is no mean.
    apart = index + np.where(index < n // 2, 0, 72_000)
    assert slowest_correlation_time(mixed, apart, 6000, 150) == pytest.approx(slowest, rel=0.1)
    # Cells of unlike numbers of samples, about a level.
    kept = generator.random(n) < 0.8
    found = slowest_correlation_time(5.0 + mixed[kept], index[kept], 6000, 150)
    assert found == pytest.approx(slowest, rel=0.1)
    fast = errors(2.0)
    assert slowest_correlation_time(fast, index, 6000, 150) == pytest.approx(20.0, rel=0.15)


def test_errors_without_spread_have_no_memory() -> None:
    assert correlation_time(np.full(100, 3.0), np.arange(100), 10) == 0.0


@pytest.mark.parametrize(
    ("period_s", "n", "rounding", "expected"),
    [
        # A cosine falls to 1/e of itself within 0.190 of its period; looked for up to ten minutes.
        (1000.0, 14_000, 0.0, 190.0),
        (3100.0, 15_500, 0.0, 590.0),
        (3250.0, 16_250, 0.0, math.inf),
        (2.0, 14_000, 0.0, 0.0),
        (1000.0, 14_000, 1.01, 0.0),
        (1000.0, 7, 0.0, 0.0),
    ],
)
def test_memory_in_seconds(period_s: float, n: int, rounding: float, expected: float) -> None:
    error = np.cos(2.0 * np.pi / period_s * np.arange(n))
    found = memory_s(error, np.arange(n), 1.0, rounding)
    # With the removed mean of so many samples taken for a loss of 4/n.
    corrected = 1.0 / (1.0 / expected - 4.0 / n) if 0.0 < expected < math.inf else expected
    assert found == pytest.approx(corrected, rel=0.05)

"""Autocorrelation of errors and sums of lagged products, against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from leakage.estimation.correlation import (
    autocorrelation,
    correlation_time,
    memory_s,
    slowest_correlation_time,
)
from leakage.estimation.lagged_products import Segments, lagged_products, products_near_ends


def test_it_equals_the_sum_over_pairs_that_exist() -> None:
    generator, n = np.random.default_rng(1), 70
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


Array = NDArray[np.float64]


def places(lengths: list[int], gap: int = 1) -> NDArray[np.int64]:
    """Stretches of samples with `gap` missing ones between them, from place 7 on."""
    parts, begin = [], 7
    for length in lengths:
        parts.append(np.arange(begin, begin + length))
        begin += length + gap
    return np.concatenate(parts)


def by_definition(a: Array, b: Array, lengths: list[int], lags: range) -> list[float]:
    """Each pair of samples of a segment, one lag after the other."""
    ends = np.cumsum(lengths)[:-1]
    parts = list(zip(np.split(a, ends), np.split(b, ends), strict=True))

    def sum_at(lag: int) -> float:
        ahead, behind = max(lag, 0), max(-lag, 0)
        return sum(
            float(one[behind : len(one) - ahead] @ other[ahead : len(one) - behind])
            for one, other in parts
            if abs(lag) < len(one)
        )

    return [sum_at(lag) for lag in lags]


def assert_by_definition(
    series: Array, lengths: list[int], segments: Segments, longest: int, crossed_lag: int
) -> None:
    """Sums of two series, each with itself and the first with the second."""
    own, crossed = lagged_products(series, [0.0, 0.0], segments, longest, crossed_lag)
    ahead = range(longest + 1)
    expected = [by_definition(one, one, lengths, ahead) for one in series]
    assert own == pytest.approx(np.array(expected), abs=1e-9)
    expected = [by_definition(*series, lengths, range(-crossed_lag, crossed_lag + 1))]
    assert crossed == pytest.approx(np.array(expected), abs=1e-9)


@settings(max_examples=60)
@given(
    lengths=st.lists(st.integers(1, 90), min_size=1, max_size=12),
    longest=st.integers(0, 120),
    crossed_share=st.floats(0.0, 1.0),
    gap=st.integers(1, 30),
    seed=st.integers(0, 1000),
)
def test_short_segments(
    lengths: list[int], longest: int, crossed_share: float, gap: int, seed: int
) -> None:
    series = np.random.default_rng(seed).normal(size=(2, sum(lengths)))
    segments = Segments.of(places(lengths, gap))
    assert_by_definition(series, lengths, segments, longest, int(crossed_share * longest))


@pytest.mark.parametrize("longest", [0, 1, 25, 350])
@pytest.mark.parametrize(
    "lengths",
    [
        [50_000],
        [1, 2048, 2047, 2049, 1, 16, 17, 4096],
        [33_000, 3, 16_384, 1023, 16_385],
        [40] * 3000,
    ],
)
def test_segments_of_many_pieces(lengths: list[int], longest: int) -> None:
    """Around powers of two, where transforms change their length; more than are made at a time."""
    series = np.random.default_rng(1).normal(size=(2, sum(lengths)))
    assert_by_definition(series, lengths, Segments.of(places(lengths)), longest, min(longest, 25))


@given(
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=12),
    margin=st.integers(1, 12),
    seed=st.integers(0, 1000),
)
def test_products_near_the_ends(lengths: list[int], margin: int, seed: int) -> None:
    """Those of a first series that is zero elsewhere."""
    series = np.random.default_rng(seed).normal(size=(2, sum(lengths)))
    near = [(np.arange(n) < margin) | (np.arange(n) >= n - margin) for n in lengths]
    first = series * [np.concatenate(near), np.ones(sum(lengths))]
    found = products_near_ends(series, [0.0, 0.0], Segments.of(places(lengths)), margin)
    expected = by_definition(*first, lengths, range(-margin, margin + 1))
    assert found == pytest.approx(np.array([expected]), abs=1e-10)


@given(
    lengths=st.lists(st.integers(1, 40), min_size=1, max_size=12),
    gap=st.integers(1, 5),
    margin=st.integers(0, 12),
)
def test_segments_tell_what_they_hold(lengths: list[int], gap: int, margin: int) -> None:
    index = places(lengths, gap)
    segments = Segments.of(index)
    assert segments.lengths.tolist() == lengths
    assert segments.n == len(index) == sum(lengths)
    pairs = [sum(max(n - lag, 0) for n in lengths) for lag in range(50)]
    assert segments.pair_counts(49).tolist() == pairs
    inner = np.concatenate(
        [(np.arange(n) >= margin) & (np.arange(n) < n - margin) for n in lengths]
    )
    kept = segments.without_ends(margin)
    assert kept.samples(np.arange(kept.n)).tolist() == np.flatnonzero(inner).tolist()


def test_no_segment() -> None:
    nothing = Segments.of(np.arange(5)).without_ends(3)
    assert nothing.n == 0
    assert nothing.pair_counts(2).tolist() == [0, 0, 0]
    assert not len(nothing.samples(np.arange(0)))
    assert not lagged_products(np.ones((1, 5)), [0.0], nothing, 2)[0].any()

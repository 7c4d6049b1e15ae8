"""Sums of lagged products: against the definition, pair by pair, over segments of any length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.estimation.lagged_products import Segments, lagged_products, products_near_ends

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
    "lengths", [[50_000], [1, 2048, 2047, 2049, 1, 16, 17, 4096], [33_000, 3, 16_384, 1023, 16_385]]
)
def test_segments_of_many_pieces(lengths: list[int], longest: int) -> None:
    """Around powers of two, where transforms change their length."""
    series = np.random.default_rng(1).normal(size=(2, sum(lengths)))
    assert_by_definition(series, lengths, Segments.of(places(lengths)), longest, min(longest, 25))


def test_more_segments_than_are_transformed_at_a_time() -> None:
    lengths = [40] * 3000
    series = np.random.default_rng(2).normal(size=(2, sum(lengths)))
    assert_by_definition(series, lengths, Segments.of(places(lengths)), 25, 0)


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

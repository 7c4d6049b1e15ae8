"""Sums of lagged products: against the definition, pair by pair, over segments of any length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.estimation.lagged_products import Segments, lagged_products, products_near_ends

Array = NDArray[np.float64]
PAIRS = [(0, 0), (1, 1), (0, 1), (1, 0)]


def places(lengths: list[int], gap: int = 1) -> NDArray[np.int64]:
    """Stretches of samples with `gap` missing ones between them, from place 7 on."""
    parts, begin = [], 7
    for length in lengths:
        parts.append(np.arange(begin, begin + length))
        begin += length + gap
    return np.concatenate(parts)


def by_definition(series: Array, lengths: list[int], longest: int, behind: int) -> Array:
    """Each pair of samples of a segment, one lag after the other."""
    sums = np.zeros((len(PAIRS), behind + 1 + longest))
    for part in np.split(series, np.cumsum(lengths)[:-1], axis=1):
        n = part.shape[1]
        for lag in range(max(-behind, 1 - n), min(longest, n - 1) + 1):
            for row, (a, b) in enumerate(PAIRS):
                first, second = part[a, max(-lag, 0) :], part[b, max(lag, 0) :]
                sums[row, behind + lag] += first[: n - abs(lag)] @ second[: n - abs(lag)]
    return sums


@settings(max_examples=60)
@given(
    lengths=st.lists(st.integers(1, 90), min_size=1, max_size=12),
    longest=st.integers(0, 120),
    share_behind=st.floats(0.0, 1.0),
    gap=st.integers(1, 30),
    seed=st.integers(0, 1000),
)
def test_short_segments(
    lengths: list[int], longest: int, share_behind: float, gap: int, seed: int
) -> None:
    series = np.random.default_rng(seed).normal(size=(2, sum(lengths)))
    segments, behind = Segments.of(places(lengths, gap)), int(share_behind * longest)
    found = lagged_products(series, segments, longest, PAIRS, behind)
    assert found == pytest.approx(by_definition(series, lengths, longest, behind), abs=1e-10)


@pytest.mark.parametrize("longest", [0, 1, 25, 350])
@pytest.mark.parametrize(
    "lengths", [[20_000], [1, 2048, 2047, 2049, 1, 16, 17, 4096], [9000, 3, 5000, 1023, 1024, 1025]]
)
def test_segments_of_many_chunks(lengths: list[int], longest: int) -> None:
    """Around powers of two, where transforms change their length."""
    series = np.random.default_rng(1).normal(size=(2, sum(lengths)))
    behind = min(longest, 25)
    found = lagged_products(series, Segments.of(places(lengths)), longest, PAIRS, behind)
    assert found == pytest.approx(by_definition(series, lengths, longest, behind), abs=1e-9)


def test_more_chunks_than_are_transformed_at_a_time() -> None:
    lengths = [40] * 3000
    series = np.random.default_rng(2).normal(size=(2, sum(lengths)))
    found = lagged_products(series, Segments.of(places(lengths)), 25, PAIRS)
    assert found == pytest.approx(by_definition(series, lengths, 25, 0), abs=1e-9)


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
    found = products_near_ends(series, Segments.of(places(lengths)), margin)
    expected = by_definition(first, lengths, margin, margin)[PAIRS.index((0, 1))]
    assert found == pytest.approx(expected[None], abs=1e-10)


def test_lags_longer_than_every_segment_have_no_sum() -> None:
    found = lagged_products(np.ones((1, 30)), Segments.of(places([10, 20])), 25, [(0, 0)])
    assert found[0, :20] == pytest.approx(np.maximum(10 - np.arange(20), 0) + 20 - np.arange(20))
    assert found[0, 20:] == pytest.approx(0.0, abs=1e-12)


def test_what_lies_across_a_gap_is_not_touched() -> None:
    """A huge value in one segment leaves no trace in the sums of the others."""
    generator = np.random.default_rng(3)
    series = generator.normal(size=(2, 500))
    silent = series.copy()
    silent[:, 200:230] = 0.0
    loud = silent.copy()
    loud[0, 200:230] = 1e6  # its partner is silent there: within the segment it adds nothing
    index = places([200, 30, 270])
    lags = [(0, 1), (1, 0)]
    found = lagged_products(loud, Segments.of(index), 60, lags)
    assert found == pytest.approx(lagged_products(silent, Segments.of(index), 60, lags), abs=1e-7)


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
    assert not lagged_products(np.ones((1, 5)), nothing, 2, [(0, 0)]).any()

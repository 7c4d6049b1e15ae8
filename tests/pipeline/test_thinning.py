"""Thinning keeps every extreme, in as few rows as were asked for."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.arrays import keep_extremes

COLUMNS = arrays(
    np.float64,
    st.tuples(st.integers(1, 400), st.integers(1, 4)),
    elements=st.one_of(st.floats(-1e6, 1e6), st.just(np.nan)),
)


@given(columns=COLUMNS, points=st.integers(10, 80))
def test_rows_are_few_from_end_to_end_and_each_column_keeps_its_extremes(
    columns: np.ndarray, points: int
) -> None:
    kept = keep_extremes(columns.T, points)
    assert len(kept) <= points
    assert len(kept) == len(columns) or len(columns) > points
    assert (np.diff(kept) > 0).all()
    assert (kept[0], kept[-1]) == (0, len(columns) - 1)
    for whole, thinned in zip(columns.T, columns[kept].T, strict=True):
        if not np.isnan(whole).all():
            assert np.nanmin(thinned) == np.nanmin(whole)
            assert np.nanmax(thinned) == np.nanmax(whole)


def test_what_fits_is_left_as_it_is() -> None:
    assert keep_extremes(np.zeros((2, 7)), 7).tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert keep_extremes(np.zeros((2, 0)), 7).tolist() == []


def test_each_bin_keeps_its_own_extremes() -> None:
    """Of ten bins of a hundred rows each, a peak up in one and down in the next."""
    flow = np.zeros(1000)
    flow[[150, 270]] = 5.0, -5.0
    flow[777] = 0.5
    kept = keep_extremes([flow], 22).tolist()
    assert {150, 270, 777} <= set(kept)

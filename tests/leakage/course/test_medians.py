"""Medians of rows, by NumPy one row at a time, and of the other motors of an oil circuit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leakage.course.medians import medians_of_others, row_medians


@pytest.mark.parametrize("width", [1, 2, 5, 10])
def test_each_row_is_numpys_median_of_what_is_there(width: int) -> None:
    generator = np.random.default_rng(width)
    values = generator.normal(size=(300, width))
    values[generator.random(values.shape) < 0.4] = np.nan
    expected = [
        np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in values
    ]
    np.testing.assert_array_equal(row_medians(values), expected)


@given(
    arrays(
        np.float64,
        st.tuples(st.integers(1, 4), st.integers(2, 7)),
        # Ties are many.
        elements=st.sampled_from([np.nan, -1.5, 0.0, 0.0, 2.0, 3.25]),
    )
)
def test_one_sorting_gives_what_leaving_out_each_gives(values: np.ndarray) -> None:
    medians, numbers = medians_of_others(values)
    for motor in range(values.shape[1]):
        rest = np.delete(values, motor, axis=1)
        assert np.array_equal(medians[:, motor], row_medians(rest), equal_nan=True)
        assert numbers[:, motor].tolist() == np.isfinite(rest).sum(axis=1).tolist()

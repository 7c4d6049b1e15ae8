"""Medians of rows, by NumPy one row at a time."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.course.medians import row_medians


@pytest.mark.parametrize("width", [1, 2, 5, 10])
def test_each_row_is_numpys_median_of_what_is_there(width: int) -> None:
    generator = np.random.default_rng(width)
    values = generator.normal(size=(300, width))
    values[generator.random(values.shape) < 0.4] = np.nan
    expected = [
        np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in values
    ]
    np.testing.assert_array_equal(row_medians(values), expected)

"""Medians of many short rows at once."""

from __future__ import annotations

import numpy as np

from leakage.course.autoregression import Array


def row_medians(values: Array) -> Array:
    """Median of each row over the values that are there, shape (n,); nan for a row without values.

    Examples
    --------
    >>> row_medians(np.array([[3.0, np.nan, 1.0, 2.0], [1.0, np.nan, np.nan, 2.0]])).tolist()
    [2.0, 1.5]
    """
    # nan comes last.
    ordered = np.sort(values, axis=1)
    rows, n = np.arange(len(values)), np.count_nonzero(~np.isnan(values), axis=1)
    medians: Array = (ordered[rows, np.maximum(n - 1, 0) // 2] + ordered[rows, n // 2]) / 2
    return medians

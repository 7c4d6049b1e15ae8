"""Medians of many short rows at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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


def medians_of_others(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Median of each row without the entry itself, for every entry, from one sorting of the row.

    Parameters
    ----------
    values
        Shape (n, m) with m ≥ 1; nan where there is none.

    Returns
    -------
    medians
        Shape (n, m); nan where there is no other value.
    numbers
        Other values of each entry, shape (n, m).

    Examples
    --------
    >>> medians, numbers = medians_of_others(np.array([[1.0, 3.0, 8.0, np.nan]]))
    >>> medians.tolist(), numbers.tolist()
    ([[5.5, 4.5, 2.0, 3.0]], [[2, 2, 2, 3]])
    """
    # nan comes last.
    order = np.argsort(values, axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    places = np.broadcast_to(np.arange(values.shape[1]), values.shape)
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, places, axis=1)
    known = ~np.isnan(values)
    numbers: NDArray[np.int64] = known.sum(axis=1, keepdims=True) - known

    def without_itself(place: NDArray[np.int64]) -> Array:
        moved = np.minimum(place + (place >= rank), values.shape[1] - 1)
        return np.take_along_axis(ordered, moved, axis=1)

    low, high = np.maximum(numbers - 1, 0) // 2, numbers // 2
    medians = (without_itself(low) + without_itself(high)) / 2
    return np.where(numbers > 0, medians, np.nan), numbers

"""Arrays that the stages pass on, the unit of their time stamps, and fewer points for plots."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
"""Numbers of any shape."""

Values = NDArray[np.float64]
"""Readings, shape (n,)."""

Times = NDArray[np.int64]
"""UTC microseconds since 1970, shape (n,)."""

Mask = NDArray[np.bool_]
"""Which of n samples, shape (n,)."""

Rows = slice | NDArray[np.bool_] | NDArray[np.intp]
"""Some rows of an array."""

SECOND_US = 1_000_000


def chosen_rows(mask: Mask) -> slice | NDArray[np.intp]:
    """The rows of a mask as a slice where they follow each other: what it takes is no copy.

    Else by their places, which take a third of the time that a mask does.

    Examples
    --------
    >>> chosen_rows(np.array([False, True, True]))
    slice(1, 3, None)
    >>> chosen_rows(np.array([True, False, True]))
    array([0, 2])
    """
    first, n = int(mask.argmax()) if len(mask) else 0, int(np.count_nonzero(mask))
    return slice(first, first + n) if mask[first : first + n].all() else np.flatnonzero(mask)


def keep_extremes(columns: Sequence[ArrayLike], points: int) -> NDArray[np.int64]:
    """Rows to plot: of each bin of neighbours the smallest and the largest value of each column.

    Columns are of shape (n,), NaN where there is no value. Returned are the places of at most
    `points` rows, increasing, the first and the last among them. A line through the kept rows
    covers the pixels that a line through all of them would, as long as no bin is wider than a
    pixel.

    Raises ValueError if `points` does not suffice for the ends and one bin.

    Examples
    --------
    A single peak among 10 000 rows stays:

    >>> flow = np.zeros(10_000)
    >>> flow[4321] = 1.0
    >>> rows = keep_extremes([flow], 100)
    >>> len(rows) <= 100, 4321 in rows
    (True, True)
    """
    curves = [np.ascontiguousarray(column, dtype=np.float64) for column in columns]
    n, c = len(curves[0]), len(curves)
    if n <= points:
        return np.arange(n)
    n_bins = (points - 2) // (2 * c)
    if n_bins < 1:
        raise ValueError(f"expected at least {2 * c + 2} points for {c} columns, got {points}")
    borders = np.linspace(0, n, n_bins + 1).round().astype(np.int64).tolist()
    rows = [0, n - 1]
    for curve in curves:
        extremes = _extremes(curve, curve, borders)
        # What is missing would be the smallest and the largest of its bin.
        if np.isnan(curve[extremes]).any():
            missing = np.isnan(curve)
            low, high = (np.where(missing, limit, curve) for limit in (np.inf, -np.inf))
            extremes = _extremes(low, high, borders)
        rows += extremes
    return np.unique(rows)


def _extremes(
    low: NDArray[np.float64], high: NDArray[np.float64], borders: Sequence[int]
) -> list[int]:
    """Place of the smallest of a series and the largest of another in each bin."""
    places: list[int] = []
    for begin, end in pairwise(borders):
        places += (begin + int(low[begin:end].argmin()), begin + int(high[begin:end].argmax()))
    return places

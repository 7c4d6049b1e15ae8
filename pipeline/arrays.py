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
    """Return the rows of a mask as a slice where they follow each other: what it takes is no copy.

    Else their places, which take a third of the time that a mask does.
    """
    first, n = int(mask.argmax()) if len(mask) else 0, int(np.count_nonzero(mask))
    return slice(first, first + n) if mask[first : first + n].all() else np.flatnonzero(mask)


def keep_extremes(columns: Sequence[ArrayLike], points: int) -> NDArray[np.int64]:
    """Return places of rows to plot: of each bin of neighbours the extremes of each column.

    At most `points`, the first and the last row among them. A line through them covers the pixels
    that a line through all rows would, as long as no bin is wider than a pixel. NaN is no value.

    Raises ValueError if `points` does not suffice for the ends and a bin.
    """
    curves = [np.ascontiguousarray(column, dtype=np.float64) for column in columns]
    n, c = len(curves[0]), len(curves)
    if n <= points:
        return np.arange(n)
    n_bins = (points - 2) // (2 * c)
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

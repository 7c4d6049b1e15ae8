"""Thinning for plots: fewer points of the same course, with every extreme still among them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray


def keep_extremes(columns: Sequence[ArrayLike], points: int) -> NDArray[np.int64]:
    """Rows to plot: of each bin of neighbours the smallest and the largest value of each column.

    Columns are of shape (n,), NaN where there is no value. Returned are the places of at most
    `points` rows, increasing, the first and the last among them. A line through the kept rows
    covers the pixels that a line through all of them would, as long as a bin is no wider than one.

    Raises ValueError if `points` does not suffice for the ends and one bin.

    Examples
    --------
    A single peak among 10 000 rows stays:

    >>> flow = np.zeros(10_000)
    >>> flow[4321] = 1.0
    >>> kept = keep_extremes([flow], 100)
    >>> len(kept) <= 100, 4321 in kept
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
    kept = [0, n - 1]
    for curve in curves:
        found = _extremes(curve, curve, borders)
        # What is missing would be the smallest and the largest of its bin.
        if np.isnan(curve[found]).any():
            missing = np.isnan(curve)
            low, high = (np.where(missing, limit, curve) for limit in (np.inf, -np.inf))
            found = _extremes(low, high, borders)
        kept += found
    return np.unique(kept)


def _extremes(
    low: NDArray[np.float64], high: NDArray[np.float64], borders: Sequence[int]
) -> list[int]:
    """Place of the smallest of one series and the largest of another in each bin."""
    found: list[int] = []
    for begin, end in pairwise(borders):
        found += (begin + int(low[begin:end].argmin()), begin + int(high[begin:end].argmax()))
    return found

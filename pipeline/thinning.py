"""Thinning for plots: fewer points of the same course, with every extreme still among them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray


def keep_extremes(columns: Sequence[ArrayLike], points: int) -> NDArray[np.int64]:
    """Rows to plot: of each bin of neighbours the smallest and the largest value of each column.

    Parameters
    ----------
    columns
        What is plotted over the rows, each of shape (n,); NaN where there is no value.
    points
        Rows to keep at most; where there are no more, all are kept.

    Returns
    -------
    ndarray
        Places of the rows, increasing, at most `points` of them; the first and the last row are
        always there.

    Raises
    ------
    ValueError
        If `points` does not suffice for the ends and one bin.

    Notes
    -----
    Every column's smallest and largest value over all rows are kept, and so are each bin's: a
    line through the kept rows covers the pixels that a line through all of them would, as long as
    a bin is no wider than a pixel.

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
        low = high = curve
        # The smallest is nan where any is, without a mask of all.
        if np.isnan(curve.min()):
            missing = np.isnan(curve)
            low, high = np.where(missing, np.inf, curve), np.where(missing, -np.inf, curve)
        for begin, end in pairwise(borders):
            kept += (begin + low[begin:end].argmin(), begin + high[begin:end].argmax())
    return np.unique(kept)

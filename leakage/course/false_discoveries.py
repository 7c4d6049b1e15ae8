"""Tests of many hypotheses at once, such as the slopes of a fleet.

References
----------
.. [1] Y. Benjamini and Y. Hochberg, "Controlling the false discovery rate", *Journal of the Royal
   Statistical Society B*, 57(1), 1995.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def benjamini_hochberg(p_values: Array) -> Array:
    """q-values: the false discovery rate at which each hypothesis would just be told [1]_.

    A p that is nan does not count, and its q is nan.

    Examples
    --------
    >>> benjamini_hochberg(np.array([0.01, 0.04, np.nan, 0.03])).round(6).tolist()
    [0.03, 0.04, nan, 0.04]
    """
    q_values = np.full(len(p_values), np.nan)
    known = np.flatnonzero(np.isfinite(p_values))
    if not len(known):
        return q_values
    order = known[np.argsort(p_values[known], kind="stable")]
    scaled = p_values[order] * len(order) / np.arange(1, len(order) + 1)
    q_values[order] = np.minimum(np.minimum.accumulate(scaled[::-1])[::-1], 1.0)
    return q_values

"""Arrays that the stages pass on, and the unit of their time stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    """The rows of a mask as a slice where they follow one another: what it takes is no copy.

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

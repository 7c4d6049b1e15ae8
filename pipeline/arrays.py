"""Arrays that the stages pass on, and the unit of their time stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
"""Readings, shape (n,)."""

Times = NDArray[np.int64]
"""UTC microseconds since 1970, shape (n,)."""

Mask = NDArray[np.bool_]
"""Which of n samples, shape (n,)."""

SECOND_US = 1_000_000

"""Nightly indicators made for tests."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def autoregression(n: int, phi: float, generator: np.random.Generator) -> Array:
    """Stationary, of unit variance, by its own definition."""
    values = np.empty(n)
    values[0] = generator.standard_normal()
    for night in range(1, n):
        fresh = generator.standard_normal() * math.sqrt(1 - phi**2)
        values[night] = phi * values[night - 1] + fresh
    return values

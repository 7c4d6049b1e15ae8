"""Made series of errors and inputs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
Generator = np.random.Generator


def autoregression(phi: float, n: int, generator: Generator) -> Array:
    """Stationary AR(1) of unit variance."""
    start = [phi * generator.normal()]
    series, _ = lfilter([math.sqrt(1 - phi * phi)], [1.0, -phi], generator.normal(size=n), zi=start)
    return np.asarray(series)

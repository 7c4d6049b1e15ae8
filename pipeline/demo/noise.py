"""Noise with a memory, along the first axis, which is time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]


def phi_of(step_s: float, time_constant_s: float) -> float:
    """Return coefficient of a first-order autoregression: φ = exp(−Δt/τ), both times in [s]."""
    return float(np.exp(-step_s / time_constant_s))


def autoregression(white: FloatArray, phi: float) -> FloatArray:
    r"""First-order autoregression of independent values, shape (n, ...), in its stationary state.

    .. math:: x_0 = w_0, \quad x_k = \varphi x_{k-1} + \sqrt{1 - \varphi^2}\,w_k
    """
    driven = white * np.sqrt(1.0 - phi**2)
    driven[:1] = white[:1]
    return np.asarray(lfilter([1.0], [1.0, -phi], driven, axis=0), dtype=np.float64)


def correlated_noise(
    generator: np.random.Generator, samples: int, step_s: float, time_constant_s: float
) -> FloatArray:
    """Autoregression of unit variance, shape (samples,), by its step and time constant [s]."""
    return autoregression(generator.standard_normal(samples), phi_of(step_s, time_constant_s))

"""Noise with a memory, for the simulated sensors.

Pure functions along the first axis, which is time; series side by side share a call. Randomness
comes as white noise of unit variance or as a generator.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]


def phi_of(step_s: float, time_constant_s: float) -> float:
    """Coefficient of a first-order autoregression: φ = exp(−Δt/τ), both times in [s]."""
    return float(np.exp(-step_s / time_constant_s))


def autoregression(white: FloatArray, phi: float) -> FloatArray:
    r"""First-order autoregression in its stationary state, of the variance of its white noise.

    .. math:: x_0 = w_0, \quad x_k = \varphi x_{k-1} + \sqrt{1 - \varphi^2}\,w_k

    `white` are independent values of zero mean, shape (n, ...); the correlation at lag k is φ^k.
    """
    driven = white * np.sqrt(1.0 - phi**2)
    driven[:1] = white[:1]
    return np.asarray(lfilter([1.0], [1.0, -phi], driven, axis=0), dtype=np.float64)


def correlated_noise(
    generator: np.random.Generator, samples: int, step_s: float, time_constant_s: float
) -> FloatArray:
    """Autoregression of unit variance, shape (samples,), by its step and time constant [s]."""
    return autoregression(generator.standard_normal(samples), phi_of(step_s, time_constant_s))

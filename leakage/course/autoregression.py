r"""Errors that remember from night to night: a first-order autoregression on uneven nights.

With φ the correlation of neighbouring nights, two nights that lie Δt apart correlate with

.. math:: \rho = \varphi^{\Delta t} ,

so a night without a value only lets the memory fade. Everything below needs the number of each
night, not an even series.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Nights = NDArray[np.int64]

# Above this, a series of nights is hardly told from a trend.
HIGHEST_PHI = 0.95
# Pairs of residuals that an estimate of φ needs.
LEAST_PAIRS = 10


def correlation_to_previous(phi: float, nights: Nights) -> Array:
    """φ^Δt of each night to the one before, shape (n,); 0 for the first."""
    rho = np.zeros(len(nights))
    rho[1:] = phi ** np.diff(nights)
    return rho


def whitened(columns: Array, rho: Array) -> Array:
    r"""Prais and Winsten's transform [1]_: columns whose errors no longer remember.

    .. math:: x^*_1 = x_1, \qquad x^*_t = \frac{x_t - \rho_t x_{t-1}}{\sqrt{1 - \rho_t^2}}

    The errors keep their variance, which on uneven nights the usual form without the root would not
    do. `columns` have shape (n,) or (n, k); ρ is the correlation of each night to the one before.

    References
    ----------
    .. [1] S. J. Prais and C. B. Winsten, "Trend estimators and serial correlation", Cowles
       Commission Discussion Paper 383, 1954.
    """
    shape = (-1,) + (1,) * (columns.ndim - 1)
    before = np.empty_like(columns)
    before[1:] = columns[:-1]
    before[:1] = 0.0
    result: Array = (columns - rho.reshape(shape) * before) / np.sqrt(1 - rho**2).reshape(shape)
    return result


def estimated_phi(residuals: Array, nights: Nights) -> float:
    r"""Correlation of neighbouring nights, from the residuals of a straight line.

    The correlation of nights that follow each other at the commonest distance d is corrected for
    what a fitted line takes away of it [1]_, and brought to one night:

    .. math:: \hat\varphi = \Big(r_d + \frac{2 + 4 r_d}{n}\Big)^{1/d}, \qquad
       0 \le \hat\varphi \le 0.95 .

    0 where fewer than ten pairs lie at the commonest distance, or nothing scatters.

    References
    ----------
    .. [1] P. Shaman and R. A. Stine, "The bias of autoregressive coefficient estimators",
       *Journal of the American Statistical Association*, 83(403), 1988.
    """
    n = len(residuals)
    spread = float(residuals @ residuals) / n if n else 0.0
    distances = np.diff(nights)
    if n <= LEAST_PAIRS or spread <= 0.0:
        return 0.0
    distance = int(np.argmax(np.bincount(distances)))
    at = distances == distance
    if int(at.sum()) < LEAST_PAIRS:
        return 0.0
    correlation = float(np.mean(residuals[1:][at] * residuals[:-1][at])) / spread
    corrected = min(max(correlation + (2 + 4 * correlation) / n, 0.0), HIGHEST_PHI)
    return float(min(corrected ** (1.0 / distance), HIGHEST_PHI))


def variance_of_mean(phi: float, nights: Nights) -> float:
    """Variance of the plain mean of nights, shape (n,), in units of the variance of one."""
    if phi <= 0.0:
        return 1.0 / len(nights)
    return float(np.mean(phi ** np.abs(nights[:, None] - nights)))

r"""Rate of change of an indicator, with an interval, by generalised least squares.

The errors are autoregressive of the first order, in the transform of Prais and Winsten: φ from the
residuals of ordinary least squares, corrected for its bias, φ^Δt across missing nights, and n − 3
degrees of freedom.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage.arrays import Array

Nights = NDArray[np.int64]

# Above this, a series of nights hardly differs from a trend.
HIGHEST_PHI = 0.95
# Pairs of residuals that an estimate of φ needs.
LEAST_PAIRS = 10


def correlation_to_previous(phi: float, nights: Nights) -> Array:
    """Return φ^Δt of each night to the one before, shape (n,); 0 for the first."""
    rho = np.zeros(len(nights))
    rho[1:] = phi ** np.diff(nights)
    return rho


def whitened(columns: Array, rho: Array) -> Array:
    r"""Return Prais and Winsten's transform [1]_: columns whose errors no longer remember.

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
    r"""Return correlation of neighbouring nights, from the residuals of a straight line.

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
    """Return variance of the plain mean of nights, shape (n,), in units of the variance of one."""
    if phi <= 0.0:
        return 1.0 / len(nights)
    return float(np.mean(phi ** np.abs(nights[:, None] - nights)))


SlopeStatus: TypeAlias = Literal["ok", "provisional", "too_few_nights", "no_scatter", "no_span"]

LEAST_NIGHTS = 20
SURE_NIGHTS = 60
# Parameters that cost a degree of freedom: level, slope and φ.
PARAMETERS = 3
# Scatter below this share of the values is rounding.
RELATIVE_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Slope:
    """A straight line through the nights of an indicator."""

    # ``ok``; ``provisional`` below 60 nights; otherwise why there is no line: ``too_few_nights``
    # (below 20) or ``no_span`` (all at one position). ``no_scatter``: the nights lie on a line to
    # within rounding, which has no interval.
    status: SlopeStatus
    n: int  # Nights that count.
    # slope, lower, upper: Generalised least squares, and its interval [unit a unit of position].
    slope: float | None = None
    lower: float | None = None
    upper: float | None = None
    phi: float | None = None  # Correlation of neighbouring nights.


def fit_slope(
    nights: Nights, values: Array, position: Array | None = None, coverage: float = 0.95
) -> Slope:
    """Return slope of an indicator over time or running hours, with an interval that holds.

    Simulated coverage of 95 % intervals: 92 to 96 % for 60 nights or more and φ up to 0.6; 86 % for
    20 nights and φ = 0.6, which is why those are provisional.

    `nights, values`: Numbers of the nights, increasing, which say how far errors remember, and the
    indicator, shape (n,); nights that are not finite do not count.
    `position`: What the slope is per unit of, such as running hours, shape (n,); None: the nights.
    `coverage`: Of the interval.
    """
    x = nights.astype(np.float64) if position is None else position
    kept = np.isfinite(values) & np.isfinite(x)
    n = int(kept.sum())
    if n < LEAST_NIGHTS:
        return Slope("too_few_nights", n)
    nights, values, x = nights[kept], values[kept], x[kept]
    if not np.ptp(x) > 0.0:
        return Slope("no_span", n)
    columns = np.column_stack([np.ones(n), values, x - float(np.mean(x))])
    line = CourseFits.of(columns)
    residuals = line.residuals(0)
    if float(np.std(residuals)) <= RELATIVE_ROUNDING * float(np.max(np.abs(values))):
        return Slope("no_scatter", n, slope=float(line.slopes[0]), phi=0.0)
    phi = estimated_phi(residuals, nights)
    line = CourseFits.of(whitened(columns, correlation_to_previous(phi, nights)))
    slope, errors, freedom = float(line.slopes[0]), line.residuals(0), n - PARAMETERS
    error = math.sqrt(float(errors @ errors) / freedom / float(line.spans[0]))
    half = float(stdtrit(freedom, 0.5 + coverage / 2)) * error
    return Slope(
        status="ok" if n >= SURE_NIGHTS else "provisional",
        n=n,
        slope=slope,
        lower=slope - half,
        upper=slope + half,
        phi=phi,
    )


@dataclass(frozen=True, slots=True)
class CourseFits:
    """Least squares of a level and of each of some courses in turn.

    `length` is the squared length of the column of the level, `level` and `middles` the means of
    the values and of each course, weighted by it; `slopes` and `spans` each course's coefficient
    and squared length about its middle; `centred`, shape (n, 1 + s), values and courses less the
    part of the level.
    """

    length: float
    level: float
    middles: Array
    slopes: Array
    spans: Array
    centred: Array

    @classmethod
    def of(cls, columns: Array) -> CourseFits:
        """Regressions on columns of the level, the values and the courses, shape (n, 2 + s)."""
        ones = columns[:, 0]
        length = float(ones @ ones)
        means = ones @ columns[:, 1:] / length
        centred = columns[:, 1:] - np.outer(ones, means)
        spans = np.einsum("ij,ij->j", centred[:, 1:], centred[:, 1:])
        slopes = centred[:, 0] @ centred[:, 1:] / spans
        return cls(length, float(means[0]), means[1:], slopes, spans, centred)

    def residuals(self, course: int) -> Array:
        """Return residuals of one of the courses, shape (n,)."""
        left: Array = self.centred[:, 0] - self.slopes[course] * self.centred[:, 1 + course]
        return left

"""Zeros of pressure and flow sensors while the motor stands still, and whether they drift.

In a halt without pressure, once it has settled, pressure difference and drain flow are zero, so
what the sensors say is their error. A drift of 0.02 l/min moves the piston rings' K by 11 %: a
sensor that drifts has to be named before wear is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage.autoregression import Array
from leakage.errors import ParameterError, ShapeError

HaltStatus: TypeAlias = Literal["ok", "too_short", "not_settled"]
DriftStatus: TypeAlias = Literal["insufficient", "steady", "drifts"]

# Samples of a halt are correlated; means over an eighth of it hardly are.
BATCHES = 8
LEAST_SAMPLES = 80
# Halts at the beginning, and as many at the end, that a drift is told from.
LEAST_HALTS = 5
MOST_HALTS = 30
COVERAGE = 0.95


@dataclass(frozen=True, slots=True)
class HaltZero:
    """What a sensor said in one halt.

    Attributes
    ----------
    status
        ``ok``; ``too_short``; ``not_settled``: it still moved from one half of the halt to the
        other, by more than its errors and its resolution.
    zero
        Mean [unit]; nan unless ``ok``.
    standard_error
        Of the mean, with what the resolution hides [unit]; nan unless ``ok``.
    """

    status: HaltStatus
    zero: float
    standard_error: float


@dataclass(frozen=True, slots=True)
class ZeroDrift:
    """How far a sensor's zero has moved.

    Attributes
    ----------
    status
        ``drifts`` where the move is certain and beyond the tolerance, ``steady`` where it is not,
        ``insufficient`` with fewer than ten halts.
    zero, lower, upper
        Zero now, and its 95 % interval [unit].
    change, change_lower, change_upper
        Zero now less zero at first, and its 95 % interval [unit].
    n_halts
        Halts that count.
    """

    status: DriftStatus
    zero: float
    lower: float
    upper: float
    change: float
    change_lower: float
    change_upper: float
    n_halts: int


def halt_zero(samples: Array, resolution: float) -> HaltZero:
    """Zero of a sensor in one halt, from its settled samples without pressure.

    Parameters
    ----------
    samples
        In time order, evenly sampled, shape (n,); those that are not finite do not count.
    resolution
        Smallest step of the sensor [unit].

    Returns
    -------
    HaltZero
        The error comes from the means of eight parts of the halt, and is at least what a reading
        in steps leaves open, resolution / √12.

    Examples
    --------
    >>> found = halt_zero(0.03 + 0.001 * np.sin(np.arange(600.0)), resolution=0.001)
    >>> found.status, round(found.zero, 3)
    ('ok', 0.03)
    """
    seen = samples[np.isfinite(samples)]
    if len(seen) < LEAST_SAMPLES:
        return HaltZero("too_short", math.nan, math.nan)
    means = np.array([part.mean() for part in np.array_split(seen, BATCHES)])
    half = BATCHES // 2
    move = float(means[half:].mean() - means[:half].mean())
    scatter = math.sqrt(float(means[:half].var(ddof=1) + means[half:].var(ddof=1)) / half)
    if abs(move) > max(_quantile(BATCHES - 2) * scatter, resolution):
        return HaltZero("not_settled", math.nan, math.nan)
    error = float(means.std(ddof=1)) / math.sqrt(BATCHES)
    return HaltZero("ok", float(seen.mean()), math.hypot(error, resolution / math.sqrt(12.0)))


def zero_drift(
    nights: NDArray[np.int64], zeros: Array, errors: Array, tolerance: float
) -> ZeroDrift:
    """Whether a sensor's zero has moved since its first halts.

    Parameters
    ----------
    nights
        Night of each halt, not decreasing, shape (n,); since the sensor was last put right.
    zeros, errors
        Of each halt, from :func:`halt_zero` [unit], shape (n,); those that are not finite do not
        count.
    tolerance
        Stated tolerance of the sensor's zero [unit]: a smaller move is ``steady`` however certain.

    Returns
    -------
    ZeroDrift
        From the means of the first and of the last halts, up to thirty each and never the same
        ones, by Welch's t; the scatter between halts counts, and is at least that of the errors.

    Raises
    ------
    ShapeError
        ``unequal_lengths`` or ``nights_not_increasing``.
    ParameterError
        ``bad_tolerance``.

    Examples
    --------
    >>> nights = np.arange(40)
    >>> zeros = 0.001 * (-1.0) ** nights + 0.05 * (nights >= 20)
    >>> found = zero_drift(nights, zeros, np.full(40, 0.001), tolerance=0.02)
    >>> found.status, round(found.change, 3)
    ('drifts', 0.05)
    """
    if not len(nights) == len(zeros) == len(errors):
        raise ShapeError(
            "unequal_lengths",
            f"{len(nights)} nights, {len(zeros)} zeros, {len(errors)} errors; expected one length",
        )
    if len(nights) > 1 and int(np.min(np.diff(nights))) < 0:
        raise ShapeError("nights_not_increasing", "nights of halts go back; expected time order")
    if not tolerance >= 0.0:
        raise ParameterError(
            "bad_tolerance", f"tolerance of a zero is {tolerance:g}; expected 0 or more"
        )
    kept = np.isfinite(zeros) & np.isfinite(errors)
    zeros, errors = zeros[kept], errors[kept]
    n = len(zeros)
    if n < 2 * LEAST_HALTS:
        nan = math.nan
        return ZeroDrift("insufficient", nan, nan, nan, nan, nan, nan, n)
    size = min(n // 2, MOST_HALTS)
    now, now_variance = _mean(zeros[-size:], errors[-size:])
    before, before_variance = _mean(zeros[:size], errors[:size])
    half = _quantile(size - 1) * math.sqrt(now_variance)
    change, variance = now - before, now_variance + before_variance
    # Welch and Satterthwaite, for groups of one size.
    both = now_variance**2 + before_variance**2
    freedom = (size - 1) * variance**2 / both if both > 0.0 else float(size - 1)
    reach = _quantile(freedom) * math.sqrt(variance)
    drifts = abs(change) > max(reach, tolerance)
    return ZeroDrift(
        status="drifts" if drifts else "steady",
        zero=now,
        lower=now - half,
        upper=now + half,
        change=change,
        change_lower=change - reach,
        change_upper=change + reach,
        n_halts=n,
    )


def _mean(zeros: Array, errors: Array) -> tuple[float, float]:
    """Mean of some halts, and its variance."""
    scatter = max(float(zeros.var(ddof=1)), float(np.mean(errors**2)))
    return float(zeros.mean()), scatter / len(zeros)


def _quantile(freedom: float) -> float:
    return float(stdtrit(freedom, 0.5 + COVERAGE / 2))

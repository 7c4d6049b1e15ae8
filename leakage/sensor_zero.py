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
    """Zero reading of a sensor in one halt.

    Attributes
    ----------
    status
        ``ok``; ``too_short``; ``not_settled``: the reading still moved from one half of the halt
        to the other by more than its errors and its resolution.
    zero
        Mean [unit]; nan unless ``ok``.
    standard_error
        Standard error of the mean, including the resolution [unit]; nan unless ``ok``.
    """

    status: HaltStatus
    zero: float
    standard_error: float


@dataclass(frozen=True, slots=True)
class ZeroDrift:
    """Drift of a sensor's zero.

    Attributes
    ----------
    status
        ``drifts`` where the move is certain and beyond the tolerance, ``steady`` where it is not,
        ``insufficient`` with fewer than ten halts.
    zero, lower, upper
        Present zero, and its 95 % interval [unit].
    change, change_lower, change_upper
        Present zero less initial zero, and its 95 % interval [unit].
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


@dataclass(frozen=True, slots=True)
class ZeroCourse:
    """Drift of a sensor's zero as known after each halt; shape (n,) each, nan below ten halts.

    Attributes
    ----------
    drifts
        True where the move is certain and beyond the tolerance.
    zero, lower, upper, change, change_lower, change_upper
        As in :class:`ZeroDrift`.
    n_halts
        Halts that counted by then.
    """

    drifts: NDArray[np.bool_]
    zero: Array
    lower: Array
    upper: Array
    change: Array
    change_lower: Array
    change_upper: Array
    n_halts: NDArray[np.int64]


def zero_course(
    nights: NDArray[np.int64], zeros: Array, errors: Array, tolerance: float
) -> ZeroCourse:
    """Drift of a sensor's zero since its first halts, halt by halt.

    Parameters
    ----------
    nights
        Night of each halt since the sensor was last corrected, not decreasing, shape (n,).
    zeros, errors
        Zero and standard error of each halt, from :func:`halt_zero` [unit], shape (n,); those
        that are not finite do not count, and keep the result before.
    tolerance
        Stated tolerance of the sensor's zero [unit]: a smaller move is no drift, however certain.

    Returns
    -------
    ZeroCourse
        From the means of the first and of the last halts, up to thirty each and without overlap,
        by Welch's t; the scatter between halts counts, and is at least that of the errors. The
        result after a halt depends only on that halt and those before it.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.
    ParameterError
        ``zero_tolerance``.

    Examples
    --------
    >>> nights = np.arange(40)
    >>> zeros = 0.001 * (-1.0) ** nights + 0.05 * (nights >= 20)
    >>> found = zero_course(nights, zeros, np.full(40, 0.001), tolerance=0.02)
    >>> int(found.drifts.argmax()), round(float(found.change[-1]), 3)
    (24, 0.05)
    """
    _require_halts(nights, zeros, errors, tolerance)
    kept = np.isfinite(zeros) & np.isfinite(errors)
    count = np.cumsum(kept, dtype=np.int64)
    # The last halt that counts is what each halt knows.
    last = np.maximum(count - 1, 0)
    size = np.minimum(count // 2, MOST_HALTS)
    known = size >= LEAST_HALTS
    size = np.where(known, size, LEAST_HALTS)
    if not kept.any():
        nothing = np.full(len(zeros), np.nan)
        return ZeroCourse(known, nothing, nothing, nothing, nothing, nothing, nothing, count)
    # The first one, not their middle: what is known after a halt must not hang on later ones.
    reference = float(zeros[kept][0])
    sums = _Sums.of(zeros[kept] - reference, errors[kept])
    end = np.minimum(last + 1, len(sums.value) - 1)
    now, now_variance = sums.mean(np.maximum(end - size, 0), end, size)
    first_end = np.minimum(size, len(sums.value) - 1)
    before, before_variance = sums.mean(np.zeros_like(size), first_end, size)
    half = stdtrit(size - 1.0, 0.5 + COVERAGE / 2) * np.sqrt(now_variance)
    change, variance = now - before, now_variance + before_variance
    # Welch and Satterthwaite, for groups of one size.
    both = now_variance**2 + before_variance**2
    freedom = np.where(both > 0.0, (size - 1) * variance**2 / np.where(both > 0, both, 1), size - 1)
    reach = stdtrit(freedom, 0.5 + COVERAGE / 2) * np.sqrt(variance)

    def only(values: Array) -> Array:
        return np.where(known, values, np.nan)

    zero = reference + now
    return ZeroCourse(
        drifts=known & (np.abs(change) > np.maximum(reach, tolerance)),
        zero=only(zero),
        lower=only(zero - half),
        upper=only(zero + half),
        change=only(change),
        change_lower=only(change - reach),
        change_upper=only(change + reach),
        n_halts=count,
    )


def zero_drift(
    nights: NDArray[np.int64], zeros: Array, errors: Array, tolerance: float
) -> ZeroDrift:
    """Drift of a sensor's zero since its first halts, as known after the last.

    Parameters
    ----------
    nights, zeros, errors, tolerance
        As for :func:`zero_course`.

    Returns
    -------
    ZeroDrift
        Result after the last halt.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.
    ParameterError
        ``zero_tolerance``.

    Examples
    --------
    >>> nights = np.arange(40)
    >>> zeros = 0.001 * (-1.0) ** nights + 0.05 * (nights >= 20)
    >>> found = zero_drift(nights, zeros, np.full(40, 0.001), tolerance=0.02)
    >>> found.status, round(found.change, 3)
    ('drifts', 0.05)
    """
    found = zero_course(nights, zeros, errors, tolerance)
    n = int(found.n_halts[-1]) if len(zeros) else 0
    if n < 2 * LEAST_HALTS:
        nan = math.nan
        return ZeroDrift("insufficient", nan, nan, nan, nan, nan, nan, n)
    return ZeroDrift(
        status="drifts" if found.drifts[-1] else "steady",
        zero=float(found.zero[-1]),
        lower=float(found.lower[-1]),
        upper=float(found.upper[-1]),
        change=float(found.change[-1]),
        change_lower=float(found.change_lower[-1]),
        change_upper=float(found.change_upper[-1]),
        n_halts=n,
    )


@dataclass(frozen=True, slots=True)
class _Sums:
    """Running sums of zeros, their squares and the squares of their errors; shape (n + 1,)."""

    value: Array
    square: Array
    error: Array

    @classmethod
    def of(cls, zeros: Array, errors: Array) -> _Sums:
        return cls(
            *(np.concatenate([[0.0], np.cumsum(part)]) for part in (zeros, zeros**2, errors**2))
        )

    def mean(
        self, first: NDArray[np.int64], end: NDArray[np.int64], n: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Mean of some halts, and its variance."""
        mean = (self.value[end] - self.value[first]) / n
        squares = self.square[end] - self.square[first] - n * mean**2
        scatter = np.maximum(squares / (n - 1), (self.error[end] - self.error[first]) / n)
        return mean, np.maximum(scatter, 0.0) / n


def _require_halts(
    nights: NDArray[np.int64], zeros: Array, errors: Array, tolerance: float
) -> None:
    if not len(nights) == len(zeros) == len(errors):
        raise ShapeError(
            "shape",
            f"{len(nights)} nights, {len(zeros)} zeros, {len(errors)} errors; expected one length",
        )
    if len(nights) > 1 and int(np.min(np.diff(nights))) < 0:
        raise ShapeError("night_order", "nights of halts go back; expected time order")
    if not tolerance >= 0.0:
        raise ParameterError(
            "zero_tolerance", f"tolerance of a zero is {tolerance:g}; expected 0 or more"
        )


def _quantile(freedom: float) -> float:
    return float(stdtrit(freedom, 0.5 + COVERAGE / 2))

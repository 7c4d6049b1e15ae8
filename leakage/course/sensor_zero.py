"""Zeros of pressure and flow sensors while the motor stands still, and whether they drift.

In a halt without pressure, once it has settled, pressure difference and drain flow are zero, so
what the sensors say is their error. A drift of 0.02 l/min moves the piston rings' K by 11 %: a
sensor that drifts has to be named before wear is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from leakage.arrays import Array, Mask, Places

# Halts at the beginning, and as many at the end, that a drift is estimated from.
LEAST_HALTS = 5
MOST_HALTS = 30
COVERAGE = 0.95


@dataclass(frozen=True, slots=True)
class ZeroCourse:
    """Drift of a sensor's zero as known after each halt; shape (n,) each, nan below ten halts."""

    drifts: Mask  # True where the move is certain and beyond the tolerance.
    zero: Array  # Present zero [unit].
    # change, change_lower, change_upper: Present zero less initial zero, and its 95 % interval
    # [unit].
    change: Array
    change_lower: Array
    change_upper: Array


def zero_course(zeros: Array, errors: Array, tolerance: float) -> ZeroCourse:
    """Return drift of a sensor's zero since its first halts, halt by halt.

    From the means of the first and of the last halts, up to thirty each and without overlap, by
    Welch's t; the scatter between halts counts, and is at least that of the errors. The result
    after a halt depends only on that halt and those before it.

    `zeros, errors`: Zero and standard error of each halt since the sensor was last corrected, in
    order [unit], shape (n,); those that are not finite do not count, and keep the result before.
    `tolerance`: Stated tolerance of the sensor's zero [unit]: a smaller move is no drift, however
    certain.
    """
    counts = np.isfinite(zeros) & np.isfinite(errors)
    count = np.cumsum(counts, dtype=np.int64)
    # The last halt that counts is what each halt knows.
    last = np.maximum(count - 1, 0)
    size = np.minimum(count // 2, MOST_HALTS)
    known = size >= LEAST_HALTS
    size = np.where(known, size, LEAST_HALTS)
    if not counts.any():
        nothing = np.full(len(zeros), np.nan)
        return ZeroCourse(known, nothing, nothing, nothing, nothing)
    # The first, not their middle: what is known after a halt must not hang on later ones.
    reference = float(zeros[counts][0])
    value, square, square_error = (
        np.concatenate([[0.0], np.cumsum(part)])
        for part in (
            zeros[counts] - reference,
            (zeros[counts] - reference) ** 2,
            errors[counts] ** 2,
        )
    )

    def of_halts(first: Places, end: Places) -> tuple[Array, Array]:
        """Return mean of some halts, and its variance."""
        mean = (value[end] - value[first]) / size
        squares = square[end] - square[first] - size * mean**2
        scatter = np.maximum(squares / (size - 1), (square_error[end] - square_error[first]) / size)
        return mean, np.maximum(scatter, 0.0) / size

    end = np.minimum(last + 1, len(value) - 1)
    now, now_variance = of_halts(np.maximum(end - size, 0), end)
    before, before_variance = of_halts(np.zeros_like(size), np.minimum(size, len(value) - 1))
    change, variance = now - before, now_variance + before_variance
    # Welch and Satterthwaite, for groups of equal size.
    both = now_variance**2 + before_variance**2
    freedom = np.where(both > 0.0, (size - 1) * variance**2 / np.where(both > 0, both, 1), size - 1)
    reach = stdtrit(freedom, 0.5 + COVERAGE / 2) * np.sqrt(variance)

    def only(values: Array) -> Array:
        return np.where(known, values, np.nan)

    return ZeroCourse(
        drifts=known & (np.abs(change) > np.maximum(reach, tolerance)),
        zero=only(reference + now),
        change=only(change),
        change_lower=only(change - reach),
        change_upper=only(change + reach),
    )

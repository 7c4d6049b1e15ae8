r"""Sudden steps, up or down: from one good night to the next, and lasting.

Wear grows; what changes from one night to the next is damage, an exchanged part or motor, another
oil, or a sensor. With the median b of up to ten good nights before a night and the median a of the
first three from it on, that night is a jump if

.. math::
    |a - b| \ge \max(\text{least}\,|b|,\; 6 s), \qquad
    \frac{x_{i-1} - b}{a - b} \le 0.3, \qquad \frac{x_{i \dots i+2} - b}{a - b} \ge 0.7

with the robust scatter s of the nights before. A ramp that takes some nights is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from leakage.course.autoregression import Array, Nights
from leakage.course.medians import row_medians
from leakage.course.slope import check_series
from leakage.estimation.robust import MAD_TO_SD

# Good nights before a jump, at most and at least, and from it on.
MOST_BEFORE = 10
LEAST_BEFORE = 5
AFTER = 3
# Standard deviations of the nights before.
LEAST_SD = 6.0
# Shares of the step that the night before may have, and that the nights after must have.
SHARE_BEFORE, SHARE_AFTER = 0.3, 0.7


@dataclass(frozen=True, slots=True)
class Jump:
    """A sudden, lasting step.

    Attributes
    ----------
    place, told
        Places in the series of its first night, and of the night on which it is known.
    before, after
        Levels [unit].
    """

    place: int
    told: int
    before: float
    after: float

    @property
    def relative(self) -> float:
        """Step over the level before, [-]."""
        return self.after / self.before - 1.0

    @property
    def log_step(self) -> float:
        """Logarithm of the level after over that before."""
        return float(np.log(self.after / self.before))


def find_jumps(
    nights: Nights, values: Array, least: float, floor: float, longest_gap: int
) -> tuple[Jump, ...]:
    """Sudden steps of an indicator.

    Parameters
    ----------
    nights
        Numbers of the nights, increasing, shape (n,).
    values
        Indicator, positive, shape (n,); nights that are not finite or not positive do not count.
    least
        Smallest step, relative to the level before, [-].
    floor
        Least standard deviation of the nights, relative to the level before, [-].
    longest_gap
        Nights that may lie between the night before a jump and its first: over a longer silence
        nobody can tell what was sudden.

    Returns
    -------
    tuple of Jump
        In order of time; each is known from the third good night on, by that night and those
        before it alone.

    Raises
    ------
    ShapeError
        ``shape`` or ``night_order``.

    Examples
    --------
    >>> nights = np.arange(40)
    >>> values = 1.0 + 0.01 * (-1.0) ** nights + 0.3 * (nights >= 20)
    >>> [(one.place, one.told, round(one.relative, 2)) for one in find_jumps(nights, values, 0.1,
    ...     0.01, 7)]
    [(20, 22, 0.31)]
    """
    check_series(nights, values)
    good = np.flatnonzero(np.isfinite(values) & (np.nan_to_num(values) > 0.0))
    x, n = values[good], len(good)
    last = n - AFTER + 1
    if last <= LEAST_BEFORE:
        return ()
    places = np.arange(LEAST_BEFORE, last)
    middle, scatter = _levels_before(x, places)
    behind = sliding_window_view(x, AFTER)[places]
    after = np.median(behind, axis=1)
    step = after - middle
    large = np.abs(step) >= np.maximum(
        least * middle, LEAST_SD * np.maximum(scatter, floor * middle)
    )
    near = nights[good[places]] - nights[good[places - 1]] <= longest_gap
    found = []
    for number in np.flatnonzero(large & near):
        place = int(places[number])
        share = (x[place - 1 : place + AFTER] - middle[number]) / step[number]
        if share[0] <= SHARE_BEFORE and share[1:].min() >= SHARE_AFTER:
            told = int(good[place + AFTER - 1])
            levels = float(middle[number]), float(after[number])
            found.append(Jump(int(good[place]), told, *levels))
    return tuple(found)


def is_undone(jump: Jump, recent: Array) -> bool:
    """True if good nights lie nearer to the level before a jump than to the level after it.

    Examples
    --------
    >>> is_undone(Jump(20, 22, 1.0, 1.3), np.array([1.02, 1.01, 0.99]))
    True
    """
    share = (float(np.median(recent)) - jump.before) / (jump.after - jump.before)
    return share < 0.5


def _levels_before(x: Array, places: NDArray[np.intp]) -> tuple[Array, Array]:
    """Median and robust standard deviation of up to ten values before each place."""
    padded = np.concatenate([np.full(MOST_BEFORE, np.nan), x])
    before = sliding_window_view(padded, MOST_BEFORE)[places]
    middle = row_medians(before)
    scatter = MAD_TO_SD * row_medians(np.abs(before - middle[:, None]))
    return middle, scatter

r"""When an indicator will reach a limit, if it goes on as it does: Fieller's set.

The line through the nights has the value a now and the slope b, both uncertain. All times τ at
which the limit L could be reached are those for which a + bτ is not told from L:

.. math::
    (a + b\tau - L)^2 \le t^2 (v_a + 2 \tau v_{ab} + \tau^2 v_b) .

This set [1]_ covers the true time as often as it says, however uncertain the slope; a standard
error of the quotient (L − a)/b does not. Where b is not told from 0, it has no upper end.

References
----------
.. [1] E. C. Fieller, "Some problems in interval estimation", *Journal of the Royal Statistical
   Society B*, 16(2), 1954.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from scipy.special import stdtrit

from leakage.slope import Slope

TimeStatus: TypeAlias = Literal[
    "finite", "no_trend", "already_crossed", "beyond_horizon", "unbounded"
]


@dataclass(frozen=True, slots=True)
class TimeToLimit:
    """Time until an indicator reaches a limit from below, in units of the slope's position.

    Attributes
    ----------
    status
        ``finite``; ``beyond_horizon``: bounded, but more likely later than the horizon than before;
        ``unbounded``: it rises, but not rising is within the errors, so there is an earliest time
        and no latest; ``already_crossed``: the line is at the limit or above; ``no_trend``: it does
        not rise, or nothing is known.
    time
        Most likely one; only of ``finite``.
    lower, upper
        Ends of the set in the future; None where there is none.
    """

    status: TimeStatus
    time: float | None = None
    lower: float | None = None
    upper: float | None = None


def time_to_limit(
    slope: Slope, limit: float, now: float, horizon: float, coverage: float = 0.95
) -> TimeToLimit:
    """When an indicator reaches a limit.

    Parameters
    ----------
    slope
        Line through the nights since the last event that started a baseline.
    limit
        In the unit of the indicator.
    now
        Position of tonight: night or running hours, as the slope is per.
    horizon
        How far ahead a line may be believed, in the same unit.
    coverage
        Of the set.

    Returns
    -------
    TimeToLimit
        ``no_trend`` also where there is no line at all.

    Examples
    --------
    >>> import numpy as np
    >>> from leakage.slope import fit_slope
    >>> nights = np.arange(100)
    >>> line = fit_slope(nights, 1.0 + 0.001 * nights + 0.004 * (-1.0) ** nights)
    >>> found = time_to_limit(line, limit=1.3, now=99.0, horizon=1825.0)
    >>> found.status, abs(found.time - 201) < 2, found.lower < 201 < found.upper
    ('finite', True, True)
    """
    if slope.slope is None or slope.level is None or slope.pivot is None:
        return TimeToLimit("no_trend")
    ahead = now - slope.pivot
    below = slope.level + slope.slope * ahead - limit
    if below >= 0.0:
        return TimeToLimit("already_crossed", lower=0.0, upper=0.0)
    if slope.slope <= 0.0:
        return TimeToLimit("no_trend")
    lower, upper = _fieller(slope, below, ahead, coverage)
    if lower is None:
        return TimeToLimit("no_trend")
    if upper is None:
        return TimeToLimit("unbounded", lower=lower)
    time = -below / slope.slope
    if time > horizon:
        return TimeToLimit("beyond_horizon", lower=lower, upper=upper)
    return TimeToLimit("finite", time, lower, upper)


def _fieller(
    slope: Slope, below: float, ahead: float, coverage: float
) -> tuple[float | None, float | None]:
    """Ends of the set at and after now, for a rising line below its limit."""
    rise = float(slope.slope or 0.0)
    if slope.covariance is None:
        return -below / rise, -below / rise
    t2 = float(stdtrit(slope.freedom, 0.5 + coverage / 2)) ** 2
    of_level, mixed, of_slope = (float(slope.covariance[at]) for at in ((0, 0), (0, 1), (1, 1)))
    # Aτ² + 2Bτ + C ≤ 0, with the variance of the line now in place of that at its pivot.
    now = of_level + 2.0 * ahead * mixed + ahead**2 * of_slope
    a = rise**2 - t2 * of_slope
    b = below * rise - t2 * (mixed + ahead * of_slope)
    c = below**2 - t2 * now
    root = b * b - a * c
    if a > 0.0:
        # The quotient itself is in the set, so the roots are real.
        spread = math.sqrt(max(root, 0.0))
        return max((-b - spread) / a, 0.0), max((-b + spread) / a, 0.0)
    if c <= 0.0:
        # Already within the errors of the limit, and no latest time either: nothing is known.
        return None, None
    # τ = 0 is outside, the quotient inside: a root lies between, and what comes after it is inside.
    reach = -b + math.sqrt(max(root, 0.0))
    return (c / reach, None) if reach > 0.0 else (None, None)

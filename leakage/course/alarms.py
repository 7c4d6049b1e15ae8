"""Levels with hysteresis, and the states of an indicator from night to night."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.course.autoregression import Array, Nights
from leakage.errors import ParameterError

Severities = NDArray[np.int64]
State: TypeAlias = Literal[
    "ok", "warning", "alarm", "common_cause", "duty_outside", "stale", "insufficient"
]

# Severities are 0, 1, 2.
OF_SEVERITY: tuple[State, State, State] = ("ok", "warning", "alarm")


@dataclass(frozen=True, slots=True)
class Levels:
    """Levels at which a deviation from the baseline is a warning or an alarm.

    Parameters
    ----------
    warning, alarm
        Relative rise over the baseline, [-].
    deadband
        Distance below a level at which it goes off again, [-].
    on_nights, of_nights
        A level goes on when tonight and at least `on_nights` of the last `of_nights` good nights
        lie above it.
    off_nights
        A level goes off after this many good nights in a row below it.
    least_sd
        Least height of a level, in standard deviations of the nights (the upper 95 % bound that
        the baseline gives), so that widely scattered nights do not reach it by chance.
    sudden_sd
        A night that rises at once by more than the alarm level and this many standard deviations
        turns the levels on by itself.

    Raises
    ------
    ParameterError
        ``alarm_levels``.
    """

    warning: float = 0.15
    alarm: float = 0.30
    deadband: float = 0.05
    on_nights: int = 3
    of_nights: int = 5
    off_nights: int = 5
    least_sd: float = 4.5
    sudden_sd: float = 8.0

    def __post_init__(self) -> None:
        if not (0 < self.warning <= self.alarm and 0 <= self.deadband < self.warning):
            raise ParameterError(
                "alarm_levels",
                f"warning {self.warning:g}, alarm {self.alarm:g}, deadband {self.deadband:g}; "
                "expected 0 < warning ≤ alarm, and a deadband from 0 to below the warning",
            )
        if not 1 <= self.on_nights <= self.of_nights or self.off_nights < 1 or self.least_sd < 0:
            raise ParameterError(
                "alarm_levels",
                f"{self.on_nights} of {self.of_nights} nights on, {self.off_nights} off, "
                f"{self.least_sd:g} standard deviations; expected 1 ≤ m ≤ n, 1 ≤ off and 0 ≤ sd",
            )

    def in_effect(self, sd: float) -> tuple[float, float]:
        """Warning and alarm over a baseline whose nights scatter by a relative sd, [-].

        Examples
        --------
        >>> Levels().in_effect(0.01), Levels().in_effect(0.05)
        ((0.15, 0.3), (0.225, 0.3))
        """
        least = self.least_sd * sd
        return max(self.warning, least), max(self.alarm, least)


@dataclass(frozen=True, slots=True)
class Limits:
    """Absolute warning and alarm of a motor type, in the indicator's unit; None: there is none."""

    warning: float | None = None
    alarm: float | None = None


def above_level(
    values: Array,
    level: float,
    deadband: float,
    rule: Levels,
    sudden: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """True where a level is on, night by night.

    Parameters
    ----------
    values
        Shape (n,); nights that are not finite keep the previous state.
    level
        In the unit of the values.
    deadband
        The level goes off below `level` less this.
    rule
        Number of nights that it takes.
    sudden
        Nights that turn it on by themselves, shape (n,); None: none does.

    Returns
    -------
    ndarray
        Shape (n,).

    Examples
    --------
    >>> values = np.array([0.2, 0.2, np.nan, 0.2, 0.12, 0.05, 0.05, 0.05, 0.05, 0.05])
    >>> above_level(values, 0.15, 0.05, Levels()).astype(int).tolist()
    [0, 0, 0, 1, 1, 1, 1, 1, 1, 0]
    """
    good = np.flatnonzero(np.isfinite(values))
    above = values[good] > level
    below = values[good] < level - deadband
    goes_on = above & (_count(above, rule.of_nights) >= rule.on_nights)
    if sudden is not None:
        goes_on |= above & sudden[good]
    goes_off = _count(below, rule.off_nights) == rule.off_nights
    is_on = np.zeros(len(values), dtype=np.bool_)
    if len(good):
        is_on[good] = _last(goes_on) > _last(goes_off)
    return _held(is_on, good)


def level_severity(deviation: Array, sd: float, rule: Levels) -> Severities:
    """Severity by the levels over the baseline, 0, 1 or 2, shape (n,).

    Nights without a figure hold. `sd` is the relative scatter of the nights, from the safe side.
    """
    found = np.zeros(len(deviation), dtype=np.int64)
    sudden = sudden_nights(deviation, sd, rule)
    for severity, level in enumerate(rule.in_effect(sd), start=1):
        found[above_level(deviation, level, rule.deadband, rule, sudden)] = severity
    return found


def sudden_nights(deviation: Array, sd: float, rule: Levels) -> NDArray[np.bool_]:
    """Nights that rose at once by more than both the alarm level and so many deviations.

    They lie so far above the median of the good nights before them, at most `of_nights`, or above
    the baseline where there is none.

    Examples
    --------
    >>> sudden_nights(np.array([0.0, 0.01, 0.8, 0.8, 0.8]), 0.01, Levels()).astype(int).tolist()
    [0, 0, 1, 1, 1]
    >>> sudden_nights(np.array([0.2, 0.25, 0.3, 0.35, 0.4]), 0.01, Levels()).any()
    np.False_
    """
    found = np.zeros(len(deviation), dtype=np.bool_)
    least = max(rule.alarm, rule.sudden_sd * sd)
    good = np.flatnonzero(np.isfinite(deviation))
    for place, night in enumerate(good.tolist()):
        if deviation[night] > least:
            before = deviation[good[max(place - rule.of_nights, 0) : place]]
            usual = float(np.median(before)) if len(before) else 0.0
            found[night] = deviation[night] - usual > least
    return found


def limit_severity(values: Array, limits: Limits, rule: Levels) -> Severities:
    """Severity by the limits of the motor type, 0, 1 or 2, shape (n,); they need no baseline."""
    found = np.zeros(len(values), dtype=np.int64)
    for severity, limit in ((1, limits.warning), (2, limits.alarm)):
        if limit is not None:
            found[above_level(values, limit, 0.0, rule)] = severity
    return found


def nights_since_good(nights: Nights, good: NDArray[np.bool_]) -> Nights:
    """Nights since the last good one, shape (n,); very many before the first.

    Examples
    --------
    >>> nights_since_good(np.array([3, 4, 9]), np.array([True, False, False])).tolist()
    [0, 1, 6]
    """
    never = nights[0] - np.iinfo(np.int32).max if len(nights) else 0
    last: Nights = np.maximum.accumulate(np.where(good, nights, never))
    return nights - last


def _count(condition: NDArray[np.bool_], nights: int) -> NDArray[np.int64]:
    """Number of true entries among the last `nights` up to each; fewer are counted at the start."""
    total = np.concatenate([[0], np.cumsum(condition)])
    places = np.arange(1, len(total))
    result: NDArray[np.int64] = total[1:] - total[np.maximum(places - nights, 0)]
    return result


def _held(is_on: NDArray[np.bool_], good: NDArray[np.intp]) -> NDArray[np.bool_]:
    """State of the last good night up to each night; False before the first."""
    place = np.searchsorted(good, np.arange(len(is_on)), side="right") - 1
    result = np.zeros(len(is_on), dtype=np.bool_)
    seen = place >= 0
    result[seen] = is_on[good[place[seen]]]
    return result


def _last(condition: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Place of the last true entry up to each; −1 before the first."""
    result: NDArray[np.int64] = np.maximum.accumulate(
        np.where(condition, np.arange(len(condition)), -1)
    )
    return result

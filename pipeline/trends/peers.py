"""Motors of one oil circuit: what moves all of them, indicator by indicator."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.baseline import BaselineSettings, fit_baseline
from leakage.peers import peer_deviations
from pipeline.trends.history import History
from pipeline.trends.indicators import Indicator
from pipeline.trends.segments import Segment
from pipeline.trends.watch import RATIOS, night_numbers

Array = NDArray[np.float64]

# Good nights that say how far a coefficient has moved.
NIGHTS_OF_PATHS = 5


@dataclass(frozen=True, slots=True)
class Peers:
    """What the other motors of a motor's circuit did; shape (n,) each, nights of the motor.

    Attributes
    ----------
    others
        Median of their log changes; nan where none is known.
    deviation
        The motor's own log change less that.
    n_others
        How many were known.
    """

    others: Array
    deviation: Array
    n_others: NDArray[np.int64]


def log_change(
    history: History, indicator: Indicator, parts: tuple[Segment, ...], baseline_nights: int
) -> Array:
    """ln of an indicator over the mean of the first good nights of each segment, shape (n,)."""
    series = indicator.value + 1.0 if indicator.name in RATIOS else indicator.value
    numbers = night_numbers(history)
    result = np.full(len(series), np.nan)
    settings = BaselineSettings(nights=baseline_nights, provisional_nights=baseline_nights)
    for part in parts:
        here = slice(part.first, part.end)
        baseline = fit_baseline(numbers[here], series[here], settings)
        if baseline.status != "insufficient" and baseline.mean > 0:
            with np.errstate(invalid="ignore"):
                result[here] = np.log(series[here] / baseline.mean)
    return result


def moved_apart(changes: Sequence[Array], percent: float) -> NDArray[np.bool_]:
    """Nights on which a motor's coefficients had moved by different amounts: oil moves all alike.

    Parameters
    ----------
    changes
        Log changes of its coefficients, shape (n,) each.
    percent
        Least difference that counts, in points; it must be half of the largest change as well.

    Returns
    -------
    ndarray of bool
        Shape (n,); False with fewer than two coefficients. By the median of the last five good
        nights of each, so that an odd night decides nothing.

    Examples
    --------
    >>> sleeve, ring = np.full(9, 0.4), np.zeros(9)
    >>> moved_apart([sleeve, ring], 5.0).all(), moved_apart([sleeve, sleeve], 5.0).any()
    (np.True_, np.False_)
    """
    n = len(changes[0]) if changes else 0
    moved = np.array([_recent_median(one) for one in changes]).reshape(len(changes), n)
    moved = 100.0 * np.expm1(moved)
    known = np.isfinite(moved).sum(axis=0) > 1
    highest, lowest = (
        np.max(np.where(np.isfinite(moved), moved, -np.inf), axis=0, initial=-np.inf),
        np.min(np.where(np.isfinite(moved), moved, np.inf), axis=0, initial=np.inf),
    )
    apart = np.zeros(n, dtype=np.bool_)
    apart[known] = (highest - lowest)[known] > np.maximum(percent, highest[known] / 2)
    return apart


def _recent_median(values: Array) -> Array:
    """Median of the last five good nights up to each, nan before there is one."""
    good = np.flatnonzero(np.isfinite(values))
    result = np.full(len(values), np.nan)
    for number, place in enumerate(good):
        recent = values[good[max(number - NIGHTS_OF_PATHS + 1, 0) : number + 1]]
        end = good[number + 1] if number + 1 < len(good) else len(values)
        result[place:end] = np.median(recent)
    return result


def peers_of_circuit(
    nights: Mapping[str, tuple[dt.date, ...]],
    steady: Mapping[str, Array],
    own: Mapping[str, Array],
) -> dict[str, Peers]:
    """Each motor of a circuit against the others, for one indicator.

    Parameters
    ----------
    nights
        Labels of each motor's nights.
    steady
        Its log changes, from :func:`log_change`, where they may speak for the oil.
    own
        Its log changes on all nights.

    Returns
    -------
    dict of str to Peers
        Empty for a circuit of one.
    """
    motors = sorted(steady)
    if len(motors) < 2:
        return {}
    labels = sorted({label for motor in motors for label in nights[motor]})
    place = {label: number for number, label in enumerate(labels)}
    rows = {motor: np.array([place[label] for label in nights[motor]]) for motor in motors}
    table = np.full((len(labels), len(motors)), np.nan)
    for column, motor in enumerate(motors):
        table[rows[motor], column] = steady[motor]
    found = peer_deviations(table)
    return {
        motor: Peers(
            found.others[rows[motor], column],
            own[motor] - found.others[rows[motor], column],
            found.n_others[rows[motor], column],
        )
        for column, motor in enumerate(motors)
    }

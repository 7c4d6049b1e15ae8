"""Motors of one oil circuit: what moves all of them, indicator by indicator."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
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


def peers_of_circuit(
    nights: Mapping[str, tuple[dt.date, ...]], changes: Mapping[str, Array]
) -> dict[str, Peers]:
    """Each motor of a circuit against the others, for one indicator.

    Parameters
    ----------
    nights
        Labels of each motor's nights.
    changes
        Its log changes, from :func:`log_change`.

    Returns
    -------
    dict of str to Peers
        Empty for a circuit of one.
    """
    motors = sorted(changes)
    if len(motors) < 2:
        return {}
    labels = sorted({label for motor in motors for label in nights[motor]})
    place = {label: number for number, label in enumerate(labels)}
    rows = {motor: np.array([place[label] for label in nights[motor]]) for motor in motors}
    table = np.full((len(labels), len(motors)), np.nan)
    for column, motor in enumerate(motors):
        table[rows[motor], column] = changes[motor]
    found = peer_deviations(table)
    return {
        motor: Peers(
            found.others[rows[motor], column],
            found.deviation[rows[motor], column],
            found.n_others[rows[motor], column],
        )
        for column, motor in enumerate(motors)
    }

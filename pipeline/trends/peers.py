"""Motors of one oil circuit: what moves all of them, indicator by indicator.

What a motor's baseline is, is known from its thirtieth good night on. What another motor did is
taken into account from the night on which it was known, and for the nights before that as far as it
was known when the two could first be compared: a night's state must not hang on later nights.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.baseline import BaselineSettings, fit_baseline
from leakage.medians import row_medians
from leakage.peers import recent_median
from pipeline.trends.history import History
from pipeline.trends.indicators import Indicator
from pipeline.trends.segments import Segment

Array = NDArray[np.float64]
Places = NDArray[np.int64]

# Of a night whose figure was never put against a baseline.
NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True)
class LogChange:
    """How far an indicator of a motor had moved; shape (n,) each.

    Attributes
    ----------
    change
        ln of the indicator over the mean of the first good nights of its segment; nan where there
        is none.
    known_at
        Place of the night on which that mean was known; very large where it never was.
    segments
        Nights by baseline.
    """

    change: Array
    known_at: Places
    segments: tuple[Segment, ...]

    @property
    def told(self) -> Array:
        """The changes that were known in their own night, shape (n,)."""
        known: Array = np.where(self.known_at <= np.arange(len(self.change)), self.change, np.nan)
        return known


@dataclass(frozen=True, slots=True)
class Peers:
    """What the other motors of a motor's circuit did; shape (n,) each, nights of the motor.

    Attributes
    ----------
    others
        Median of their log changes; nan where none is known, or nothing could be compared.
    deviation
        The motor's own log change less that, where both were known in the night.
    n_others
        How many were known.
    comparable
        By first place of each segment of the motor, the place from which on there was anything to
        compare with.
    """

    others: Array
    deviation: Array
    n_others: Places
    comparable: Mapping[int, int]

    def known_from(self, segment: Segment) -> int:
        """Place from which on a segment's nights could be compared; its end where never."""
        return min(self.comparable[segment.first], segment.end)


def log_change(history: History, indicator: Indicator, parts: tuple[Segment, ...]) -> LogChange:
    """How far an indicator had moved from the first good nights of each segment."""
    series, needed = indicator.watched, history.spec.settings.trend.provisional_nights
    change = np.full(len(series), np.nan)
    known_at = np.full(len(series), NEVER, dtype=np.int64)
    settings = BaselineSettings(nights=needed, provisional_nights=needed)
    for part in parts:
        here = slice(part.first, part.end)
        baseline = fit_baseline(history.numbers[here], series[here], settings)
        if baseline.status != "insufficient" and baseline.mean > 0:
            with np.errstate(invalid="ignore", divide="ignore"):
                change[here] = np.log(series[here] / baseline.mean)
            known_at[here] = history.place_of(baseline.last_night)
    return LogChange(np.where(np.isfinite(change), change, np.nan), known_at, parts)


def moved_apart(
    changes: Mapping[str, Array], paths: Collection[str], percent: float
) -> dict[str, NDArray[np.bool_]]:
    """Nights on which an indicator had risen above what a motor's paths have in common.

    Oil moves all paths alike, wear lifts some of them above the others: what the lowest did may be
    the oil, the rest of what another indicator did is the motor's own.

    Parameters
    ----------
    changes
        Log changes by indicator, shape (n,) each.
    paths
        Which of them are coefficients of paths.
    percent
        Least difference from the lowest path that counts, in points; it must be half of the
        indicator's own change as well.

    Returns
    -------
    dict of str to ndarray of bool
        By indicator, shape (n,); False with fewer than two paths known. By the median of the last
        five good nights of each, so that an odd night decides nothing.

    Examples
    --------
    >>> moved = {"K_sleeve": np.full(9, 0.4), "K_ring": np.zeros(9), "leakage": np.full(9, 0.15)}
    >>> found = moved_apart(moved, ("K_sleeve", "K_ring"), 5.0)
    >>> {name: bool(one.all()) for name, one in found.items()}
    {'K_sleeve': True, 'K_ring': False, 'leakage': True}
    """
    moved = {name: 100.0 * np.expm1(recent_median(one)) for name, one in changes.items()}
    several = np.sum([np.isfinite(moved[name]) for name in paths], axis=0) > 1
    lowest: Array = np.fmin.reduce([moved[name] for name in paths], axis=0, initial=np.inf)
    return {
        name: several & (one - lowest > np.maximum(percent, np.abs(one) / 2))
        for name, one in moved.items()
    }


def peers_of_circuit(
    histories: Mapping[str, History],
    changes: Mapping[str, LogChange],
    apart: Mapping[str, NDArray[np.bool_]],
) -> dict[str, Peers]:
    """Each motor of a circuit against the others, for one indicator.

    Parameters
    ----------
    histories
        The motors.
    changes
        Log changes of those that have the indicator.
    apart
        Nights on which a motor's indicator says nothing of the oil, as the motor wears.

    Returns
    -------
    dict of str to Peers
        Empty for a circuit of one.
    """
    motors = sorted(changes)
    if len(motors) < 2:
        return {}
    labels = np.unique(np.concatenate([histories[motor].records["night"] for motor in motors]))
    rows = {motor: np.searchsorted(labels, histories[motor].records["night"]) for motor in motors}
    values = np.full((len(labels), len(motors)), np.nan)
    known_at = np.full((len(labels), len(motors)), NEVER, dtype=np.int64)
    for column, motor in enumerate(motors):
        one, own = changes[motor], rows[motor]
        values[own, column] = np.where(apart[motor], np.nan, one.change)
        there = one.known_at < NEVER
        known_at[own[there], column] = own[one.known_at[there]]
    return {
        motor: _against(
            changes[motor],
            rows[motor],
            np.delete(values, column, 1),
            np.delete(known_at, column, 1),
        )
        for column, motor in enumerate(motors)
    }


def _against(own: LogChange, rows: Places, values: Array, known_at: Places) -> Peers:
    """A motor against the others; their figures by night of the circuit, one column a motor."""
    values, known_at = values[rows], known_at[rows]
    here = rows[:, None]
    # Whose baseline is known in a night at all, whether or not it has a figure then.
    ready: NDArray[np.bool_] = np.any(known_at <= here, axis=1)
    cut = rows.copy()
    comparable = {}
    for part in own.segments:
        inside = np.arange(part.first, part.end)
        possible = inside[(own.known_at[inside] <= inside) & ready[inside]]
        first = int(possible[0]) if len(possible) else NEVER
        comparable[part.first] = first
        if first < NEVER:
            cut[part.first : first] = rows[first]
        else:
            cut[inside] = -1
    counted = np.where(known_at <= cut[:, None], values, np.nan)
    n_others = np.isfinite(counted).sum(axis=1)
    others = np.full(len(rows), np.nan)
    some = n_others > 0
    others[some] = row_medians(counted[some])
    # What was known in its own night; earlier nights only serve the baseline.
    own_told = np.where(cut == rows, own.told, np.nan)
    return Peers(others, own_told - others, n_others, comparable)

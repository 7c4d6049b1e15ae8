"""A motor's drain flow against that of the other motors of its oil circuit.

What a motor's baseline is, is known from its thirtieth good night on. What another motor did is
taken into account from the night on which it was known, and for the nights before that as far as it
was known when the two could first be compared: a night's state must not hang on later nights.

A motor whose baseline begins anew says nothing of the oil until it has a baseline again. What it
said last stands meanwhile where no other motor says anything, and is carried into its new baseline:
that one motor begins anew moves no other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import BaselineSettings, fit_baseline
from leakage.course.medians import medians_of_others
from pipeline.trends.figures.indicators import Indicator
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]
# Medians over the other motors, and how many they are: nights by motors.
_Others: TypeAlias = tuple[Array, Places]

# Good nights that say how far something has moved.
NIGHTS_OF_NOW = 5
# Of a night whose figure was never put against a baseline.
NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True)
class Contribution:
    """Contribution of a motor's indicator to the comparison in its circuit; shape (n,) each."""

    # ln of the indicator over the mean of the first good nights of its segment; each baseline
    # continues where the one before ended. nan where there is none.
    change: Array
    spoken: Array  # the same, as the other motors use it: without events entered later
    held: Array  # last contribution, in nights with a fit before a new baseline is known; else nan
    known_at: Places  # place of the night on which that mean was known; `NEVER` where it never was
    segments: tuple[Segment, ...]  # nights by baseline

    @property
    def known(self) -> Mask:
        """Nights in which their baseline was known."""
        return self.known_at <= np.arange(len(self.change))

    @property
    def standing(self) -> Array:
        """Contribution of each night, its own or the held one; nan where there is none."""
        return np.where(self.known, self.spoken, self.held)

    def last_said(self, history: History, place: int) -> float:
        """Contribution shortly before a night; nan if there is none."""
        recent = slice(max(place - history.spec.settings.alarms.stale_after_nights, 0), place)
        said = self.standing[recent]
        figures = np.flatnonzero(np.isfinite(np.where(self.known, self.change, self.held)[recent]))
        if not len(figures) or np.isnan(said[figures[-1]]):
            return np.nan
        return float(np.median(said[np.isfinite(said)][-NIGHTS_OF_NOW:]))

    def seen_before(self, history: History, place: int, earlier: Contribution) -> Contribution:
        """The same where others saw another one in the nights before a place.

        What they heard last is held from there on while the baseline is not known.
        """
        then = np.arange(len(self.change)) < place
        waits = np.cumsum(self.known & ~then) == 0
        last = np.where(history.fitted, earlier.last_said(history, place), np.nan)
        held = np.where(waits, last, self.held)
        return replace(
            self,
            spoken=np.where(then, earlier.spoken, self.spoken),
            held=np.where(then, earlier.held, held),
            known_at=np.where(then, earlier.known_at, self.known_at),
        )


@dataclass(frozen=True, slots=True)
class Peers:
    """Changes of the other motors of a motor's circuit; shape (n,) each, nights of the motor."""

    others: Array  # median of their contributions; nan: there is none, or nothing to compare with
    deviation: Array  # own log change less that median, where both were known in the night
    n_others: Places  # number of contributions
    # Place from which on a comparison was possible, by first place of each segment of the motor.
    comparable: Mapping[int, int]

    def known_from(self, segment: Segment) -> int:
        """Place from which on a segment's nights could be compared; its end where never."""
        return min(self.comparable[segment.first], segment.end)


def contribution(
    history: History, indicator: Indicator, parts: tuple[Segment, ...]
) -> Contribution:
    """Contribution of a motor's indicator; each baseline continues where the one before ended."""
    series, needed = indicator.watched, history.spec.settings.trend.provisional_nights
    change, held = np.full((2, len(series)), np.nan)
    known_at = np.full(len(series), NEVER, dtype=np.int64)
    settings = BaselineSettings(nights=needed, provisional_nights=needed)
    for part in parts:
        baseline = fit_baseline(history.numbers[part.here], series[part.here], settings)
        if baseline.status != "insufficient" and baseline.mean > 0:
            with np.errstate(invalid="ignore", divide="ignore"):
                log = np.log(series[part.here] / baseline.mean)
            change[part.here] = np.where(np.isfinite(log), log, np.nan)
            known_at[part.here] = history.place_of(baseline.last_night)
    spoken = change.copy()
    found = Contribution(change, spoken, held, known_at, parts)
    waits = history.fitted & ~found.known
    for part in parts[1:]:
        last = found.last_said(history, part.first)
        if np.isfinite(last):
            change[part.here] += last
            spoken[part.here] += last
            held[part.here] = np.where(waits[part.here], last, np.nan)
    return found


def peers_of_circuit(
    histories: Mapping[str, History], contributions: Mapping[str, Contribution]
) -> dict[str, Peers]:
    """Each motor of a circuit against the others, for one indicator."""
    motors = sorted(contributions)
    if len(motors) < 2:
        return {}
    labels = np.unique(np.concatenate([histories[motor].records["night"] for motor in motors]))
    shape = (len(labels), len(motors))
    spoken, held = np.full(shape, np.nan), np.full(shape, np.nan)
    known_at = np.full(shape, NEVER, dtype=np.int64)
    rows = []
    for column, motor in enumerate(motors):
        one, own = contributions[motor], np.searchsorted(labels, histories[motor].records["night"])
        rows.append(own)
        spoken[own, column], held[own, column] = one.spoken, one.held
        there = one.known_at < NEVER
        known_at[own[there], column] = own[one.known_at[there]]
    circuit = _Circuit(spoken, held, known_at)
    return {
        motor: circuit.against(column, contributions[motor], rows[column])
        for column, motor in enumerate(motors)
    }


@dataclass(slots=True)
class _Circuit:
    """Contributions of the motors of a circuit for one indicator: nights of the circuit by motors.

    Comparisons are computed for all motors at once, so that the cost per motor does not grow with
    the circuit.
    """

    spoken: Array
    held: Array
    known_at: Places
    _nights: _Others = field(init=False)
    _ready: Mask = field(init=False)
    _then: dict[int, _Others] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = self.known_at <= np.arange(len(self.spoken))[:, None]
        others, n_others = medians_of_others(np.where(known, self.spoken, np.nan))
        standing, n_standing = medians_of_others(self.held)
        silent = n_others == 0
        self._nights = (
            np.where(silent, standing, others),
            np.where(silent, n_standing, n_others),
        )
        # Whose baseline is known in a night at all, whether or not it has a figure then.
        self._ready = known.sum(axis=1, keepdims=True) > known

    def against(self, column: int, own: Contribution, rows: Places) -> Peers:
        """A motor against the others; its nights are these rows."""
        others, n_others = (one[rows, column] for one in self._nights)
        compared = np.ones(len(rows), dtype=np.bool_)
        comparable = {}
        for part in own.segments:
            inside = np.arange(part.first, part.end)
            ready = self._ready[rows[inside], column]
            possible = inside[(own.known_at[inside] <= inside) & ready]
            first = int(possible[0]) if len(possible) else NEVER
            comparable[part.first] = first
            before = inside[inside < first]
            compared[before] = False
            if first < NEVER:
                medians, numbers = self._as_known_in(int(rows[first]))
                others[before] = medians[rows[before], column]
                n_others[before] = numbers[rows[before], column]
            else:
                others[before], n_others[before] = np.nan, 0
        # What was known in its own night; earlier nights only serve the baseline.
        own_told = np.where(compared & own.known, own.change, np.nan)
        return Peers(others, own_told - others, n_others, comparable)

    def _as_known_in(self, night: int) -> _Others:
        """Contributions of the others in the nights before one, as known in that night."""
        if night not in self._then:
            known = self.known_at[:night] <= night
            self._then[night] = medians_of_others(np.where(known, self.spoken[:night], np.nan))
        return self._then[night]

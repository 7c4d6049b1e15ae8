"""A motor's nights in order, a record of numbers each: what the tables and the watch said of them.

Its checkpoint between runs has these records and the state of its watch.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.nights import night as night_labelled
from pipeline.config.nights import nights_between
from pipeline.trends.nights.decisions import LEAKAGE, SENSORS, Decision
from pipeline.trends.nights.watch_columns import WatchColumns

# A structured array, one record a night.
Records = NDArray[Any]

# Nights without a log after which nothing is said of a motor until it has one again.
LONGEST_SILENCE = 92
# Nights before, whose mean share of running hours a night without a log takes.
NIGHTS_BEFORE = 30
# Columns of `nights`.
OPERATED = (
    *("logged_hours", "running_hours"),
    *("pressure_zero_bar", "pressure_zero_upper"),
    *("flow_zero_l_per_min", "flow_zero_upper"),
)
# Charge above case pressure [bar], and measured viscosity over the data sheet's, of its blocks.
OF_BLOCKS = ("charge", "viscosity")
# What the watch said of a night: leakage at the reference and at the motor's own conditions
# [l/min].
WATCHED = ("reference_leakage", "own_leakage")
RECORD = np.dtype(
    [
        ("night", "M8[D]"),
        # Whether there is a row of it.
        ("known", "?"),
        ("model", "S16"),
        # Blocks that the watch counts.
        ("blocks", "i4"),
        *((name, "f8") for name in (*OF_BLOCKS, *OPERATED, *WATCHED)),
    ]
)


def blank_records(nights: Sequence[dt.date]) -> Records:
    """Return records of nights of which nothing is known."""
    records = np.zeros(len(nights), dtype=RECORD)
    for name in (*OF_BLOCKS, *OPERATED, *WATCHED):
        records[name] = np.nan
    records["night"] = np.array(nights, dtype="M8[D]")
    return records


@dataclass(frozen=True)
class History:
    """A motor's nights, one record each, increasing, with people's decisions on it.

    A night that no log covers is a night: what a run said of it then is said of it later, too.
    """

    spec: MotorSpec
    watch_columns: WatchColumns
    records: Records
    decisions: tuple[Decision, ...] = ()

    def __len__(self) -> int:
        return len(self.records)

    @cached_property
    def nights(self) -> tuple[dt.date, ...]:
        """Labels."""
        return tuple(self.records["night"].astype("M8[D]").tolist())

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Days since the first night, shape (n,)."""
        days = self.records["night"].astype(np.int64)
        since: NDArray[np.int64] = days - days[0]
        return since

    def place_from(self, date: dt.date) -> int:
        """Place of the first night from a date on; behind the last where there is none yet."""
        return int(np.searchsorted(self.records["night"], np.datetime64(date)))

    def running_hours(self, end: int) -> Array:
        """Return running hours since the first night at the end of each up to a place.

        Nights without a log take the mean of the 30 before."""
        hours: Array = self.records["running_hours"][:end]
        logged = np.isfinite(hours)
        sums = np.concatenate([[0.0], np.cumsum(hours[logged])])
        # Logged nights before each night, and the mean of the last thirty of them.
        before = np.cumsum(logged) - logged
        first = np.maximum(before - NIGHTS_BEFORE, 0)
        usual = (sums[before] - sums[first]) / np.maximum(before - first, 1)
        whole: Array = np.cumsum(np.where(logged, hours, usual))
        return whole


def every_night(records: Records, until: dt.date) -> Records:
    """Return records of every night up to one, those without a row as well.

    Of a motor that has been silent for long nothing is said any more: a clock was wrong, or it is
    gone.
    """
    known = records[records["known"] & (records["night"] <= np.datetime64(until))]
    if not len(known):
        return known
    days = known["night"].astype(np.int64)
    numbers = np.arange(days[0], np.datetime64(until).astype(np.int64) + 1)
    silent = numbers - days[np.searchsorted(days, numbers, "right") - 1]
    labels = nights_between(known["night"][0].item(), until)
    whole = blank_records([labels[place] for place in np.flatnonzero(silent <= LONGEST_SILENCE)])
    whole[np.searchsorted(whole["night"], known["night"])] = known
    return whole


EVENT_WORDS = {
    "overhaul": "overhaul",
    "oil_change": "oil change",
    "meter_changed": "other flow meter",
    "sensor_changed": "other sensor",
    "flushing_change": "change of flushing",
    "motor_exchanged": "motor exchanged",
}
# Events behind which the motor is the same: its baseline and its change go on (model.md, 7c.6).
CARRIED = ("oil_change", "meter_changed", "sensor_changed")
# What begins with a motor's first night.
FIRST_NIGHTS = "first nights"
OTHER_SETTINGS = "other settings from"


@dataclass(frozen=True, slots=True)
class BaselinePeriod:
    """Places of its nights, half open, and what it begins with, in words."""

    first: int
    end: int
    reason: str


def periods_of(history: History, of_what: str = LEAKAGE) -> tuple[BaselinePeriod, ...]:
    """Return the baseline periods of the leakage, or of a sensor's zero."""
    starts: dict[int, list[str]] = {0: []}
    borders = [] if of_what in SENSORS else _changed_settings(history)
    for event in sorted(history.spec.file.baseline_events, key=lambda event: event.date):
        note = f": {event.note}" if event.note else ""
        # What happened before the first night is nothing that its nights show.
        is_border = of_what in SENSORS or event.kind not in CARRIED
        if is_border and event.date >= history.nights[0]:
            words = f"{EVENT_WORDS[event.kind]} on {event.date}{note}"
            borders.append((history.place_from(event.date), words))
    for decision in history.decisions:
        # Of a sensor's zero, or under any other name of the leakage; without one of both.
        reset = decision.indicator if decision.indicator in (*SENSORS, "") else LEAKAGE
        if decision.kind == "baseline_reset" and reset in (of_what, ""):
            note = f": {decision.note}" if decision.note else ""
            borders.append(
                (history.place_from(decision.night), f"reset from {decision.night}{note}")
            )
    for place, words in borders:
        if place < len(history):
            starts.setdefault(place, []).append(words)
    places = [*sorted(starts), len(history)]
    return tuple(
        BaselinePeriod(first, end, "; ".join(starts[first]) or FIRST_NIGHTS)
        for first, end in pairwise(places)
    )


def period_at(periods: tuple[BaselinePeriod, ...], place: int) -> BaselinePeriod:
    """Return the baseline period of a night; the last one's for nights to come."""
    return next((period for period in periods if place < period.end), periods[-1])


def _changed_settings(history: History) -> list[tuple[int, str]]:
    """Return nights whose statistics were shaped by other settings than those before.

    A changed setting makes all nights anew whose logs are there; where they are not, the flows
    before and after cannot be compared. The oil is dated by an event of its own, and periods set
    by hand are of their night alone.
    """
    models = history.records["model"]
    known = np.flatnonzero(models != b"")
    if len(np.unique(models[known])) < 2:
        return []
    spec, changes = history.spec, []
    before: tuple[bytes, str] | None = None
    for place in known.tolist():
        label = history.nights[place]
        if spec.file.periods.within(night_labelled(label, spec.settings.nights)):
            continue
        now = bytes(models[place]), spec.file.oil_on(label)
        if before is not None and now[0] != before[0] and now[1] == before[1]:
            changes.append((place, f"{OTHER_SETTINGS} {label}"))
        before = now
    return changes

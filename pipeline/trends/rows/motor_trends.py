"""All rows of a motor's trends, made night by night as its watch takes them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from leakage.watch import Watch
from pipeline.night.rows import night_row
from pipeline.schema import ALARMS, NIGHTS, OF_TRENDS, TRENDS, Row, Table
from pipeline.schema.fits import NO_NEW_DATA
from pipeline.trends.nights.decisions import LEAKAGE, is_withdrawn
from pipeline.trends.nights.history import OTHER_SETTINGS, periods_of
from pipeline.trends.nights.published_nights import NO_LOG
from pipeline.trends.rows.alarm_rows import alarm_rows, what_of
from pipeline.trends.rows.motor_states import CHANGED, ORDER, STALE
from pipeline.trends.rows.night_rows import log_note, state_columns
from pipeline.trends.rows.trend_rows import leakage_rows, oil_as_measured, trend_rows
from pipeline.trends.sentences import CHECK_ZERO
from pipeline.trends.states.course import Course
from pipeline.trends.states.night_state import NightState
from pipeline.trends.states.zeros import Zero, sensor_zeros

DAY = dt.timedelta(days=1)
JUDGE = "Inspect it, enter what was done as an event, or reset the baseline: data cannot end it."


@dataclass(slots=True)
class MotorTrends:
    """A motor's trends: rows by table, of the nights from a first one on.

    `changed` is the last night so far in which a change was in force; `stays` says why nights stay
    as published; `drifts` are the sensors to be checked on each night, in words.
    """

    course: Course
    first: dt.date
    zeros: Mapping[str, Zero]
    changed: dt.date
    stays: Mapping[dt.date, str]
    rows: dict[Table, list[Row]]
    drifts: dict[dt.date, dict[str, str]] = field(default_factory=dict)

    @classmethod
    def of(cls, course: Course, first: dt.date, stays: Mapping[dt.date, str]) -> MotorTrends:
        """Return a motor of which no night is made yet."""
        zeros = sensor_zeros(course.nights.history)
        changed = _last_changed(course.nights.alarms, first)
        return cls(course, first, zeros, changed, stays, {NIGHTS: [], TRENDS: []})

    @property
    def nights(self) -> list[dt.date]:
        """Nights with rows."""
        return [row["night"] for row in self.rows[NIGHTS]]

    def add_night(self, others: Sequence[Watch]) -> None:
        """Make the rows of the watch's newest night; `others` are the tank's other motors."""
        self.course.know_circuit(others)
        night = self.course.state()
        label, nights, spec = night.night, self.course.nights, self.course.spec
        if label < self.first:
            return
        leakages, limits = leakage_rows(self.course, night)
        key = {"motor_id": spec.motor_id, "night": label}
        rows = [*leakages, *trend_rows(self.course, night, self.zeros)]
        self.rows[TRENDS] += [key | row for row in rows]
        drifts: dict[str, str] = {}
        notices: dict[str, str] = {}
        for name, zero in self.zeros.items():
            is_notice = zero.is_notice(self.course, night)
            words = zero.words(night.place, is_notice=is_notice)
            (notices if is_notice else drifts).update({name: words} if words else {})
        self.drifts[label] = drifts
        oil = oil_as_measured(nights.history, night.place)
        quiet_since = self._quiet_since(night)
        if night.state in CHANGED:
            self.changed = label
        self.rows[NIGHTS].append(
            {
                **(nights.rows.get(label) or night_row(spec, label, {}, NO_NEW_DATA, NO_LOG)),
                **dict.fromkeys(OF_TRENDS),
                **state_columns(night, quiet_since, [*drifts.values()], [*notices.values()]),
                **limits,
                "previous_model_fit_percent": nights.previous_model_fit_percent(label),
                "log_note": log_note(nights.history, night.place, self._messages(label), oil),
            }
        )

    def _messages(self, label: dt.date) -> list[str]:
        """Return what is to be said of a night's logs."""
        why = self.stays.get(label)
        return [
            *([f"as published: {why}"] if why else []),
            *self.course.nights.messages.get(label, ()),
        ]

    def _quiet_since(self, night: NightState) -> dt.date | None:
        """Return since when no change has been in force."""
        baseline = night.baseline
        return None if baseline is None else max(baseline.start, self.changed + DAY)

    def alarms(self) -> list[Row]:
        """Rows of `alarms` of these nights; the nights' states get the night that they began in."""
        history, published = self.course.nights.history, self.course.nights.alarms
        states: dict[str, Sequence[Row]] = {LEAKAGE: self.rows[NIGHTS]}
        for name, zero in self.zeros.items():
            places = map(history.place_from, self.nights)
            states[name] = [self._sensor_state(zero, place) for place in places]
        self._hold(published)
        rows = alarm_rows(states, published)
        before = [row for row in published if row["night"] < self.first]
        _add_state_since(self.rows[NIGHTS], [*before, *rows])
        return rows

    def _hold(self, published: Sequence[Row]) -> None:
        """Leave a state in force that nights of other settings cannot end, until people do."""
        of_leakage = [row for row in published if what_of(row) == LEAKAGE]
        last = max(of_leakage, key=itemgetter("night"), default=None)
        if last is None or last["to_state"] not in CHANGED:
            return
        history, raised = self.course.nights.history, last["night"]
        later = [period for period in periods_of(history) if history.nights[period.first] > raised]
        is_of_settings = {
            history.nights[period.first]: period.reason.startswith(OTHER_SETTINGS)
            for period in later
        }
        if not any(is_of_settings.values()) or is_withdrawn(history.decisions, raised):
            return
        ended = min((night for night, of_it in is_of_settings.items() if not of_it), default=None)
        for row in self.rows[NIGHTS]:
            is_weaker = ORDER.index(row["state"]) > ORDER.index(last["to_state"])
            is_later = row["night"] >= raised and (ended is None or row["night"] < ended)
            if is_later and is_weaker and row["state"] != STALE:
                words = f"in force since {raised} by the settings of then: {last['sentence']}"
                row |= {"state": last["to_state"], "cause": last["cause"], "advice": JUDGE}
                row["sentence"] = f"{words.removesuffix('.')}; now: {row['sentence']}"

    def _sensor_state(self, zero: Zero, place: int) -> Row:
        """Return state of a sensor in a night, in the columns of `nights`."""
        label = self.course.nights.history.nights[place]
        words = self.drifts[label].get(zero.name, "")
        state = "ok" if zero.state[place] == "warning" and not words else zero.state[place]
        return {
            "motor_id": self.course.spec.motor_id,
            "night": label,
            "state": state,
            "cause": zero.name,
            "sentence": words or "sensor zero recorded",
            "advice": CHECK_ZERO if state == "warning" else "",
        }

    def by_table(self) -> dict[Table, list[Row]]:
        """Return the rows of all tables, with the changes of state."""
        return {ALARMS: self.alarms(), **self.rows}


def _add_state_since(nights: Sequence[Row], changes: Sequence[Row]) -> None:
    """Add the night since which a state has been in force, by the changes of state so far."""
    left = sorted((row["night"], row["to_state"]) for row in changes if what_of(row) == LEAKAGE)
    left.reverse()
    state, since = "", None
    for row in nights:
        while left and left[-1][0] <= row["night"]:
            label, to_state = left.pop()
            if to_state != state:
                state, since = to_state, label
        if row["state"] == state != "ok":
            row["state_since"] = since


def _last_changed(alarms: Sequence[Row], first: dt.date) -> dt.date:
    """Return the last night before one in which a change of the leakage was in force."""
    states = sorted((row["night"], row["to_state"]) for row in alarms if what_of(row) == LEAKAGE)
    last, is_changed = dt.date.min, False
    for night, state in states:
        if night < first:
            last = night - DAY if is_changed else last
            is_changed = state in CHANGED
    return first - DAY if is_changed else last

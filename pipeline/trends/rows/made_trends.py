"""All rows of a motor's trends, made night by night as its watch is told them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from leakage.estimation.identifiability import TOLD
from leakage.watch import Estimate, Watch
from pipeline.clock import utc
from pipeline.config.nights import night as night_labelled
from pipeline.schema import ALARMS, BASELINES, TRENDS, WATCH, Table
from pipeline.trends.nights.decisions import LEAKAGE
from pipeline.trends.nights.trend_record import Record
from pipeline.trends.rows.alarm_rows import NightState, alarm_rows, marked
from pipeline.trends.rows.motor_states import CHANGED
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.rows.watch_rows import WatchRow, watch_row
from pipeline.trends.sentences import CHECK_ZERO
from pipeline.trends.states.course import Course, WatchedNight
from pipeline.trends.states.judged import JudgedNight, judged
from pipeline.trends.states.zeros import HALF, Zero, sensor_zeros

Row = dict[str, Any]

DAY = dt.timedelta(days=1)
NO_FIT: Row = {"status": "", "reference_verdict": None}


@dataclass(slots=True)
class MadeTrends:
    """A motor's trends: rows by table and states by indicator, of the nights from a first one on.

    `changed` is the last night so far in which a change stood told.
    """

    course: Course
    first: dt.date
    zeros: Mapping[str, Zero]
    changed: dt.date
    rows: dict[Table, list[Row]]
    states: dict[str, list[NightState]] = field(default_factory=dict)

    @classmethod
    def of(cls, course: Course, first: dt.date) -> MadeTrends:
        """A motor of which no night is made yet."""
        return cls(
            course,
            first,
            sensor_zeros(course.nights.history),
            _last_changed(course.nights.alarms, first),
            {WATCH: [], TRENDS: [], BASELINES: []},
        )

    @property
    def nights(self) -> list[dt.date]:
        """Nights with rows."""
        return [row["night"] for row in self.rows[WATCH]]

    def judge(self, others: Sequence[Watch]) -> None:
        """Make the rows of the night that was told last; `others` are the tank's other motors."""
        self.course.know_circuit(others)
        watched = self.course.watched()
        if watched.night < self.first:
            return
        nights = self.course.nights
        fit = nights.fits.get(watched.night, NO_FIT)
        why = "" if watched.n_blocks else nights.why_no_blocks(watched.night)
        night = judged(self.course.spec, watched, _of_fit(fit), why)
        drifts = [one for zero in self.zeros.values() if (one := zero.words(watched.place))]
        row = watch_row(night, self._quiet_since(watched), drifts)
        if night.state in CHANGED:
            self.changed = watched.night
        self.rows[WATCH].append(row.row)
        self.rows[TRENDS] += trend_rows(self.course, night, self.zeros, row.sentence)
        self.rows[BASELINES] += _baseline_rows(watched, self.course.spec.motor_id)
        self._note_states(night, row)

    def _quiet_since(self, watched: WatchedNight) -> dt.date | None:
        """Since when no change has been told."""
        if watched.baseline is None:
            return None
        if self.changed < watched.baseline.start:
            return watched.baseline.start
        return self.changed + DAY

    def _note_states(self, night: JudgedNight, row: WatchRow) -> None:
        label, place = night.watched.night, night.watched.place
        time = utc(night_labelled(label, night.spec.settings.nights).end_us)
        newest_night = row.tonight_change
        percent = None if newest_night is None else 100.0 * newest_night
        is_news = row.told_on == label and not row.goes_on
        advice = row.advice if night.state in (*CHANGED, "stale") else ""
        found = {
            LEAKAGE: NightState(
                *(label, time, night.state, night.way, row.sentence),
                *(row.path, percent, is_news, advice),
            )
        }
        for name, zero in self.zeros.items():
            words = zero.words(place) or "its zero is known"
            drifts = zero.state[place] == "warning"
            way, advice = ("drift", CHECK_ZERO) if drifts else ("baseline", "")
            found[name] = NightState(label, time, zero.state[place], way, words, advice=advice)
        for name, state in found.items():
            self.states.setdefault(name, []).append(state)

    def by_table(self, before: Record | None, record: Record) -> dict[Table, list[Row]]:
        """The rows of all tables, with the changes of state."""
        course = self.course
        published = course.nights.alarms
        rows = alarm_rows(course.spec.motor_id, self.states, published)
        alarms = marked(rows, published, before, record.rules)
        return {**self.rows, ALARMS: alarms}


def _last_changed(alarms: Sequence[Row], first: dt.date) -> dt.date:
    """The last night before one in which a change of the leakage stood told."""
    told = sorted((row["night"], row["to_state"]) for row in alarms if row["indicator"] == LEAKAGE)
    last, stands = dt.date.min, False
    for night, state in told:
        if night < first:
            last = night - DAY if stands else last
            stands = state in CHANGED
    return first - DAY if stands else last


def _of_fit(fit: Row) -> Estimate | None:
    """Leakage at the reference conditions by a night's own fit; None where it tells none."""
    if fit["reference_verdict"] not in TOLD or fit["reference_leakage_upper"] is None:
        return None
    value, upper = fit["reference_leakage_l_per_min"], fit["reference_leakage_upper"]
    return Estimate(value, (upper - value) / HALF)


def _baseline_rows(watched: WatchedNight, motor_id: str) -> list[Row]:
    """The row of a baseline, in the night in which it was frozen."""
    baseline, watch, verdict = watched.baseline, watched.watch, watched.verdict
    if baseline is None or watch is None or verdict is None or baseline.end != watched.night:
        return []
    own = watched.own
    row = {
        "motor_id": motor_id,
        "night": watched.night,
        "indicator": LEAKAGE,
        "start": baseline.start,
        "end": baseline.end,
        "n": baseline.n,
        "mean": own.value if isinstance(own, Estimate) else None,
        "unit": "l/min",
        "phi": watch.state.wander.serial,
        "reason": watched.period.reason,
        "own_pressure_bar": baseline.own.pressure_bar,
        "own_temperature_c": baseline.own.temperature_c,
        "own_speed_rpm": baseline.own.speed_rpm,
        "lack_of_fit": verdict.lack_of_fit,
    }
    return [row]

"""The trend stage: after all motors are done, each against its own past.

A task does whole oil circuits. It reads the published tables and writes only into its own staging
files; whatever goes wrong with a motor is that motor's.
"""

from __future__ import annotations

import datetime as dt
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from typing import TypeVar

import numpy as np

from leakage.watch import Change, Estimate, Watch
from pipeline.config.nights import DAY
from pipeline.errors import StoreError
from pipeline.night.rows import night_row
from pipeline.schema import ALARMS, NIGHTS, NO_NEW_DATA, OF_TRENDS, TRENDS, Row, Table
from pipeline.store.atomic_files import store_errors
from pipeline.store.publishing import stage, staged_file
from pipeline.trends.checkpoint import key_of
from pipeline.trends.course import Course
from pipeline.trends.decisions import LEAKAGE, is_withdrawn
from pipeline.trends.motor_states import (
    CHANGED,
    ORDER,
    STALE,
    alarm_rows,
    new_rows,
    what_of,
    without_past,
)
from pipeline.trends.night_state import NightState
from pipeline.trends.nights import (
    NO_LOG,
    OTHER_SETTINGS,
    BaselinePeriod,
    PublishedNights,
    read_nights,
)
from pipeline.trends.sentences import CHECK_ZERO, advice, sentence
from pipeline.trends.tasks import (
    Record,
    TrendOutcome,
    TrendTask,
    checkpoint_file,
    lost_trends,
)
from pipeline.trends.trend_rows import Zero, leakage_rows, oil_as_measured, sensor_zeros, trend_rows
from pipeline.workers.process import Loss, loss_of, one_thread, sign_of_life

log = logging.getLogger(__name__)

Made = TypeVar("Made")


def run_trends(task: TrendTask) -> TrendOutcome:
    """Make the trends of a task's motors, and stage their rows."""
    with one_thread():
        try:
            nights = read_nights(task.output, task.circuits)
        except StoreError as error:
            return lost_trends(task, _failure(error))
        done = TrendOutcome(failures=dict(task.given_up))
        for circuit in task.circuits:
            names = sorted(motor.spec.motor_id for motor in circuit)
            own = {name: nights[name] for name in names if name in nights}
            _run_circuit(task, own, done)
        return done


def _guard(done: TrendOutcome, motor_id: str, make: Callable[[], Made]) -> Made | None:
    """Do something of a motor that has not failed: it must not take others down."""
    if motor_id in done.failures:
        return None
    sign_of_life(motor_id)
    try:
        return make()
    except Exception as error:  # the edge of a motor's trends
        if not isinstance(error, StoreError):
            log.exception("trends of motor %s failed", motor_id)
        done.failures[motor_id] = _failure(error)
    finally:
        sign_of_life("")
    return None


def _failure(error: Exception) -> Loss:
    if isinstance(error, StoreError):
        return Loss(error.code, error.message)
    return loss_of(error)


def _run_circuit(
    task: TrendTask, nights: Mapping[str, PublishedNights], done: TrendOutcome
) -> None:
    """Make and stage the trends of a circuit's motors."""
    courses: dict[str, Course] = {}
    made: dict[str, MotorTrends] = {}
    for name, published in nights.items():
        course = _guard(done, name, partial(Course.of, task.output, published))
        if course is None:
            continue
        courses[name] = course
        if (first := published.motor.first) is not None:
            trends = _guard(done, name, partial(MotorTrends.of, course, first))
            made |= {} if trends is None else {name: trends}
    _advance(courses, made, done)
    for name, trends in made.items():
        staged = _guard(done, name, partial(_stage_motor, task, trends))
        if staged is not None:
            done.records[name], new, notified = staged
            done.alarms.extend(notified)
            done.silent.extend(row["id"] for row in new if row not in notified)


def _advance(
    courses: Mapping[str, Course], made: Mapping[str, MotorTrends], done: TrendOutcome
) -> None:
    """Advance the watches of a circuit's motors night by night, all of them before the next."""
    nights = {label for course in courses.values() for label in course.nights_to_come}
    for night in sorted(nights):
        for name, course in courses.items():
            if course.nights_to_come[:1] == (night,):
                _guard(done, name, course.step)
        watches = {
            name: course.watch
            for name, course in courses.items()
            if course.night == night and course.watch is not None
        }
        for name, trends in made.items():
            if trends.course.night == night:
                others = [watch for other, watch in watches.items() if other != name]
                _guard(done, name, partial(trends.add_night, others))


def _stage_motor(
    task: TrendTask, trends: MotorTrends
) -> tuple[Record, list[Row], list[Row]] | None:
    """Stage a motor's rows and checkpoint; return its record, new alarms, those to notify of."""
    nights, labels = trends.course.nights, trends.nights
    motor, motor_id = nights.motor, nights.spec.motor_id
    if not labels:
        return None
    rows = trends.by_table()
    staged: dict[Table, dict[dt.date, list[Row]]] = {}
    for table, some in rows.items():
        by_night = staged[table] = {label: [] for label in labels}
        for row in some:
            by_night[row["night"]].append(row)
    stage(staged_file(task.staging / "trends", motor_id), staged)
    path = checkpoint_file(task.staging, motor_id)
    checkpoint = trends.course.checkpoint(key_of(motor.trend_hash))
    with store_errors(path):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(checkpoint.encoded())
    new = new_rows(rows[ALARMS], nights.alarms)
    last_night = dt.date.min if motor.record is None else motor.record.last_night
    notified = without_past(rows[ALARMS], new, nights.alarms, last_night)
    return Record(motor.trend_hash, labels[-1]), new, notified


JUDGE = "Inspect it, enter what was done as an event, or reset the baseline: data cannot end it."
# A night is short that has less than this share of the short ones of the last nights before.
SHORT, NIGHTS_COMPARED, FEWEST_COMPARED = 0.8, 14, 5


@dataclass(slots=True)
class MotorTrends:
    """A motor's trends: rows by table, of the nights from a first night on.

    `changed` is the last night so far in which a change was in force; `drifts` are the sensors to
    be checked on each night, in words.
    """

    course: Course
    first: dt.date
    zeros: Mapping[str, Zero]
    changed: dt.date
    rows: dict[Table, list[Row]] = field(default_factory=lambda: {NIGHTS: [], TRENDS: []})
    drifts: dict[dt.date, dict[str, str]] = field(default_factory=dict)

    @classmethod
    def of(cls, course: Course, first: dt.date) -> MotorTrends:
        """Return a motor of which no night is made yet."""
        changed = _last_changed(course.nights.alarms, first)
        return cls(course, first, sensor_zeros(course.nights), changed)

    @property
    def nights(self) -> list[dt.date]:
        """Nights with rows."""
        return [row["night"] for row in self.rows[NIGHTS]]

    def add_night(self, others: Sequence[Watch]) -> None:
        """Make the rows of the watch's newest night; `others` are the tank's other motors."""
        course, nights = self.course, self.course.nights
        if course.watch is not None:
            course.watch = course.watch.beside(others)
        night = course.state()
        label, place = night.night, night.place
        if label < self.first:
            return
        leakages, limits = leakage_rows(course, night)
        key = {"motor_id": nights.spec.motor_id, "night": label}
        rows = [*leakages, *trend_rows(course, night, self.zeros)]
        self.rows[TRENDS] += [key | row for row in rows]
        drifts: dict[str, str] = {}
        notices: dict[str, str] = {}
        for name, zero in self.zeros.items():
            is_notice = zero.is_notice(course, night)
            words = zero.words(place, is_notice=is_notice)
            (notices if is_notice else drifts).update({name: words} if words else {})
        self.drifts[label] = drifts
        # Since when no change has been in force.
        quiet_since = None
        if night.baseline is not None:
            quiet_since = max(night.baseline.start, self.changed + DAY)
        if night.state in CHANGED:
            self.changed = label
        why = nights.motor.stays.get(label)
        messages = [f"as published: {why}"] if why else []
        messages += nights.messages.get(label, [])
        oil = oil_as_measured(nights, place)
        own = nights.rows.get(label) or night_row(nights.spec, label, {}, NO_NEW_DATA, NO_LOG)
        self.rows[NIGHTS].append(
            {
                **own,
                **dict.fromkeys(OF_TRENDS),
                **_state_columns(night, quiet_since, [*drifts.values()], [*notices.values()]),
                **limits,
                "previous_model_fit_percent": nights.previous_model_fit_percent(label),
                "log_note": _log_note(nights, place, messages, oil),
            }
        )

    def by_table(self) -> dict[Table, list[Row]]:
        """Return the rows of all tables; the nights' states get the night that they began in."""
        nights, published = self.course.nights, self.course.nights.alarms
        states: dict[str, Sequence[Row]] = {LEAKAGE: self.rows[NIGHTS]}
        for name, zero in self.zeros.items():
            places = map(nights.place_from, self.nights)
            states[name] = [self._sensor_state(zero, place) for place in places]
        self._hold(published)
        rows = alarm_rows(states, published)
        before = [row for row in published if row["night"] < self.first]
        _add_state_since(self.rows[NIGHTS], [*before, *rows])
        return {ALARMS: rows, **self.rows}

    def _hold(self, published: Sequence[Row]) -> None:
        """Leave a state in force that nights of other settings cannot end, until people do."""
        of_leakage = [row for row in published if what_of(row) == LEAKAGE]
        last = max(of_leakage, key=itemgetter("night"), default=None)
        if last is None or last["to_state"] not in CHANGED:
            return
        nights, raised = self.course.nights, last["night"]
        is_of_settings = {
            nights.labels[period.first]: period.reason.startswith(OTHER_SETTINGS)
            for period in nights.periods()
            if nights.labels[period.first] > raised or self._is_older(last, period)
        }
        if not any(is_of_settings.values()) or is_withdrawn(nights.motor.decisions, raised):
            return
        ended = min((night for night, of_it in is_of_settings.items() if not of_it), default=None)
        for row in self.rows[NIGHTS]:
            is_weaker = ORDER.index(row["state"]) > ORDER.index(last["to_state"])
            is_later = row["night"] >= raised and (ended is None or row["night"] < ended)
            if is_later and is_weaker and row["state"] != STALE:
                words = f"in force since {raised} by the settings of then: {last['sentence']}"
                row |= {"state": last["to_state"], "cause": last["cause"], "advice": JUDGE}
                row["sentence"] = f"{words.removesuffix('.')}; now: {row['sentence']}"

    def _is_older(self, change: Row, period: BaselinePeriod) -> bool:
        """Return whether a change was detected by other settings than those of its night's period.

        That has no whole baseline yet, so that its own watch could not have.
        """
        nights = self.course.nights
        place = nights.place_from(change["night"])
        n_before = np.count_nonzero(nights.records["blocks"][period.first : place + 1])
        return bool(
            period.reason.startswith(OTHER_SETTINGS)
            and place < period.end
            and change["cause"] is not None
            and n_before <= nights.spec.settings.trend.baseline_nights
        )

    def _sensor_state(self, zero: Zero, place: int) -> Row:
        """Return state of a sensor in a night, in the columns of `nights`."""
        label = self.course.nights.labels[place]
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
    """Return the last night before that in which a change of the leakage was in force."""
    states = sorted((row["night"], row["to_state"]) for row in alarms if what_of(row) == LEAKAGE)
    last, is_changed = dt.date.min, False
    for night, state in states:
        if night < first:
            last = night - DAY if is_changed else last
            is_changed = state in CHANGED
    return first - DAY if is_changed else last


def _state_columns(
    night: NightState,
    quiet_since: dt.date | None,
    drifts: Sequence[str],
    notices: Sequence[str],
) -> Row:
    """Return leakages, their change, the state with its words, and the baseline of a night."""
    change, verdict, baseline = night.change, night.verdict, night.baseline
    row: Row = {
        "state": night.state,
        "sentence": sentence(night, quiet_since, [*drifts, *notices]),
        "advice": advice(night, drifts),
        "alarm_level_percent": night.spec.settings.alarms.alarm_percent,
        **_leakages(night),
    }
    if change is not None:
        row |= _of_change(night, change)
    if baseline is not None:
        row |= {
            "baseline_start": baseline.start,
            "baseline_end": baseline.end,
            "own_pressure_bar": baseline.own.pressure_bar,
            "own_temperature_c": baseline.own.temperature_c,
            "own_speed_rpm": baseline.own.speed_rpm,
        }
    if verdict is not None:
        row |= {
            "evidence": verdict.evidence if math.isfinite(verdict.evidence) else None,
            "evidence_limit": verdict.limit,
            "model_error_percent": 100.0 * verdict.lack_of_fit,
            "detection_limit_percent": verdict.smallest and 100.0 * verdict.smallest,
            **_percent("mean_change", verdict.present),
        }
        if night.n_blocks:
            row |= _percent("leakage_change", verdict.newest_night)
    return row


def _of_change(night: NightState, change: Change) -> Row:
    candidates = sorted(change.candidates.items(), key=lambda pair: -pair[1])
    row: Row = {
        "cause": change.cause,
        "cause_probability": change.probability or None,
        "candidates": [{"cause": name, "probability": p} for name, p in candidates],
        "onset": dt.date.fromordinal(change.since),
        "onset_earliest": dt.date.fromordinal(change.since_lower),
        "onset_latest": dt.date.fromordinal(change.since_upper),
        "detected_on": dt.date.fromordinal(change.detected_on),
        "still_rising": change.continues,
        "likely_iso_vg": change.grade,
    }
    if night.gap_growth is not None:
        row |= _percent("gap_change", night.gap_growth)
    if night.circuit is not None:
        row |= _percent("circuit_change", night.circuit.of_circuit)
        row |= _percent("own_part", night.circuit.own)
    return row


def _leakages(night: NightState) -> Row:
    """Return leakages at the motor's own and at the reference conditions, or why any is missing."""
    if not night.n_blocks:
        return {"leakage_reason": night.why_no_blocks}
    row: Row = {}
    for name, leakage in (
        ("reference_leakage", night.reference or night.reference_leakage),
        ("own_leakage", night.own_leakage),
    ):
        if isinstance(leakage, str):
            row["leakage_reason"] = leakage
        else:
            row |= {f"{name}_l_per_min": leakage.value}
            row |= {f"{name}_lower": leakage.lower, f"{name}_upper": leakage.upper}
    return row


def _percent(name: str, size: Estimate) -> Row:
    """Return a relative figure with its interval."""
    return {
        f"{name}_percent": 100.0 * size.value,
        f"{name}_lower": 100.0 * size.lower,
        f"{name}_upper": 100.0 * size.upper,
    }


def _log_note(nights: PublishedNights, place: int, messages: Sequence[str], oil: str) -> str | None:
    """Return what the log of a night lacks, and the oil as measured; None: there is nothing."""
    hours = nights.records["logged_hours"]
    before = hours[max(place - NIGHTS_COMPARED, 0) : place]
    before = np.sort(before[np.isfinite(before)])
    parts = [*messages, *filter(None, [oil])]
    # Nights before that are short, too, 1 in 5, are no measure.
    if len(before) >= FEWEST_COMPARED and hours[place] < SHORT * before[len(before) // 5]:
        usual = float(np.median(before))
        parts.insert(0, f"{hours[place]:.1f} h of log, {usual:.1f} h in the nights before")
    return "; ".join(parts) or None

"""The trend stage: after all motors are done, each against its own past.

A task does whole oil circuits. It reads the published tables and writes only into its own staging
files; whatever goes wrong with a motor is that motor's.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeVar

from pipeline.errors import StoreError
from pipeline.schema import ALARMS, Row, Table
from pipeline.store.atomic_files import store_errors
from pipeline.store.publishing import stage, staged_file
from pipeline.trends.alarm_rows import new_rows, without_past
from pipeline.trends.checkpoint import key_of
from pipeline.trends.course import Course
from pipeline.trends.motor_trends import MotorTrends
from pipeline.trends.nights import PublishedNights, read_nights
from pipeline.trends.tasks import (
    Record,
    TrendOutcome,
    TrendTask,
    checkpoint_file,
    lost_trends,
)
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


def _guarded(done: TrendOutcome, motor_id: str, make: Callable[[], Made]) -> Made | None:
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
        course = _guarded(done, name, partial(Course.of, task.output, published))
        if course is None:
            continue
        courses[name] = course
        if (first := published.motor.first) is not None:
            trends = _guarded(done, name, partial(MotorTrends.of, course, first))
            made |= {} if trends is None else {name: trends}
    _advance(courses, made, done)
    for name, trends in made.items():
        staged = _guarded(done, name, partial(_stage_motor, task, trends))
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
                _guarded(done, name, course.step)
        watches = {
            name: course.watch
            for name, course in courses.items()
            if course.night == night and course.watch is not None
        }
        for name, trends in made.items():
            if trends.course.night == night:
                others = [watch for other, watch in watches.items() if other != name]
                _guarded(done, name, partial(trends.add_night, others))


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

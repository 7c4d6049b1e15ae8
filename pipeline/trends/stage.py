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
from pipeline.schema import ALARMS, Table
from pipeline.store.atomic_files import store_errors
from pipeline.store.publishing import stage, staged_file
from pipeline.trends.nights.checkpoint import decoded, key_of
from pipeline.trends.nights.published_nights import PublishedNights, Wanted, read_nights
from pipeline.trends.nights.trend_record import Record
from pipeline.trends.rows.alarm_rows import new_rows, without_past
from pipeline.trends.rows.motor_trends import MotorTrends
from pipeline.trends.states.course import Course
from pipeline.trends.tasks import Circuit, Row, TrendOutcome, TrendTask, checkpoint_file
from pipeline.workers.process import Loss, loss_of, one_thread, sign_of_life

log = logging.getLogger(__name__)

Made = TypeVar("Made")


def run_trends(task: TrendTask) -> TrendOutcome:
    """Make the trends of a task's motors, and stage their rows."""
    with one_thread():
        done = TrendOutcome(failures=dict(task.given_up))
        try:
            nights = read_nights(task.output, [_wanted(task, circuit) for circuit in task.circuits])
        except StoreError as error:
            ids = (spec.motor_id for spec in task.specs)
            return TrendOutcome(failures=dict.fromkeys(ids, _failure(error)))
        for circuit in task.circuits:
            own = {name: nights[name] for name in sorted(circuit.records) if name in nights}
            _run_circuit(task, circuit, own, done)
        return done


def _wanted(task: TrendTask, circuit: Circuit) -> list[Wanted]:
    """Return what is needed of the motors of a circuit."""
    spans = circuit.spans(task.changed_from, task.newest_night)
    wanted = []
    for spec in circuit.specs:
        motor_id, record = spec.motor_id, circuit.records[spec.motor_id]
        decisions, checkpoint = circuit.decisions[motor_id], None
        if record is not None and record.trend_hash == circuit.hashes[motor_id]:
            expected = key_of(spec, decisions), record.last_night
            checkpoint = decoded(task.checkpoints.get(motor_id))
            if checkpoint and (checkpoint.key, checkpoint.last_night) != expected:
                checkpoint = None
        unpublished = task.unpublished.get(motor_id, {})
        wanted.append(Wanted(spec, decisions, checkpoint, *spans[motor_id], unpublished))
    return wanted


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
    task: TrendTask, circuit: Circuit, nights: Mapping[str, PublishedNights], done: TrendOutcome
) -> None:
    """Make and stage the trends of a circuit's motors."""
    courses: dict[str, Course] = {}
    made: dict[str, MotorTrends] = {}
    for name, motor in nights.items():
        course = _guarded(done, name, partial(Course.of, task.output, motor))
        if course is None:
            continue
        courses[name] = course
        if motor.wanted.first is not None:
            first, stays = motor.wanted.first, task.stays.get(name, {})
            trends = _guarded(done, name, partial(MotorTrends.of, course, first, stays))
            made |= {} if trends is None else {name: trends}
    _advance(courses, made, done)
    for name, trends in made.items():
        staged = _guarded(done, name, partial(_stage_motor, task, circuit, trends))
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
    task: TrendTask, circuit: Circuit, trends: MotorTrends
) -> tuple[Record, list[Row], list[Row]] | None:
    """Stage a motor's rows and its checkpoint.

    Its record, new alarms, and those of them that people are notified of.
    """
    history = trends.course.nights.history
    spec, labels = history.spec, trends.nights
    if not labels:
        return None
    motor_id, before = spec.motor_id, circuit.records[spec.motor_id]
    record = Record(circuit.hashes[motor_id], labels[-1])
    rows = trends.by_table()
    staged: dict[Table, dict[dt.date, list[Row]]] = {}
    for table, some in rows.items():
        nights = staged[table] = {label: [] for label in labels}
        for row in some:
            nights[row["night"]].append(row)
    stage(staged_file(task.staging / "trends", motor_id), staged)
    path = checkpoint_file(task.staging, motor_id)
    with store_errors(path):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(trends.course.checkpoint(key_of(spec, history.decisions)).encoded())
    published = trends.course.nights.alarms
    new = new_rows(rows[ALARMS], published)
    last_night = dt.date.min if before is None else before.last_night
    return record, new, without_past(rows[ALARMS], new, published, last_night)

"""Publishing of a run: nights of its motors, then their trends."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import ceil
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.clock import latest_us
from pipeline.config import Fleet
from pipeline.config.nights import night_of
from pipeline.errors import EngineError, StoreError
from pipeline.logs.ledger import forget_nights, staged_change, write_change
from pipeline.run.tasks import MotorOutcome
from pipeline.schema import (
    ALARMS,
    DATA_DICTIONARY,
    DECISIONS,
    LATEST,
    NIGHT_TABLES,
    TREND_TABLES,
    data_dictionary,
    frame,
)
from pipeline.store.interrupts import interrupts_held
from pipeline.store.publishing import Publisher
from pipeline.store.state import State
from pipeline.store.tables import read_table, whole_file
from pipeline.telling.outbox import take_up
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.nights.tonight import Tonight, tonight_of
from pipeline.trends.nights.trend_record import forget_records, note_touched, write_record
from pipeline.trends.rows.latest_states import latest_states
from pipeline.trends.rows.motor_states import latest_rows
from pipeline.trends.tasks import (
    TrendOutcome,
    TrendTask,
    kept_file,
    lost_trends,
    trend_tasks,
    without_lost_motor,
)
from pipeline.workers.engine import Workers
from pipeline.workers.process import Loss

log = logging.getLogger(__name__)

# A task of trends reads the tables of all its motors at once; it has fewer where workers wait.
MOTORS_A_TREND_TASK = 32


def publish_motors(publisher: Publisher, state: State, outcomes: Sequence[MotorOutcome]) -> int:
    """Publish the rows that the motors' tasks have staged, then their ledgers."""
    forgotten: list[tuple[Collection[dt.date], Collection[str]]] = []

    def forget(nights: Collection[dt.date], keep: Collection[str]) -> None:
        forgotten.append((nights, keep))
        forget_nights(state, nights, keep)

    note_touched(state, ((one.motor_id, min(one.nights)) for one in outcomes if one.nights))
    # Of a motor without a new night there may be the row of a log that is of none.
    staged = [outcome.motor_id for outcome in outcomes if outcome.finished]

    def published() -> None:
        for motor_id in staged:
            change = staged_change(publisher.staging, motor_id)
            if change is not None:
                write_change(state, motor_id, change)
        _note_published(state, any(outcome.nights for outcome in outcomes))
        for nights, keep in forgotten:  # what a task has found unchanged is to be read again
            forget_nights(state, nights, keep)

    publisher.nights("nights", NIGHT_TABLES, staged, forget, published)
    publisher.whole(DATA_DICTIONARY, data_dictionary())
    return sum(len(outcome.nights) for outcome in outcomes)


@dataclass(frozen=True, slots=True)
class PublishedTrends:
    """Failures by motor, new rows of `alarms`, and whether an interrupt came while publishing.

    `tonight` is None where the tables have none, or could not be read.
    """

    tonight: Tonight | None = None
    failures: Mapping[str, Loss] = field(default_factory=dict)
    alarms: Sequence[Mapping[str, Any]] = ()
    interrupted: bool = False


def publish_trends(
    fleet: Fleet,
    clock: dt.datetime,
    publisher: Publisher,
    state: State,
    outcomes: Sequence[MotorOutcome],
    workers: Workers,
) -> PublishedTrends:
    """Make and publish the trends of the run's motors."""
    decisions = read_decisions(fleet.output)
    said = [asdict(one) | {"run_id": publisher.run_id} for one in decisions]
    publisher.whole(DECISIONS, frame(DECISIONS, said).sort(DECISIONS.key))
    changed = {one.motor_id: min(one.nights, default=None) for one in outcomes}
    try:
        tonight = fleets_tonight(fleet, clock)
    except StoreError as error:
        return PublishedTrends(failures=dict.fromkeys(changed, Loss(error.code, error.message)))
    if tonight is None:
        return PublishedTrends()
    # As many tasks for each worker, as far as circuits allow.
    n_workers = fleet.execution.workers
    n_tasks = n_workers * ceil(len(changed) / (n_workers * MOTORS_A_TREND_TASK))
    tasks = trend_tasks(
        fleet.motors,
        state,
        publisher.staging,
        changed,
        tonight,
        decisions,
        ceil(len(changed) / max(n_tasks, 1)),
    )
    made: list[TrendOutcome] = []
    try:
        made += workers.run(run_trends, tasks, lost_trends, without_lost_motor)
    except EngineError as error:  # the nights are published: the next run makes the trends
        log.warning("%s; the next run makes the trends", error)
        made = [lost_trends(task, Loss(error.code, error.message)) for task in tasks]
    failures = {motor_id: loss for one in made for motor_id, loss in one.failures.items()}
    with interrupts_held() as came:
        alarms = _publish_trend_rows(publisher, fleet, made)
    return PublishedTrends(tonight, failures, alarms, bool(came))


def _note_published(state: State, has_changed: bool) -> None:
    """Count what was published: `latest` is made again where there is more since."""
    if has_changed:
        state.set_meta("revision", str(int(state.meta("revision") or 0) + 1))


def publish_latest(publisher: Publisher, state: State, fleet: Fleet) -> None:
    """Publish the state of each motor; where a table is damaged, that of the run before stays."""
    output, motor_ids = publisher.output, sorted(spec.motor_id for spec in fleet.motors)
    published = _published_latest(output)
    is_of_all = published["motor_id"].to_list() == motor_ids
    ((n_decisions,),) = state.rows("SELECT count(*) FROM decisions")
    made_of = f"revision {state.meta('revision')}, {n_decisions} decisions"
    if is_of_all and state.meta("latest") == made_of:
        return
    try:
        states = latest_states(output, motor_ids)
    except StoreError as error:
        log.warning("%s; the table `latest` stays as it was", error)
        return
    rows = frame(LATEST, latest_rows(states, publisher.run_id)).sort(LATEST.key)
    if not rows.drop("run_id").equals(published.drop("run_id")):
        publisher.whole(LATEST, rows)
    state.set_meta("latest", made_of)


def run_trends(task: TrendTask) -> TrendOutcome:
    """As `stage.run_trends`, with which a process loads the science."""
    from pipeline.trends import stage

    return stage.run_trends(task)


def _published_latest(output: Path) -> pl.DataFrame:
    """The table `latest` of the run before; empty where there is none that is whole."""
    try:
        return read_table(whole_file(output, LATEST), LATEST)
    except StoreError as error:
        if error.code != "store_read":
            raise
        return frame(LATEST, [])


def fleets_tonight(fleet: Fleet, clock: dt.datetime) -> Tonight | None:
    """Tonight, as `tonight_of`, by the clock of a run."""
    latest = night_of(latest_us(clock), fleet.settings.nights)
    return tonight_of(fleet.output, [spec.motor_id for spec in fleet.motors], latest)


def _publish_trend_rows(
    publisher: Publisher, fleet: Fleet, made: Sequence[TrendOutcome]
) -> list[Mapping[str, Any]]:
    """Publish what the tasks have staged, and queue it; returns the new rows of `alarms`."""
    state = publisher.state
    if not made:
        return []
    records = {motor_id: one for some in made for motor_id, one in sorted(some.records.items())}
    lost: list[Collection[str]] = []

    def forget(_: Collection[dt.date], keep: Collection[str]) -> None:
        lost.append(keep)
        forget_records(state, keep)

    def published() -> None:
        for motor_id, record in records.items():
            if all(motor_id in keep for keep in lost):
                kept = kept_file(publisher.staging, motor_id).read_bytes()
                write_record(state, motor_id, record, kept)
        _note_published(state, bool(records))
        take_up(state, fleet.name)

    publisher.nights("trends", TREND_TABLES, sorted(records), forget, published)
    new = [row for one in made for row in one.alarms]
    return sorted(new, key=lambda row: tuple(str(row[name]) for name in ALARMS.key))

"""Publishing of a run: nights of its motors, then their trends."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import ceil
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.clock import latest_us
from pipeline.config import Fleet
from pipeline.config.nights import night_of
from pipeline.errors import EngineError, StoreError
from pipeline.logs.ledger import forget_nights, ledger_folder
from pipeline.run.tasks import MotorOutcome
from pipeline.schema import (
    ALARMS,
    DATA_DICTIONARY,
    DECISIONS,
    FITS,
    LATEST,
    NIGHT_TABLES,
    TREND_TABLES,
    WATCH,
    data_dictionary,
    frame,
)
from pipeline.store.atomic_files import remove, take_over
from pipeline.store.interrupts import interrupts_held
from pipeline.store.publishing import Publisher
from pipeline.store.tables import month_stamps, read_table, whole_file
from pipeline.trends.nights.decisions import journal_file, read_decisions
from pipeline.trends.nights.tonight import Tonight, tonight_of
from pipeline.trends.nights.trend_record import (
    forget_records,
    kept_file,
    note_touched,
    record_file,
)
from pipeline.trends.rows.latest_states import latest_states
from pipeline.trends.rows.motor_states import latest_rows
from pipeline.trends.tasks import (
    TrendOutcome,
    TrendTask,
    lost_trends,
    trend_tasks,
    without_lost_motor,
)
from pipeline.workers.engine import RunTasks, results_of
from pipeline.workers.process import Loss

log = logging.getLogger(__name__)

# A task of trends reads the tables of all its motors at once; it has fewer where workers wait.
MOTORS_A_TREND_TASK = 32


def publish_motors(publisher: Publisher, outcomes: Sequence[MotorOutcome]) -> int:
    """Publish the rows that the motors' tasks have staged, then their ledgers."""
    output, staging = publisher.output, publisher.staging

    def forget(nights: Collection[dt.date], keep: Collection[str]) -> None:
        for place in (output, staging):
            forget_nights(place, nights, keep)

    for outcome in outcomes:
        if outcome.nights:
            note_touched(output, outcome.motor_id, min(outcome.nights))
    # Of a motor without a new night there may be the row of a log that is of none.
    staged = [outcome.motor_id for outcome in outcomes if outcome.finished]
    publisher.nights("nights", NIGHT_TABLES, staged, forget)
    publisher.whole(DATA_DICTIONARY, data_dictionary())
    ledgers = {
        file: ledger_folder(output, motor_id) / file.name
        for motor_id in staged
        for file in sorted(ledger_folder(staging, motor_id).glob("*"))
    }
    take_over(staging, ledgers)
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
    outcomes: Sequence[MotorOutcome],
    run_tasks: RunTasks,
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
    workers = fleet.execution.workers
    n_tasks = workers * ceil(len(changed) / (workers * MOTORS_A_TREND_TASK))
    tasks = trend_tasks(
        fleet.motors,
        fleet.output,
        publisher.staging,
        changed,
        tonight,
        decisions,
        ceil(len(changed) / max(n_tasks, 1)),
    )
    made: list[TrendOutcome] = []
    try:
        made += results_of(run_tasks, run_trends, tasks, lost_trends, without_lost_motor)
    except EngineError as error:  # the nights are published: the next run makes the trends
        log.warning("%s; the next run makes the trends", error)
        made = [lost_trends(task, Loss(error.code, error.message)) for task in tasks]
    failures = {motor_id: loss for one in made for motor_id, loss in one.failures.items()}
    with interrupts_held() as came:
        alarms = _publish_trend_rows(publisher, made)
    return PublishedTrends(tonight, failures, alarms, bool(came))


def publish_latest(publisher: Publisher, fleet: Fleet) -> None:
    """Publish the state of each motor; where a table is damaged, that of the run before stays."""
    output, motor_ids = publisher.output, sorted(spec.motor_id for spec in fleet.motors)
    published = _published_latest(output)
    is_of_all = published["motor_id"].to_list() == motor_ids
    # The times of a working copy's files say nothing of when they were made.
    if is_of_all and not fleet.object_store and _nothing_since(whole_file(output, LATEST)):
        return
    try:
        states = latest_states(output, motor_ids)
    except StoreError as error:
        log.warning("%s; the table `latest` stays as it was", error)
        return
    rows = frame(LATEST, latest_rows(states, publisher.run_id)).sort(LATEST.key)
    if not rows.drop("run_id").equals(published.drop("run_id")):
        publisher.whole(LATEST, rows)


def run_trends(task: TrendTask) -> TrendOutcome:
    """As `stage.run_trends`, with which a process loads the science."""
    from pipeline.trends import stage

    return stage.run_trends(task)


def _nothing_since(path: Path) -> bool:
    """True if neither fits nor trends nor decisions were published after a file of theirs."""
    output = path.parents[2]
    stamps = [*month_stamps(output, FITS).values(), *month_stamps(output, WATCH).values()]
    journal = journal_file(output)
    if journal.exists():
        stamps.append(journal.stat().st_mtime_ns)
    return max(stamps, default=0) < path.stat().st_mtime_ns


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


def _remove_older(kept: Iterable[Path]) -> None:
    """Remove what older versions kept, beside what is kept now."""
    for file in kept:
        for other in file.parent.glob("*"):
            if other != file:
                remove(other)


def _publish_trend_rows(
    publisher: Publisher, made: Sequence[TrendOutcome]
) -> list[Mapping[str, Any]]:
    """Publish what the tasks have staged; returns the new rows of `alarms`."""
    if not made:
        return []
    fresh = sorted(motor_id for one in made for motor_id, n in one.nights.items() if n)
    lost: list[Collection[str]] = []

    def forget(_: Collection[dt.date], keep: Collection[str]) -> None:
        lost.append(keep)
        forget_records(publisher.output, keep)

    publisher.nights("trends", TREND_TABLES, fresh, forget)
    done = [one for one in fresh if all(one in keep for keep in lost)]
    # What is kept first: without its record it is not believed.
    for file in (kept_file, record_file):
        places = {file(publisher.staging, one): file(publisher.output, one) for one in done}
        take_over(publisher.staging, places)
    _remove_older(kept_file(publisher.output, one) for one in done)
    new = [row for one in made for row in one.alarms]
    return sorted(new, key=lambda row: tuple(str(row[name]) for name in ALARMS.key))

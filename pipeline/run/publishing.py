"""Publishing of a run: nights of its motors, their trends, and the rows of the run itself."""

from __future__ import annotations

import datetime as dt
import hashlib
import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.clock import latest_us, microseconds
from pipeline.config import Fleet, MotorSpec
from pipeline.config.hashes import config_hash, hash_of, own_version
from pipeline.config.nights import DAY, night_of
from pipeline.errors import StoreError
from pipeline.logs.processed import note_published, unpublished_rows, write_change
from pipeline.notification.outbox import pass_over
from pipeline.run.tasks import MotorOutcome, RunRequest, RunResult
from pipeline.schema import (
    ALARMS,
    DATA_DICTIONARY,
    LATEST,
    NIGHT_TABLES,
    NIGHTS,
    RUN_MOTORS,
    RUNS,
    SCHEMA_VERSION,
    TREND_TABLES,
    data_dictionary,
    frame,
)
from pipeline.store.publishing import Publisher, stage, staged_file, write_views
from pipeline.store.state import StateDatabase
from pipeline.store.tables import read_rows, read_table, whole_file
from pipeline.trends.decisions import Decision, read_decisions
from pipeline.trends.motor_states import (
    CARRIED,
    REMOVED,
    in_state_before,
    is_confirmed,
    latest_rows,
)
from pipeline.trends.tasks import (
    NewestNight,
    TrendOutcome,
    TrendTask,
    checkpoint_file,
    lost_trends,
    newest_night_of,
    note_touched,
    trend_tasks,
    without_lost_motor,
    write_record,
)
from pipeline.workers.engine import Workers
from pipeline.workers.process import Loss

log = logging.getLogger(__name__)

# First night with new rows by motor; None without any.
Changed = Mapping[str, dt.date | None]

# Seconds of a motor's task by stage, and of a run, as `runs` names them.
MOTOR_STAGES = (
    "read_s",
    "clean_s",
    "statistics_s",
    "fit_s",
    "residuals_s",
    "refit_s",
    "store_s",
)
STAGES = ("motors_s", "publish_s", "trends_s")
# A task of trends reads the tables of all its motors at once; it has fewer where workers wait.
MOTORS_A_TREND_TASK = 32


def publish_motors(publisher: Publisher, outcomes: Sequence[MotorOutcome]) -> int:
    """Publish what the motors' tasks have staged; returns how many nights."""
    state = publisher.state
    touched = {outcome.motor_id: outcome.changed_from for outcome in outcomes}
    note_touched(state, ((name, first) for name, first in touched.items() if first))

    def published() -> None:
        for outcome in outcomes:
            write_change(state, outcome.motor_id, outcome.change)
        if any(touched.values()):
            state.set_meta("latest", "")

    # Of a motor without a new night there may be the row of a log that is of none.
    staged = [outcome.motor_id for outcome in outcomes if outcome.finished]
    publisher.nights("nights", NIGHT_TABLES, staged, published)
    return sum(len(outcome.nights) for outcome in outcomes)


def make_trends(
    fleet: Fleet, clock: dt.datetime, publisher: Publisher, workers: Workers, changed: Changed
) -> list[TrendOutcome]:
    """Stage the trends of a run's motors, given the first night with new rows of each, or None."""
    try:
        newest_night = newest_of_fleet(fleet, publisher.state, clock)
    except StoreError as error:
        loss = Loss(error.code, error.message)
        return [TrendOutcome(failures=dict.fromkeys(changed, loss))]
    if newest_night is None:
        return []
    # As many tasks for each worker, as far as circuits allow.
    n_workers = fleet.execution.workers
    n_tasks = n_workers * ceil(len(changed) / (n_workers * MOTORS_A_TREND_TASK))
    tasks = trend_tasks(
        fleet.motors,
        publisher.state,
        publisher.staging,
        changed,
        newest_night,
        read_decisions(fleet.output),
        ceil(len(changed) / max(n_tasks, 1)),
    )
    return list(workers.run(run_trends, tasks, lost_trends, without_lost_motor))


def run_trends(task: TrendTask) -> TrendOutcome:
    """Run `stage.run_trends`, with which a process loads the science."""
    from pipeline.trends import stage

    return stage.run_trends(task)


def newest_of_fleet(fleet: Fleet, state: StateDatabase, clock: dt.datetime) -> NewestNight | None:
    """Return newest night, as `newest_night_of`; of a silent fleet the last by a run's clock."""
    nights = fleet.settings.nights
    latest = night_of(latest_us(clock), nights)
    newest = newest_night_of(state, [spec.motor_id for spec in fleet.motors], latest)
    ended = night_of(microseconds(clock), nights) - DAY
    if newest is not None and fleet.is_live and ended - newest.night > fleet.stale_after:
        further = {name: night for name, night in newest.further.items() if night > ended}
        newest = NewestNight(ended, further)
    return newest


def publish_trends(publisher: Publisher, made: Sequence[TrendOutcome]) -> list[Mapping[str, Any]]:
    """Publish what the tasks have staged; returns the new rows of `alarms`."""
    state = publisher.state
    records = {
        motor_id: record for task in made for motor_id, record in sorted(task.records.items())
    }

    def published() -> None:
        for motor_id, record in records.items():
            checkpoint = checkpoint_file(publisher.staging, motor_id).read_bytes()
            write_record(state, motor_id, record, checkpoint)
            note_published(state, motor_id, record.last_night)
        if records:
            state.set_meta("latest", "")
        pass_over(state, {name for task in made for name in task.silent})

    publisher.nights("trends", TREND_TABLES, sorted(records), published)
    new = [row for task in made for row in task.alarms]
    return sorted(new, key=lambda row: tuple(str(row[name]) for name in ALARMS.key))


def publish_other_nights(publisher: Publisher, motor_ids: Iterable[str]) -> None:
    """Publish nights that no trends were made of, in the state that was in force before them.

    They lie after the fleet's newest night with samples, or are of a motor whose trends failed.
    """
    state = publisher.state
    unpublished = {name: nights for name in motor_ids if (nights := unpublished_rows(state, name))}
    if not unpublished:
        return
    try:
        published = read_rows(state.output, NIGHTS, [*unpublished], ("motor_id", "night", *CARRIED))
    except StoreError as error:
        log.warning("%s; the next run publishes the nights without trends", error)
        return
    for name, nights in unpublished.items():
        before = published.filter(motor_id=name).sort("night")
        rows = {night: [in_state_before(row, before)] for night, row in nights.items()}
        stage(staged_file(publisher.staging / "nights", name), {NIGHTS: rows})

    def note() -> None:
        for name in unpublished:
            note_published(state, name, dt.date.max)
        state.set_meta("latest", "")

    publisher.nights("nights", [NIGHTS], [*unpublished], note)


def publish_whole_tables(publisher: Publisher, fleet: Fleet) -> None:
    """Publish the columns, and the state of each motor.

    Where a table is damaged, `latest` stays as it was.
    """
    state, output = publisher.state, publisher.state.output
    publisher.whole(DATA_DICTIONARY, data_dictionary())
    motor_ids = sorted(spec.motor_id for spec in fleet.motors)
    published = _published_latest(output)
    decisions = read_decisions(output)
    own = {name for motor in fleet.motors for name in (motor.motor_id, motor.file.formerly)}
    gone = _gone_motors(state, published, own, decisions)
    made_of = f"{len(decisions)} decisions"
    before = dict(published.select("motor_id", pl.col("state") == REMOVED).rows())
    expected = {name: name in gone for name in (*motor_ids, *gone)}
    if before == expected and state.meta("latest") == made_of:
        return
    try:
        some = latest_rows(output, motor_ids, gone)
    except StoreError as error:
        log.warning("%s; the table `latest` stays as it was", error)
        return
    rows = frame(LATEST, [row | {"run_id": publisher.run_id} for row in some]).sort(LATEST.key)
    if not rows.drop("run_id").equals(published.drop("run_id")):
        publisher.whole(LATEST, rows)
    state.set_meta("latest", made_of)


def _gone_motors(
    state: StateDatabase,
    published: pl.DataFrame,
    own: Collection[str],
    decisions: Sequence[Decision],
) -> list[str]:
    """Return motors that the config has no more, and of which nobody has confirmed it."""
    before = {row["motor_id"]: row for row in published.to_dicts()}
    known = before.keys() | {motor_id for (motor_id,) in state.rows("SELECT motor_id FROM motors")}
    gone = sorted(known.difference(own))
    for name in gone:
        if name in before and before[name]["state"] != REMOVED:
            what = "it stays in `latest` as removed until `motor-leakage ack` confirms it"
            log.warning(
                "%s is in the config no more, and was %s: %s", name, before[name]["state"], what
            )
    rows = {name: before.get(name) or latest_rows(state.output, [name])[0] for name in gone}
    return [name for name, row in rows.items() if row["night"] and not is_confirmed(row, decisions)]


def _published_latest(output: Path) -> pl.DataFrame:
    """Return the table `latest` of the run before; empty where there is none that is whole."""
    try:
        return read_table(whole_file(output, LATEST), LATEST)
    except StoreError as error:
        if error.code != "store_read":
            raise
        return frame(LATEST, [])


def run_id_of(outcomes: Sequence[MotorOutcome], specs: Sequence[MotorSpec]) -> str:
    """Return hash of the code, the settings of all motors, and the contents that were read."""
    settings = hash_of({spec.motor_id: config_hash(spec) for spec in specs})
    inputs = [text for outcome in outcomes for text in (outcome.motor_id, *outcome.inputs)]
    text = "|".join((own_version(), str(SCHEMA_VERSION), settings, *inputs))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def publish_run(
    publisher: Publisher,
    request: RunRequest,
    result: RunResult,
    started: dt.datetime,
) -> None:
    """Publish the rows of `runs` and `run_motors`, and the views of all tables."""
    fleet = request.fleet
    run = {
        "run_id": result.run_id,
        "started_at": started,
        "finished_at": dt.datetime.now(dt.UTC),
        "status": "interrupted"
        if result.interrupted
        else "motors_failed"
        if not result.is_good
        else "ok",
        "fleet": fleet.name,
        "version": own_version(),
        "workers": fleet.execution.workers,
        "n_motors": len(result.outcomes),
        "n_motors_failed": len(result.failed),
        "n_nights": result.n_nights,
        "total_s": result.seconds,
        "damage": [str(fault) for fault in result.damage],
    }
    rows = [_outcome_row(outcome, result.run_id, started) for outcome in result.outcomes]
    publisher.add(f"{started:%Y-%m}", {RUNS: [run], RUN_MOTORS: rows})
    write_views(fleet.output)


def _outcome_row(outcome: MotorOutcome, run_id: str, started: dt.datetime) -> Mapping[str, object]:
    statuses = ("ok", "stood_still", "insufficient_data", "no_new_data", "failed")
    return {
        "run_id": run_id,
        "started_at": started,
        "motor_id": outcome.motor_id,
        "status": outcome.status,
        "error_code": outcome.error_code,
        "message": outcome.message,
        "peak_memory_mib": outcome.peak_memory_mib,
        "n_refitted": outcome.n_refitted,
        "read_s": outcome.seconds.get("read_s", 0.0),
        "total_s": sum(outcome.seconds.values()),
        **{f"n_{status}": outcome.counts.get(status, 0) for status in statuses},
    }

"""The nightly run: one motor a task over worker processes, then the tables, night by night.

Tasks share nothing and return small outcomes as they finish. A motor whose worker dies costs that
motor its run and no other: what was finished is kept, and each lost task is tried once more alone.
"""

from __future__ import annotations

import datetime as dt
import fcntl
import hashlib
import logging
import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.config import Fleet
from pipeline.decisions import Decision, read_decisions
from pipeline.errors import LockedError, StoreError
from pipeline.ledger import forget_night, write_months
from pipeline.log_shelf import FATES
from pipeline.motor_night import FAILED
from pipeline.motor_task import MotorOutcome, MotorTask, lost, run_motor
from pipeline.night_statistics import hash_of
from pipeline.notify import notify
from pipeline.schema import (
    ALARMS,
    DATA_DICTIONARY,
    DECISIONS,
    FITS,
    MOTOR_OUTCOMES,
    NIGHT_TABLES,
    RUNS,
    SCHEMA_VERSION,
    TREND_TABLES,
    TRENDS,
    data_dictionary,
    frame,
)
from pipeline.settings_hashes import config_hash as hash_of_config
from pipeline.store import (
    StagedRows,
    last_night,
    publish_night,
    publish_run_table,
    remove_leftovers,
    table_folder,
    write_table,
)
from pipeline.trends.stage import (
    TrendOutcome,
    TrendTask,
    run_trends,
    trend_tasks,
    with_q_values,
    write_record,
)
from pipeline.workers import run_tasks

log = logging.getLogger(__name__)

Progress = Callable[[MotorOutcome], None]

# A task of trends reads the tables of all its motors at once.
MOTORS_A_TREND_TASK = 32


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What a run is asked to do.

    Attributes
    ----------
    fleet
        The config.
    motors
        Ids of the motors to do; empty for all.
    since, until
        Labels of the first and last night to do; None: no limit.
    """

    fleet: Fleet
    motors: tuple[str, ...] = ()
    since: dt.date | None = None
    until: dt.date | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """What came of a run.

    Attributes
    ----------
    run_id
        Hash of the inputs' contents, the code's version and the config.
    outcomes
        One a motor, sorted by id.
    n_nights
        Nights of motors that were written.
    interrupted
        Whether the run was stopped before all motors were done; what was finished is published.
    seconds
        Wall-clock time.
    alarms
        New rows of `alarms`.
    """

    run_id: str
    outcomes: tuple[MotorOutcome, ...]
    n_nights: int
    interrupted: bool
    seconds: float
    alarms: tuple[Mapping[str, Any], ...] = ()

    @property
    def files(self) -> Counter[str]:
        """Log files of all motors by what came of them: read, unchanged, growing, failed, left."""
        return sum((Counter(outcome.files) for outcome in self.outcomes), Counter())

    @property
    def failed(self) -> tuple[MotorOutcome, ...]:
        """Motors with at least one failed night."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == FAILED)


def run_fleet(request: RunRequest, progress: Progress = lambda _: None) -> RunResult:
    """Fit every new night of a fleet's motors and publish the tables.

    Parameters
    ----------
    request
        Fleet, and which part of it.
    progress
        Called with each motor's outcome as it finishes.

    Returns
    -------
    RunResult

    Raises
    ------
    LockedError
        If another run writes to the same output.
    StoreError
        If nothing can be published.
    """
    output = request.fleet.output
    with _locked(output), _staging(output) as staging:
        remove_leftovers([output / "tables", output / "ledger"])
        return _run(request, staging, progress)


def _run(request: RunRequest, staging: Path, progress: Progress) -> RunResult:
    started, begin = dt.datetime.now(dt.UTC), time.perf_counter()
    fleet = request.fleet
    tasks = [
        MotorTask(spec, fleet.output, staging, request.since, request.until)
        for spec in fleet.motors
        if not request.motors or spec.motor_id in request.motors
    ]
    outcomes: dict[str, MotorOutcome] = {}
    interrupted = False
    try:
        for outcome in run_tasks(run_motor, tasks, _lost, fleet.execution):
            outcomes[outcome.motor_id] = outcome
            progress(outcome)
    except KeyboardInterrupt:
        interrupted = True
    finished = [outcomes[motor_id] for motor_id in sorted(outcomes)]
    config_hash = _config_hash(tasks)
    run_id = _run_id(finished, config_hash)
    n_nights = _publish(fleet.output, staging, finished, run_id)
    alarms: list[Mapping[str, Any]] = []
    if not interrupted:
        finished, alarms = _publish_trends(request, staging, finished, run_id)
    seconds = time.perf_counter() - begin
    result = RunResult(
        run_id, tuple(finished), n_nights, interrupted, seconds, alarms=tuple(alarms)
    )
    _publish_run(request, result, started, config_hash)
    for fault in notify(fleet.settings.alarms, fleet.name, alarms):
        log.warning("%s", fault)
    return result


def _lost(task: MotorTask, how: str) -> MotorOutcome:
    return lost(task, "worker_died", f"its worker died twice: {how}")


def _lost_trends(task: TrendTask, how: str) -> TrendOutcome:
    words = f"the worker of its trends died twice: {how}"
    return TrendOutcome(failures={spec.motor_id: words for spec in task.specs})


@contextmanager
def _locked(output: Path) -> Iterator[None]:
    """Hold the output for one run; the lock ends with the process, however that ends."""
    try:
        output.mkdir(parents=True, exist_ok=True)
        stream = (output / "lock").open("a+", encoding="utf-8")
    except OSError as error:
        raise StoreError(
            "store_write", f"{output} cannot be written: {error.strerror}; choose another output"
        ) from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = stream.read().strip() or "unknown"
            raise LockedError("locked", f"another run writes to this output: {holder}") from None
        except OSError as error:
            raise StoreError(
                "store_write", f"{output} cannot be locked: {error.strerror}; choose a local folder"
            ) from error
        stream.truncate(0)
        stream.write(
            f"process {os.getpid()} since {dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M:%S} UTC\n"
        )
        stream.flush()
        yield


@contextmanager
def _staging(output: Path) -> Iterator[Path]:
    """A folder for this run's staged rows; those of killed runs are removed."""
    root = output / "staging"
    shutil.rmtree(root, ignore_errors=True)
    try:
        root.mkdir(parents=True)
        folder = Path(tempfile.mkdtemp(dir=root))
    except OSError as error:
        raise StoreError(
            "store_write", f"{root} cannot be written: {error.strerror}; look what is there"
        ) from error
    try:
        yield folder
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _publish(output: Path, staging: Path, outcomes: Sequence[MotorOutcome], run_id: str) -> int:
    """Publish all staged rows, a table and a night at a time, then what was remembered of them."""
    fresh = [outcome for outcome in outcomes if outcome.nights]
    lost_nights: set[dt.date] = set()
    for table in NIGHT_TABLES:
        staged = {
            one.motor_id: StagedRows(path)
            for one in fresh
            if (path := staging / table.name / f"{one.motor_id}.arrow").exists()
        }
        for night in sorted({night for rows in staged.values() for night in rows.nights}):
            new = {
                motor_id: found
                for motor_id, rows in staged.items()
                if (found := rows.rows(night)) is not None
            }
            if publish_night(output, table, night, new, run_id):
                lost_nights.add(night)
    write_table(
        table_folder(output, DATA_DICTIONARY) / "data_dictionary.parquet", data_dictionary()
    )
    for outcome in outcomes:
        write_months(output, outcome.motor_id, outcome.ledger)
    for night in sorted(lost_nights):
        forget_night(output, night, {one.motor_id for one in fresh if night in one.nights})
    return sum(len(outcome.nights) for outcome in fresh)


def _publish_trends(
    request: RunRequest, staging: Path, outcomes: Sequence[MotorOutcome], run_id: str
) -> tuple[list[MotorOutcome], list[Mapping[str, Any]]]:
    """Make and publish the trends of the run's motors; one whose trends failed has failed."""
    fleet = request.fleet
    decisions = read_decisions(fleet.output)
    _publish_decisions(fleet.output, decisions, run_id)
    changed = {one.motor_id: min(one.nights, default=None) for one in outcomes}
    tonight = last_night(fleet.output, FITS)
    if tonight is None:
        return list(outcomes), []
    tasks = trend_tasks(
        fleet.motors, fleet.output, staging, changed, tonight, decisions, MOTORS_A_TREND_TASK
    )
    failures: dict[str, str] = {}
    alarms: list[Mapping[str, Any]] = []
    for outcome in run_tasks(run_trends, tasks, _lost_trends, fleet.execution):
        alarms += _publish_trend_rows(fleet.output, staging, outcome, run_id)
        failures |= outcome.failures
    judged = [
        replace(one, status=FAILED, error_code="trend", message=failures[one.motor_id])
        if one.motor_id in failures and one.status != FAILED
        else one
        for one in outcomes
    ]
    return judged, alarms


def _publish_trend_rows(
    output: Path, staging: Path, outcome: TrendOutcome, run_id: str
) -> list[Mapping[str, Any]]:
    """Publish what a task has staged; returns the new rows of `alarms`."""
    alarms: list[Mapping[str, Any]] = []
    fresh = [motor_id for motor_id, nights in outcome.nights.items() if nights]
    for table in TREND_TABLES:
        staged = {one: StagedRows(staging / table.name / f"{one}.arrow") for one in fresh}
        for night in sorted({night for rows in staged.values() for night in rows.nights}):
            new = {
                motor_id: found
                for motor_id, rows in staged.items()
                if (found := rows.rows(night)) is not None
            }
            finish = partial(with_q_values, motor_ids=list(new)) if table is TRENDS else _as_it_is
            publish_night(output, table, night, new, run_id, finish)
            if table is ALARMS:
                alarms += [row for rows in new.values() for row in rows.to_dicts()]
    for motor_id, record in outcome.records.items():
        write_record(output, motor_id, record)
    return alarms


def _publish_decisions(output: Path, decisions: Sequence[Decision], run_id: str) -> None:
    rows = [asdict(one) | {"run_id": run_id} for one in decisions]
    write_table(
        table_folder(output, DECISIONS) / "decisions.parquet",
        frame(DECISIONS, rows).sort(DECISIONS.key),
    )


def _as_it_is(rows: pl.DataFrame) -> pl.DataFrame:
    return rows


def _config_hash(tasks: Sequence[MotorTask]) -> str:
    return hash_of({task.spec.motor_id: hash_of_config(task.spec) for task in tasks})


def _run_id(outcomes: Sequence[MotorOutcome], config_hash: str) -> str:
    inputs = [one for outcome in outcomes for one in (outcome.motor_id, *outcome.inputs)]
    text = "|".join((version("motor-leakage"), str(SCHEMA_VERSION), config_hash, *inputs))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _publish_run(
    request: RunRequest, result: RunResult, started: dt.datetime, config_hash: str
) -> None:
    fleet = request.fleet
    seeds = {spec.settings.estimation.seed for spec in fleet.motors}
    run = {
        "run_id": result.run_id,
        "started_at": started,
        "finished_at": dt.datetime.now(dt.UTC),
        "status": "interrupted"
        if result.interrupted
        else "motors_failed"
        if result.failed
        else "ok",
        "fleet": fleet.name,
        "version": version("motor-leakage"),
        "schema_version": SCHEMA_VERSION,
        "config_hash": config_hash,
        "seed": min(seeds),
        "workers": fleet.execution.workers,
        "n_motors": len(result.outcomes),
        "n_motors_failed": len(result.failed),
        "n_nights": result.n_nights,
        "seconds": result.seconds,
    }
    publish_run_table(fleet.output, RUNS, started, frame(RUNS, [run]))
    rows = [_outcome_row(outcome, result.run_id, started) for outcome in result.outcomes]
    publish_run_table(fleet.output, MOTOR_OUTCOMES, started, frame(MOTOR_OUTCOMES, rows))


def _outcome_row(outcome: MotorOutcome, run_id: str, started: dt.datetime) -> Mapping[str, object]:
    stages = ("read_s", "clean_s", "statistics_s", "fit_s", "refit_s", "store_s")
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
        **{stage: outcome.seconds.get(stage, 0.0) for stage in stages},
        **{f"n_{status}": outcome.counts.get(status, 0) for status in statuses},
        **{f"n_files_{fate}": outcome.files.get(fate, 0) for fate in FATES},
        "growing": list(outcome.growing),
    }

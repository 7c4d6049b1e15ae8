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
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from pipeline.config import Fleet
from pipeline.errors import LockedError, StoreError
from pipeline.ledger import forget_night, write_ledger
from pipeline.log_shelf import FATES
from pipeline.motor_night import FAILED
from pipeline.motor_task import MotorOutcome, MotorTask, lost, run_motor, settings_hash
from pipeline.night_statistics import hash_of
from pipeline.schema import (
    DATA_DICTIONARY,
    MOTOR_OUTCOMES,
    NIGHT_TABLES,
    RUNS,
    SCHEMA_VERSION,
    data_dictionary,
    frame,
)
from pipeline.store import (
    StagedRows,
    publish_night,
    publish_run_table,
    remove_leftovers,
    table_folder,
    write_table,
)

log = logging.getLogger(__name__)

Progress = Callable[[MotorOutcome], None]

# Tasks handed out ahead, for each worker; of these one can have killed its worker.
SUSPECTS_A_WORKER = 2


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
    """

    run_id: str
    outcomes: tuple[MotorOutcome, ...]
    n_nights: int
    interrupted: bool
    seconds: float

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
        for outcome in _outcomes(tasks, fleet):
            outcomes[outcome.motor_id] = outcome
            progress(outcome)
    except KeyboardInterrupt:
        interrupted = True
    finished = [outcomes[motor_id] for motor_id in sorted(outcomes)]
    config_hash = _config_hash(tasks)
    run_id = _run_id(finished, config_hash)
    n_nights = _publish(fleet.output, staging, finished, run_id)
    result = RunResult(run_id, tuple(finished), n_nights, interrupted, time.perf_counter() - begin)
    _publish_run(request, result, started, config_hash)
    return result


def _outcomes(tasks: Sequence[MotorTask], fleet: Fleet) -> Iterator[MotorOutcome]:
    """Outcomes as the motors finish, in any order."""
    execution = fleet.execution
    if execution.backend == "sequential" or execution.workers == 1 or len(tasks) < 2:
        yield from map(run_motor, tasks)
        return
    # Workers read this when they start: with all threads each they would fight for the cores.
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    waiting = {task.spec.motor_id: task for task in tasks}
    while waiting:
        try:
            for outcome in _parallel(list(waiting.values()), execution.workers):
                del waiting[outcome.motor_id]
                yield outcome
        except TerminatedWorkerError:
            # Tasks start in order: whichever killed its worker is among the first that wait.
            suspects = list(waiting.values())[: SUSPECTS_A_WORKER * execution.workers]
            log.warning("a worker died; %d motors are tried again, each alone", len(suspects))
            for task in suspects:
                del waiting[task.spec.motor_id]
                yield _alone(task)


def _parallel(tasks: Sequence[MotorTask], workers: int) -> Iterator[MotorOutcome]:
    with parallel_config(backend="loky", inner_max_num_threads=1), warnings.catch_warnings():
        # An interrupted run cancels what is under way, and says so itself.
        warnings.filterwarnings("ignore", ".*still being processed by the workers", UserWarning)
        pool = Parallel(n_jobs=workers, return_as="generator_unordered", batch_size=1)
        yield from pool(delayed(run_motor)(task) for task in tasks)


def _alone(task: MotorTask) -> MotorOutcome:
    """A task in a worker of its own, so that its death costs nobody else."""
    try:
        # Two workers, one task: a single one would run it in this very process.
        return next(iter(_parallel([task], 2)))
    except TerminatedWorkerError as error:
        return lost(task, "worker_died", f"its worker died twice: {error.args[0].splitlines()[0]}")


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
            one.motor_id: StagedRows(staging / table.name / f"{one.motor_id}.arrow")
            for one in fresh
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
        if outcome.ledger is not None:
            write_ledger(output, outcome.motor_id, outcome.ledger)
    for night in sorted(lost_nights):
        forget_night(output, night, {one.motor_id for one in fresh if night in one.nights})
    return sum(len(outcome.nights) for outcome in fresh)


def _config_hash(tasks: Sequence[MotorTask]) -> str:
    return hash_of({task.spec.motor_id: settings_hash(task.spec) for task in tasks})


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
    stages = ("read_s", "clean_s", "statistics_s", "fit_s", "store_s")
    statuses = ("ok", "stood_still", "insufficient_data", "no_new_data", "failed")
    return {
        "run_id": run_id,
        "started_at": started,
        "motor_id": outcome.motor_id,
        "status": outcome.status,
        "error_code": outcome.error_code,
        "message": outcome.message,
        "peak_memory_mib": outcome.peak_memory_mib,
        **{stage: outcome.seconds.get(stage, 0.0) for stage in stages},
        **{f"n_{status}": outcome.counts.get(status, 0) for status in statuses},
        **{f"n_files_{fate}": outcome.files.get(fate, 0) for fate in FATES},
        "growing": list(outcome.growing),
    }

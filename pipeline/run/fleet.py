"""The nightly run: a motor a task over worker processes, then the tables, night by night.

Tasks share nothing and return small outcomes as they finish. What was finished is kept where a
worker dies; the tasks that were under way are tried once more, each alone.
"""

from __future__ import annotations

import datetime as dt
import logging
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

from polars.exceptions import PanicException

from pipeline.config import Execution, Fleet, MotorSpec
from pipeline.errors import StoreError
from pipeline.logs.files import stat_log
from pipeline.logs.finding import find_logs, legible
from pipeline.logs.processed import FileRecord, read_processed
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import open_outbox, receivers_of
from pipeline.run import publishing
from pipeline.run.night_plan import NightPlan
from pipeline.run.notification import deliver_alarms, settle_intraday, write_run_metrics
from pipeline.run.output import (
    Nights,
    claim_output,
    damage_left,
    find_damage,
    forget_lost,
    require_own_output,
)
from pipeline.run.tasks import (
    MotorOutcome,
    MotorTask,
    RunRequest,
    RunResult,
    lost,
    without_lost_part,
)
from pipeline.schema import FAILED
from pipeline.store.atomic_files import (
    interrupts_held,
    locked,
    make_folders,
    remove_leftovers,
    store_errors,
)
from pipeline.store.heartbeat import Heartbeat, last_good_run, runs_back
from pipeline.store.object_store import ObjectStore, copy_output
from pipeline.store.published import TableFault
from pipeline.store.publishing import Publisher
from pipeline.store.state import LAST_RUN, StateDatabase, make_ready, open_state
from pipeline.trends.decisions import publish_decisions, restore_decisions
from pipeline.trends.tasks import TrendOutcome
from pipeline.workers.engine import Workers, open_workers
from pipeline.workers.process import Loss, Mark

__all__ = ["RunRequest", "RunResult", "run_fleet"]

log = logging.getLogger(__name__)

# A night of a hundred motors writes some tens of MiB; a disk that fills half way costs a repair.
MINIMUM_FREE_MIB = 100

Progress = Callable[[MotorOutcome], None]


def run_fleet(
    request: RunRequest,
    progress: Progress = lambda _: None,
    watched: Callable[[Callable[[], Sequence[Mark]]], None] = lambda _: None,
) -> RunResult:
    """Fit every new night of a fleet's motors and publish the tables.

    `progress` is called with the outcome of each motor as it finishes, `watched` once with what
    gives the marks of the tasks under way.

    Raises LockedError if another run writes to the same output; StoreError if nothing can be
    published, there is too little room for it, or the logs' object store cannot be listed;
    EngineError if there is nothing that tasks could run on.
    """
    fleet, output = request.fleet, request.fleet.output
    receivers = receivers_of(fleet.settings.alarms)
    if fleet.log_url:  # otherwise each of the motors would fail of it
        next(ObjectStore.at(fleet.log_url).list(), None)
    _require_space(output)
    with locked(output):
        require_own_output(fleet)
        with Heartbeat(output, len(request.specs), last_good_run(output)) as heartbeat:
            with _prepare(request, heartbeat, receivers) as run:
                watched(run.workers.marks)
                run.fit_motors(progress)
                run.publish_nights()
                run.stage_trends()
                run.publish_tables()
                result = run.record()
            result = _notify(fleet, receivers, heartbeat, result)
            # Whoever waits for this may run at once.
            heartbeat.finished(interrupted=result.interrupted, good=result.is_good)
    return result


def _require_space(output: Path) -> None:
    """Refuse a run with little room on the disk, which would end it half way."""
    present = next(folder for folder in (output, *output.parents) if folder.exists())
    free_mib = shutil.disk_usage(present).free / 1024**2
    if free_mib < MINIMUM_FREE_MIB:
        raise StoreError(
            "disk_space",
            f"{output} has {free_mib:.0f} MiB free, and a run needs {MINIMUM_FREE_MIB}; nothing "
            "was done: free space, or prune",
        )


@contextmanager
def _prepare(
    request: RunRequest, heartbeat: Heartbeat, receivers: Sequence[Receiver]
) -> Iterator[_Run]:
    """Make an output ready, and yield the run over it with its workers."""
    fleet, output = request.fleet, request.fleet.output
    remove_leftovers(output)
    remove_leftovers(output / "tables", below=True)
    make_ready(output, next(runs_back(output), None))
    with staging_folder(output) as staging, open_state(output) as state:
        restore_decisions(state)
        claim_output(state, staging, fleet)
        open_outbox(state, [receiver.name for receiver in receivers])
        folders = (staging,) if fleet.log_url else (fleet.log_root, staging)
        with open_workers(fleet.execution, folders) as workers:
            yield _Run(request, heartbeat, workers, Publisher(state, staging, run_id=""))


@contextmanager
def staging_folder(output: Path) -> Iterator[Path]:
    """Yield a folder for this run's staged rows; those of killed runs are removed.

    Nobody else may enter it: what tasks leave there is published.
    """
    root = output / "staging"
    shutil.rmtree(root, ignore_errors=True)
    # A name of its own: a worker of a killed run may still write into that run's folder.
    folder = root / secrets.token_hex(8)
    try:
        with store_errors(root):
            make_folders(root)
            folder.mkdir(mode=0o700)
        yield folder
    finally:
        shutil.rmtree(root, ignore_errors=True)


@dataclass(slots=True)
class _Run:
    """A run under way, step by step."""

    request: RunRequest
    heartbeat: Heartbeat
    workers: Workers
    publisher: Publisher  # knows the run's id once all motors are done
    started: dt.datetime = field(default_factory=lambda: dt.datetime.now(dt.UTC))
    outcomes: list[MotorOutcome] = field(default_factory=list)
    trends: list[TrendOutcome] = field(default_factory=list)
    alarms: tuple[Mapping[str, Any], ...] = ()
    n_nights: int = 0
    damage: tuple[TableFault, ...] = ()
    refitted: Nights = field(default_factory=dict)  # those with a fit whose rows are lost
    is_stopped: bool = False  # by a signal
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(publishing.STAGES, 0.0))

    @contextmanager
    def _step(self, stage: str, seconds: str = "", *, is_whole: bool = True) -> Iterator[None]:
        """Do a stage, and note its time; a first signal ends it, or waits for its end."""
        begin = time.perf_counter()
        with interrupts_held() as came:
            self.heartbeat.say(stage=stage, run_id=self.publisher.run_id or None)
            if is_whole:
                yield
        self.is_stopped |= bool(came)
        if not is_whole:
            try:
                yield
            except KeyboardInterrupt:
                self.is_stopped = True
        if seconds:
            self.seconds[seconds] += time.perf_counter() - begin

    def fit_motors(self, progress: Progress) -> None:
        """Stage the rows of the motors, after a look at what is published."""
        state, request = self.publisher.state, self.request
        with self._step("motors", "motors_s", is_whole=False):
            state.set_meta(LAST_RUN, max(state.meta(LAST_RUN), self.started.isoformat()))
            self.damage = find_damage(state, every_file=request.repair)
            self.refitted = forget_lost(state, self.damage)
            tasks = () if self.is_stopped else request.tasks(self.publisher.staging)
            for outcome in _motor_outcomes(self.workers, tasks, request.fleet.execution, state):
                self.outcomes.append(outcome)
                self.heartbeat.motor_done()
                progress(outcome)
        self.outcomes.sort(key=lambda outcome: outcome.motor_id)
        run_id = publishing.run_id_of(self.outcomes, request.specs)
        self.publisher = replace(self.publisher, run_id=run_id)

    def publish_nights(self) -> None:
        """Publish what the motors' tasks have staged."""
        with self._step("publishing", "publish_s"):
            self.n_nights = publishing.publish_motors(self.publisher, self.outcomes)

    def stage_trends(self) -> None:
        """Stage the trends of the motors, but where the run is stopped."""
        changed = {outcome.motor_id: outcome.changed_from for outcome in self.outcomes}
        with self._step("trends", "trends_s", is_whole=False):
            if not self.is_stopped:
                fleet, clock = self.request.fleet, self.request.clock
                self.trends = publishing.make_trends(
                    fleet, clock, self.publisher, self.workers, changed
                )

    def publish_tables(self) -> None:
        """Publish the trends, nights without any, and the tables of a single file."""
        with self._step("trends", "trends_s"):
            self.alarms = tuple(publishing.publish_trends(self.publisher, self.trends))
            if not self.is_stopped:
                motor_ids = [outcome.motor_id for outcome in self.outcomes]
                publishing.publish_other_nights(self.publisher, motor_ids)
            publishing.publish_whole_tables(self.publisher, self.request.fleet)
            losses = {name: loss for made in self.trends for name, loss in made.failures.items()}
            self.outcomes = [
                _with_trends(outcome, losses.get(outcome.motor_id)) for outcome in self.outcomes
            ]
            if any(outcome.error_code == "store_read" for outcome in self.outcomes):
                # The file that a task could not read is named; the next run makes it anew.
                self.damage += find_damage(self.publisher.state, every_file=True)

    def record(self) -> RunResult:
        """Publish the rows of the run itself, and what people and intraday checks entered."""
        made = {outcome.motor_id: outcome.nights for outcome in self.outcomes}
        result = RunResult(
            self.publisher.run_id,
            tuple(self.outcomes),
            self.n_nights,
            self.is_stopped,
            alarms=self.alarms,
            seconds_by_stage=self.seconds,
            damage=self.damage,
            damage_left=tuple(damage_left(self.damage, self.refitted, made)),
        )
        with self._step("recording"):
            publishing.publish_run(self.publisher, self.request, result, self.started)
        settle_intraday(self.request.fleet, self.publisher.state)
        publish_decisions(self.publisher.state, self.publisher.run_id)
        return replace(result, interrupted=self.is_stopped)


def _with_trends(outcome: MotorOutcome, loss: Loss | None) -> MotorOutcome:
    """Return a motor's outcome; a motor whose trends failed has failed."""
    if loss is None or outcome.status == FAILED:
        return outcome
    how = f"trends: {legible(loss.how)}"
    return replace(outcome, status=FAILED, error_code=loss.code, message=how)


def _notify(
    fleet: Fleet, receivers: Sequence[Receiver], heartbeat: Heartbeat, result: RunResult
) -> RunResult:
    """Tell receivers, metrics and the copy of the tables what a run has published."""
    if result.without_logs:  # A motor without an outcome of its own has its own words.
        place = fleet.log_place
        log.warning("no log of any motor is below %s: is the folder mounted?", place)
    heartbeat.say(stage="notifying")
    deliver_alarms(fleet, receivers)
    write_run_metrics(fleet, receivers, result)
    if not fleet.copy_to or result.interrupted:
        return result
    heartbeat.say(stage="copying")
    try:
        with interrupts_held():
            copy_output(fleet.copy_to, fleet.output)
    except StoreError as error:
        return replace(result, copy_fault=f"{error.code}: {error}")
    return result


def _motor_outcomes(
    workers: Workers, tasks: Sequence[MotorTask], execution: Execution, state: StateDatabase
) -> Iterator[MotorOutcome]:
    """Yield outcomes of the motors with nothing new, then those of the others.

    A night that workers are lost in is given up, and so is a log that does not answer; a motor of
    which more are lost, or of which it is not known in what, has failed.
    """
    done = set()
    for outcome in unchanged_motors(tasks, execution, state):
        done.add(outcome.motor_id)
        yield outcome
    # A record of processed logs is read when its task is drawn: together they may not fit into the
    # memory.
    others = (
        replace(task, processed=read_processed(state, task.spec.motor_id))
        for task in tasks
        if task.spec.motor_id not in done
    )
    yield from workers.run(run_motor, others, lost, without_lost_part)


def run_motor(task: MotorTask) -> MotorOutcome:
    """Run `motor_task.run_motor`, with which a process loads the science."""
    from pipeline.run import motor_task

    return motor_task.run_motor(task)


def unchanged_motors(
    tasks: Sequence[MotorTask], execution: Execution, state: StateDatabase
) -> Iterator[MotorOutcome]:
    """Yield outcomes of motors with nothing to be done, without workers and the science.

    A thread asks the logs for size and time, as their folders may be on a mount that hangs; what it
    does not tell in time is left to the motors' tasks.
    """
    if execution.is_cluster:  # the logs may be seen by its workers alone
        return
    asked = [task for task in tasks if not (task.redo or task.retry or task.spec.log_url)]
    answers: SimpleQueue[Mapping[str, FileRecord]] = SimpleQueue()

    def look() -> None:
        for task in asked:
            answers.put(_stat_logs(task.spec))

    Thread(target=look, daemon=True, name="look at logs").start()
    for task in asked:
        try:
            seen = answers.get(timeout=execution.answer_s)
        except Empty:
            return
        processed = read_processed(state, task.spec.motor_id)
        before = processed.files
        known = {name: before[name] for name, file in seen.items() if file.is_as(before.get(name))}
        if not seen or len(known) < len(seen):
            continue
        with suppress(Exception, PanicException):  # which the motor's task reports
            nights = NightPlan(replace(task, processed=processed, log_records=known))
            if nights.is_quiet:
                yield nights.outcome()


def _stat_logs(spec: MotorSpec) -> Mapping[str, FileRecord]:
    """Return the logs of a motor as they are, unopened; none where any is absent."""
    try:
        paths, absent, _ = find_logs(spec)
    except OSError:
        return {}
    return {} if absent else {name: stat_log(name, path) for name, path in paths.items()}

"""The nightly run: one motor a task over worker processes, then the tables, night by night.

Tasks share nothing and return small outcomes as they finish. What was finished is kept where a
worker dies; the tasks that were under way are tried once more, each alone.
"""

from __future__ import annotations

import datetime as dt
import logging
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pipeline.config import Fleet
from pipeline.errors import StoreError
from pipeline.logs.finding import legible
from pipeline.notification.outbox import open_outbox
from pipeline.notification.receivers import receivers_of
from pipeline.run.mending import damage_left, find_damage, forget_lost
from pipeline.run.motors import motor_outcomes
from pipeline.run.notification import deliver_alarms, measure, settle_intraday
from pipeline.run.ownership import claim_output, newest_run, own_output, take_over_renamed
from pipeline.run.publishing import (
    STAGES,
    config_hash_of,
    make_trends,
    publish_motors,
    publish_other_nights,
    publish_run,
    publish_trends,
    publish_whole_tables,
    run_id_of,
)
from pipeline.run.tasks import MotorOutcome, RunRequest, RunResult
from pipeline.schema.fits import FAILED
from pipeline.store.atomic_files import make_folders, remove_leftovers, store_errors
from pipeline.store.copying import copy_output
from pipeline.store.heartbeat import Heartbeat, last_good_run
from pipeline.store.locks import interrupts_held, locked
from pipeline.store.object_store import ObjectStore
from pipeline.store.publishing import Publisher
from pipeline.store.state import LAST_RUN, State, make_ready, open_state
from pipeline.trends.nights.decisions import publish_decisions, restore_decisions
from pipeline.trends.tasks import TrendOutcome
from pipeline.workers.engine import Workers, open_workers
from pipeline.workers.process import Loss, Mark

__all__ = ["RunRequest", "RunResult", "run_fleet"]

log = logging.getLogger(__name__)

Progress = Callable[[MotorOutcome], None]


def run_fleet(
    request: RunRequest,
    progress: Progress = lambda _: None,
    watched: Callable[[Callable[[], Sequence[Mark]]], None] = lambda _: None,
) -> RunResult:
    """Fit every new night of a fleet's motors and publish the tables.

    Parameters
    ----------
    request
        Fleet, and which part of it.
    progress
        Called with the outcome of each motor as it finishes.
    watched
        Called once with what gives the marks of the tasks under way.

    Raises
    ------
    LockedError
        If another run writes to the same output.
    StoreError
        If nothing can be published, there is too little room for it, or the logs' object store
        cannot be listed.
    EngineError
        If there is nothing that tasks could run on.
    """
    fleet, output = request.fleet, request.fleet.output
    receivers = receivers_of(fleet.settings.alarms)
    if fleet.log_url:  # otherwise each of the motors would fail of it
        next(ObjectStore.at(fleet.log_url).list(), None)
    _require_space(output, fleet.execution.minimum_free_mib)
    with (
        locked(output),
        own_output(fleet),
        Heartbeat(output, len(request.specs), last_good_run(output)) as heartbeat,
    ):
        remove_leftovers([output], below=False)
        remove_leftovers([output / "tables"])
        make_ready(output, newest_run(output))
        with staging_folder(output) as staging:
            folders = (staging,) if fleet.log_url else (fleet.log_root, staging)
            with open_state(output) as state:
                claim_output(state, fleet)
                restore_decisions(state)
                take_over_renamed(state, staging, fleet)
                open_outbox(state, [receiver.name for receiver in receivers])
                with open_workers(fleet.execution, folders) as workers:
                    watched(workers.marks)
                    result = _run(request, staging, progress, heartbeat, workers, state)
                settle_intraday(fleet, state)
                publish_decisions(state, result.run_id)
        # A motor without an outcome of its own has its own words.
        if result.without_logs:
            place = fleet.log_place
            log.warning("no log of any motor is below %s: is the folder mounted?", place)
        heartbeat.say(stage="telling")
        deliver_alarms(fleet, receivers)
        measure(fleet, receivers, result)
        if fleet.copy_to and not result.interrupted:
            heartbeat.say(stage="copying")
            result = replace(result, copy_fault=_copy_fault(fleet))
        # Whoever waits for this may run at once.
        heartbeat.finished(interrupted=result.interrupted, good=result.is_good)
    return result


def _copy_fault(fleet: Fleet) -> str:
    """Copy the published tables to their URL; returns why that failed, or an empty text."""
    try:
        with interrupts_held():
            copy_output(fleet.copy_to, fleet.output)
    except StoreError as error:
        return f"{error.code}: {error}"
    return ""


def _require_space(output: Path, minimum_mib: float) -> None:
    """Refuse a run with little room on the disk, which would end it half way."""
    present = next(folder for folder in (output, *output.parents) if folder.exists())
    free_mib = shutil.disk_usage(present).free / 1024**2
    if free_mib < minimum_mib:
        raise StoreError(
            "disk_space",
            f"{output} has {free_mib:.0f} MiB free, and execution.minimum_free_mib is "
            f"{minimum_mib:g}; nothing was done: free space, or prune",
        )


def _run(
    request: RunRequest,
    staging: Path,
    progress: Progress,
    heartbeat: Heartbeat,
    workers: Workers,
    state: State,
) -> RunResult:
    started, begin = dt.datetime.now(dt.UTC), time.perf_counter()
    fleet = request.fleet
    state.set_meta(LAST_RUN, max(state.meta(LAST_RUN), started.isoformat()))
    damage = find_damage(state, every_file=request.repair)
    fitted = forget_lost(state, damage)
    tasks = [request.task(spec, staging) for spec in request.specs]
    outcomes: list[MotorOutcome] = []
    is_stopped = False
    try:
        for outcome in motor_outcomes(workers, tasks, fleet.execution, state):
            outcomes.append(outcome)
            heartbeat.motor_done()
            progress(outcome)
    except KeyboardInterrupt:
        is_stopped = True
    ends = [time.perf_counter()]
    outcomes.sort(key=lambda outcome: outcome.motor_id)
    config_hash = config_hash_of(request.specs)
    run_id = run_id_of(outcomes, config_hash)
    heartbeat.say(stage="publishing", run_id=run_id)
    publisher = Publisher(state, staging, run_id)
    with interrupts_held() as came:
        n_nights = publish_motors(publisher, outcomes)
    is_stopped = is_stopped or bool(came)
    ends.append(time.perf_counter())
    heartbeat.say(stage="trends")
    trends: list[TrendOutcome] = []
    if not is_stopped:
        changed = {outcome.motor_id: outcome.changed_from for outcome in outcomes}
        try:
            trends = make_trends(fleet, request.clock, publisher, workers, changed)
        except KeyboardInterrupt:
            is_stopped = True
    with interrupts_held() as came:
        alarms = publish_trends(publisher, trends)
        if not is_stopped:
            publish_other_nights(publisher, [outcome.motor_id for outcome in outcomes])
        publish_whole_tables(publisher, fleet)
        failures = {motor_id: loss for trend in trends for motor_id, loss in trend.failures.items()}
        outcomes = [_with_trends(outcome, failures.get(outcome.motor_id)) for outcome in outcomes]
        if any(outcome.error_code == "store_read" for outcome in outcomes):
            # The file that a task could not read is named; the next run makes it anew.
            damage += find_damage(state, every_file=True)
        ends.append(time.perf_counter())
        stages = zip(STAGES, [begin, *ends], ends, strict=False)
        result = RunResult(
            run_id,
            tuple(outcomes),
            n_nights,
            is_stopped or bool(came),
            seconds=ends[-1] - begin,
            alarms=tuple(alarms),
            seconds_by_stage={name: end - start for name, start, end in stages},
            damage=damage,
            damage_left=tuple(
                damage_left(
                    damage, fitted, {outcome.motor_id: outcome.nights for outcome in outcomes}
                )
            ),
        )
        heartbeat.say(stage="recording")
        publish_run(publisher, request, result, started)
    return replace(result, interrupted=result.interrupted or bool(came))


@contextmanager
def staging_folder(output: Path) -> Iterator[Path]:
    """Yield a folder for this run's staged rows; those of killed runs are removed.

    Nobody else may enter it: what tasks leave there is published.
    """
    root = output / "staging"
    shutil.rmtree(root, ignore_errors=True)
    # A name of its own: a worker of a killed run may still write into the folder of that one.
    folder = root / secrets.token_hex(8)
    try:
        with store_errors(root):
            make_folders(root)
            folder.mkdir(mode=0o700)
        yield folder
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _with_trends(outcome: MotorOutcome, loss: Loss | None) -> MotorOutcome:
    """Return a motor's outcome; one whose trends failed has failed."""
    if loss is None or outcome.status == FAILED:
        return outcome
    how = f"trends: {legible(loss.how)}"
    return replace(outcome, status=FAILED, error_code=loss.code, message=how)

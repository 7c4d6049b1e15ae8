"""The nightly run: one motor a task over worker processes, then the tables, night by night.

Tasks share nothing and return small outcomes as they finish. A motor whose worker dies costs that
motor its run and no other: what was finished is kept, and each lost task is tried once more alone.
"""

from __future__ import annotations

import datetime as dt
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pipeline.config import Fleet
from pipeline.config.fleet import LANDED_FOLDER
from pipeline.errors import EngineError, LockedError, StoreError
from pipeline.logs.finding import legible
from pipeline.run.disk_space import require_space
from pipeline.run.mending import Damage, restore_decisions, share_due
from pipeline.run.motors import motor_outcomes
from pipeline.run.plans import task_of
from pipeline.run.publishing import PublishedTrends, publish_latest, publish_motors, publish_trends
from pipeline.run.request import RunRequest, RunResult
from pipeline.run.run_rows import STAGES, config_hash_of, publish_run, run_id_of
from pipeline.run.tasks import MotorOutcome
from pipeline.run.telling import deliver_alarms, measure, queue_alarms
from pipeline.schema.fits import FAILED
from pipeline.store.atomic_files import make_private_folder, remove_all, remove_leftovers
from pipeline.store.heartbeat import Heartbeat, last_good_run
from pipeline.store.interrupts import interrupts_held
from pipeline.store.locks import locked
from pipeline.store.object_store import ObjectStore
from pipeline.store.old_layout import take_over
from pipeline.store.publishing import Publisher
from pipeline.store.verification import TableFault
from pipeline.store.working_copy import pull, working_copy
from pipeline.telling.outbox import open_outbox
from pipeline.telling.receivers import receivers_of
from pipeline.workers.engine import RunTasks, open_engine
from pipeline.workers.process import Loss

__all__ = ["RunRequest", "RunResult", "refresh", "run_fleet"]

log = logging.getLogger(__name__)

Progress = Callable[[MotorOutcome], None]

# Folders of the output in which a killed run leaves temporary files.
WRITTEN_FOLDERS = ("tables", "ledger", "manifest", "history", LANDED_FOLDER)
PUT_ASIDE_LATE = "it is not what was published, and was put aside when its night was published"


def run_fleet(request: RunRequest, progress: Progress = lambda _: None) -> RunResult:
    """Fit every new night of a fleet's motors and publish the tables.

    A motor whose task hangs or dies is done by a second run, when the first has published what the
    others have made and told of their alarms.

    Parameters
    ----------
    request
        Fleet, and which part of it.
    progress
        Called with the outcome of each motor, and of each chunk of one, as it finishes.

    Returns
    -------
    RunResult

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
    # One motor holds up no other.
    result = _run_once(request, progress, first=len(request.specs) > 1)
    late = [outcome for outcome in result.outcomes if outcome.is_set_aside]
    if not late or result.interrupted:
        return result
    again = replace(request, motors=tuple(outcome.motor_id for outcome in late))
    try:
        return _joined(result, _run_once(again, progress, first=False))
    except (LockedError, EngineError) as error:
        log.warning("%s; the next run does what is left", error)
    for outcome in late:
        progress(outcome)
    return result


def _joined(first: RunResult, second: RunResult) -> RunResult:
    """The result of a run, together with that of the one which did what it had set aside."""
    outcomes = {outcome.motor_id: outcome for outcome in (*first.outcomes, *second.outcomes)}
    seconds = Counter(first.seconds_by_stage)
    seconds.update(second.seconds_by_stage)
    return replace(
        first,
        outcomes=tuple(outcomes[motor_id] for motor_id in sorted(outcomes)),
        n_nights=first.n_nights + second.n_nights,
        interrupted=second.interrupted,
        seconds=first.seconds + second.seconds,
        alarms=(*first.alarms, *second.alarms),
        seconds_by_stage=dict(seconds),
        damage=(*first.damage, *second.damage),
        # What the first left may be of a motor that the second did.
        damage_left=second.damage_left,
    )


def _run_once(request: RunRequest, progress: Progress, *, first: bool) -> RunResult:
    """Do a run; the first of two sets motors aside that hang or die."""
    fleet, output = request.fleet, request.fleet.output
    receivers = receivers_of(fleet.settings.alarms)
    if fleet.log_url:
        _require_logs(fleet.log_url)
    require_space(output, fleet.execution.minimum_free_mib)
    with (
        locked(output),
        Heartbeat(output, len(request.specs), _last_good_run(output)) as heartbeat,
    ):
        remove_leftovers([output], below=False)
        remove_leftovers([output / name for name in WRITTEN_FOLDERS])
        with working_copy(fleet.object_store, output) as restore, staging_folder(output) as staging:
            if fleet.object_store:
                heartbeat.say(last_good_run=_last_good_run(output))
            folders = (fleet.log_root, staging) if fleet.has_log_folder else (staging,)
            stores = (fleet.log_url,) if fleet.log_url else ()
            open_outbox(output, [one.name for one in receivers], fleet.name)
            with open_engine(fleet.execution, folders, stores) as run_tasks:
                damage = Damage(output, restore)
                result = _run(request, staging, progress, heartbeat, run_tasks, damage, first=first)
            queue_alarms(fleet)
        # A motor without an outcome of its own has its own words.
        if not any(one.files or not one.finished for one in result.outcomes):
            place = fleet.log_place
            log.warning("no log of any motor is below %s: is the folder mounted?", place)
        # What was said before may not be published: now it is.
        heartbeat.finished(result.run_id, good=not result.interrupted)
        deliver_alarms(fleet, receivers)
        measure(fleet, receivers, result)
    return result


def _require_logs(url: str) -> None:
    """Refuse a run whose logs nobody can list: each of its motors would fail of it."""
    next(ObjectStore.at(url).list(), None)


def refresh(fleet: Fleet) -> int:
    """Bring the working copy of what is published in an object store up to date.

    Returns
    -------
    int
        How many files are published.

    Raises
    ------
    LockedError
        If a run works in it.
    StoreError
        If it cannot be read.
    """
    with locked(fleet.output):
        return len(pull(ObjectStore.at(fleet.object_store), fleet.output).files)


def _last_good_run(output: Path) -> dt.datetime | None:
    try:
        return last_good_run(output)
    except StoreError as error:
        log.warning("%s", error)
        return None


def _run(
    request: RunRequest,
    staging: Path,
    progress: Progress,
    heartbeat: Heartbeat,
    run_tasks: RunTasks,
    damage: Damage,
    *,
    first: bool,
) -> RunResult:
    started, begin = dt.datetime.now(dt.UTC), time.perf_counter()
    fleet = request.fleet
    take_over(fleet.output, damage.forget)
    damage.look_around(share_due(fleet.output, fleet.execution.prove_within_days, started))
    restore_decisions(fleet.output)
    tasks = [task_of(request, spec, staging) for spec in request.specs]
    outcomes: dict[str, MotorOutcome] = {}
    interrupted = False
    try:
        for outcome in motor_outcomes(run_tasks, tasks, fleet.execution, first=first):
            if outcome.chunk:
                progress(outcome)
                continue
            outcomes[outcome.motor_id] = outcome
            if not outcome.is_set_aside:
                heartbeat.motor_done(is_news=bool(outcome.nights))
                progress(outcome)
    except KeyboardInterrupt:
        interrupted = True
    ends = [time.perf_counter()]
    finished = [outcomes[motor_id] for motor_id in sorted(outcomes)]
    config_hash = config_hash_of(tasks)
    run_id = run_id_of(finished, config_hash)
    heartbeat.say(stage="publishing", run_id=run_id)
    publisher = Publisher(fleet.output, staging, run_id, fleet.execution.workers)
    with interrupts_held() as came:
        damage.look_into(_months_of(finished))
        n_nights = publish_motors(publisher, finished)
    interrupted = interrupted or bool(came)
    ends.append(time.perf_counter())
    heartbeat.say(stage="trends")
    trends = PublishedTrends()
    if not interrupted:
        try:
            trends = publish_trends(fleet, request.clock, publisher, finished, run_tasks)
            interrupted = trends.interrupted
        except KeyboardInterrupt:
            interrupted = True
    with interrupts_held() as came:
        publish_latest(publisher, fleet)
    interrupted = interrupted or bool(came)
    finished = [_with_trends(one, trends.failures.get(one.motor_id)) for one in finished]
    codes = {one.error_code for one in finished} | {one.code for one in trends.failures.values()}
    if "store_read" in codes:
        # What a task could not read is found and named; the next run makes it anew.
        damage.look_into()
    for name in publisher.damaged:  # the publisher has said so
        damage.found.setdefault(name, TableFault(name, "table_altered", PUT_ASIDE_LATE))
    ends.append(time.perf_counter())
    stages = zip(STAGES, [begin, *ends], ends, strict=False)
    result = RunResult(
        run_id,
        tuple(finished),
        n_nights,
        interrupted,
        seconds=ends[-1] - begin,
        alarms=tuple(trends.alarms),
        seconds_by_stage={name: end - start for name, start, end in stages},
        damage=tuple(damage.found.values()),
        damage_left=tuple(damage.left({one.motor_id: one.nights for one in finished})),
    )
    heartbeat.say(stage="recording")
    with interrupts_held() as came:
        publish_run(publisher, request, result, started, config_hash)
    return replace(result, interrupted=interrupted or bool(came))


def _months_of(outcomes: Sequence[MotorOutcome]) -> list[str]:
    """Months of the nights that some motors have made."""
    return sorted({f"{night:%Y-%m}" for outcome in outcomes for night in outcome.nights})


@contextmanager
def staging_folder(output: Path) -> Iterator[Path]:
    """A folder for this run's staged rows; those of killed runs are removed.

    Nobody else may enter it: what tasks leave there for each other is unpickled.
    """
    root = output / "staging"
    remove_all(root)
    # A name of its own: a worker of a killed run may still write into the folder of that one.
    folder = root / secrets.token_hex(8)
    try:
        make_private_folder(folder)
    except OSError as error:
        remove_all(root)
        raise StoreError(
            "store_write", f"{root} cannot be written: {error.strerror}; look what is there"
        ) from error
    try:
        yield folder
    finally:
        remove_all(root)


def _with_trends(outcome: MotorOutcome, loss: Loss | None) -> MotorOutcome:
    """A motor's outcome; one whose trends failed has failed."""
    if loss is None or outcome.status == FAILED:
        return outcome
    how = f"trends: {legible(loss.how)}"
    return replace(outcome, status=FAILED, error_code=loss.code, message=how)

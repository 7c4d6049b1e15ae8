"""The nightly run: one motor a task over worker processes, then the tables, night by night.

Tasks share nothing and return small outcomes as they finish. A motor whose worker dies costs that
motor its run and no other: what was finished is kept, and each lost task is tried once more alone.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.clock import latest_us, now
from pipeline.config import Execution, Fleet, MotorSpec
from pipeline.config.fleet import LANDED_FOLDER
from pipeline.config.hashes import config_hash as hash_of_config
from pipeline.config.hashes import hash_of, settings_of, why_anew
from pipeline.errors import EngineError, LockedError, StoreError
from pipeline.logs.finding import legible
from pipeline.logs.ledger import as_published, read_settings
from pipeline.logs.motor_logs import FATES
from pipeline.run.chunks import run_motors
from pipeline.run.disk_space import require_space
from pipeline.run.mending import Damage, restore_decisions, share_due
from pipeline.run.metrics import metrics_text, write_metrics
from pipeline.run.motor_nights import plan_motor
from pipeline.run.publishing import (
    fleets_tonight,
    publish_latest,
    publish_motors,
    publish_trends,
)
from pipeline.run.tasks import MotorOutcome, MotorTask, Step, lost, run_motor
from pipeline.run.unchanged import unchanged_motors
from pipeline.schema import (
    MOTOR_OUTCOMES,
    RUNS,
    SCHEMA_VERSION,
)
from pipeline.schema.fits import FAILED
from pipeline.store.atomic_files import (
    make_private_folder,
    remove_all,
    remove_leftovers,
)
from pipeline.store.heartbeat import Heartbeat, last_good_run
from pipeline.store.interrupts import interrupts_held
from pipeline.store.locks import locked
from pipeline.store.manifest import Key, manifest_keys
from pipeline.store.months import join_months, last_month_over
from pipeline.store.object_store import ObjectStore
from pipeline.store.publishing import Publisher
from pipeline.store.verification import TableFault
from pipeline.store.views import write_views
from pipeline.store.working_copy import pull, working_copy
from pipeline.telling.delivering import deliver
from pipeline.telling.delivery import Receiver
from pipeline.telling.mail import EMAIL
from pipeline.telling.outbox import add_summary, backlogs, is_waiting, open_outbox, take_up
from pipeline.telling.receivers import receivers_of
from pipeline.trends.circuits import decisions_of
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.nights.trend_record import (
    read_record,
    trend_hash,
)
from pipeline.trends.rows.latest_states import published_states
from pipeline.trends.rows.motor_states import urgency
from pipeline.versions import own_version, versions
from pipeline.workers.engine import RunTasks, nights_a_chunk, open_engine
from pipeline.workers.process import Loss

log = logging.getLogger(__name__)

Progress = Callable[[MotorOutcome], None]

# Seconds of a motor's task by stage, as `motor_outcomes` names them, and of a run, as `runs` does.
MOTOR_STAGES = (
    "read_s",
    "clean_s",
    "statistics_s",
    "fit_s",
    "residuals_s",
    "refit_s",
    "store_s",
)
# Folders of the output in which a killed run leaves temporary files.
WRITTEN_FOLDERS = ("tables", "ledger", "manifest", "history", LANDED_FOLDER)
STAGES = ("motors_s", "publish_s", "trends_s")
PUT_ASIDE_LATE = "it is not what was published, and was put aside when its night was published"


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Request of a run.

    Attributes
    ----------
    fleet
        The config.
    motors
        Ids of the motors to do; empty for all.
    since, until
        Labels of the first and last night to do; None: no limit.
    force
        Whether to make nights anew from their logs that nothing has changed of.
    retry
        Whether to try nights and logs again that failed.
    with_starts
        Whether nights that are, or were, fitted anew without their log get the starts of their
        search.
    clock
        The time of the run, by which logs lie in the future.
    """

    fleet: Fleet
    motors: tuple[str, ...] = ()
    since: dt.date | None = None
    until: dt.date | None = None
    force: bool = False
    retry: bool = False
    with_starts: bool = False
    clock: dt.datetime = field(default_factory=now)

    @property
    def specs(self) -> tuple[MotorSpec, ...]:
        """The motors that are asked for."""
        return tuple(
            spec for spec in self.fleet.motors if not self.motors or spec.motor_id in self.motors
        )


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run.

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
    seconds_by_stage
        Of these: `motors_s` until all tasks were done, `publish_s` and `trends_s`.
    damage
        Published files that were found damaged or gone.
    damage_left
        What of it could not be made anew.
    """

    run_id: str
    outcomes: tuple[MotorOutcome, ...]
    n_nights: int
    interrupted: bool
    seconds: float
    alarms: tuple[Mapping[str, Any], ...] = ()
    seconds_by_stage: Mapping[str, float] = field(default_factory=dict)
    damage: tuple[TableFault, ...] = ()
    damage_left: tuple[TableFault, ...] = ()

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
            _take_up(fleet)
        if not result.files:
            place = fleet.log_place
            log.warning("no log of any motor is below %s: is the folder mounted?", place)
        # What was said before may not be published: now it is.
        heartbeat.finished(result.run_id, good=not result.interrupted)
        _tell(fleet, receivers)
        _measure(fleet, receivers, result)
    return result


def _take_up(fleet: Fleet) -> None:
    """Queue what was published; where that fails, the next run does it."""
    today = dt.datetime.now(fleet.settings.nights.zone).date()
    due = fleet.settings.alarms.email.summary_due(today)
    try:
        take_up(fleet.output, fleet.name)
        if due is not None:
            add_summary(fleet.output, EMAIL, fleet.name, due, lambda: _states(fleet))
    except StoreError as error:
        log.warning("alarms: %s; the next run tells of them", error)


def _states(fleet: Fleet) -> list[dict[str, str]]:
    """State of each motor for a summary, the most urgent first."""
    states = published_states(fleet.output, [spec.motor_id for spec in fleet.motors])
    return [
        {"motor_id": one.motor_id, "state": one.state, "sentence": one.why}
        for one in sorted(states, key=urgency)
    ]


def _tell(fleet: Fleet, receivers: Sequence[Receiver]) -> None:
    """Deliver what waits; that it cannot be delivered costs nobody the run."""
    try:
        if is_waiting(fleet.output):
            # What was delivered is to be known on every machine.
            with working_copy(fleet.object_store, fleet.output):
                for fault in deliver(fleet.output, receivers, fleet.name):
                    log.warning("%s", fault)
    except StoreError as error:
        log.warning("alarms: %s; what was delivered may be delivered again", error)


def _measure(fleet: Fleet, receivers: Sequence[Receiver], result: RunResult) -> None:
    """Write the metrics; that they cannot be written costs nobody the run."""
    if fleet.metrics_file is None:
        return
    output = fleet.output
    try:
        text = metrics_text(
            fleet,
            published_states(output, [spec.motor_id for spec in fleet.motors]),
            result.outcomes,
            result.seconds_by_stage,
            backlogs(output, receivers, fleet.name),
            last_good_run(output),
        )
        write_metrics(fleet.metrics_file, text)
    except StoreError as error:
        log.warning("%s; there are no metrics of this run", error)


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


def plan_fleet(request: RunRequest) -> Iterator[tuple[str, Mapping[dt.date, Step]]]:
    """The plan of a run, motor by motor; of logs only the ends are read, and nothing is written.

    Raises
    ------
    StoreError
        If a published table that is needed is damaged.
    """
    output = request.fleet.output
    for spec in request.specs:
        yield spec.motor_id, plan_motor(_task(request, spec, output / "staging"))


def plan_trends(request: RunRequest) -> Iterator[tuple[str, str]]:
    """Motors whose trends a run would make anew from their first night on, and why, in words.

    Those of nights that are new or made anew follow in any case.
    """
    output, specs = request.fleet.output, request.specs
    decisions = decisions_of(specs, read_decisions(output))
    for spec in (as_published(output, one) for one in specs):
        record = read_record(output, spec.motor_id)
        if record is not None and record.trend_hash != trend_hash(spec, decisions[spec.motor_id]):
            before, now = read_settings(output, spec.motor_id), settings_of(spec)
            yield (
                spec.motor_id,
                "a baseline was reset, or a new version"
                if before == now
                else why_anew(before, now, trends=True),
            )


def _task(request: RunRequest, spec: MotorSpec, staging: Path) -> MotorTask:
    return MotorTask(
        spec=spec,
        output=request.fleet.output,
        staging=staging,
        since=request.since,
        until=request.until,
        force=request.force,
        retry=request.retry,
        with_starts=request.with_starts,
        nights_a_chunk=nights_a_chunk(request.fleet.execution, len(request.specs)),
        latest_us=latest_us(request.clock),
    )


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
    damage.look_around(share_due(fleet.output, fleet.execution.prove_within_days, started))
    restore_decisions(fleet.output)
    tasks = [_task(request, spec, staging) for spec in request.specs]
    outcomes: dict[str, MotorOutcome] = {}
    interrupted = False
    try:
        for outcome in _outcomes(run_tasks, tasks, fleet.execution, first=first):
            if outcome.chunk:
                progress(outcome)
                continue
            outcomes[outcome.motor_id] = outcome
            if not outcome.is_set_aside:
                heartbeat.motor_done()
                progress(outcome)
    except KeyboardInterrupt:
        interrupted = True
    ends = [time.perf_counter()]
    finished = [outcomes[motor_id] for motor_id in sorted(outcomes)]
    config_hash = _config_hash(tasks)
    run_id = _run_id(finished, config_hash)
    heartbeat.say(stage="publishing", run_id=run_id)
    publisher = Publisher(fleet.output, staging, run_id)
    with interrupts_held() as came:
        damage.look_into(_keys_of(finished))
        n_nights = publish_motors(publisher, finished, {one.motor_id: one for one in request.specs})
    interrupted = interrupted or bool(came)
    ends.append(time.perf_counter())
    heartbeat.say(stage="trends")
    failures: Mapping[str, Loss] = {}
    alarms: Sequence[Mapping[str, Any]] = ()
    if not interrupted:
        try:
            failures, alarms, interrupted = publish_trends(
                fleet, request.clock, publisher, finished, run_tasks
            )
        except KeyboardInterrupt:
            interrupted = True
    with interrupts_held() as came:
        publish_latest(publisher, fleet)
    interrupted = interrupted or bool(came)
    finished = [_with_trends(outcome, failures.get(outcome.motor_id)) for outcome in finished]
    codes = {outcome.error_code for outcome in finished} | {one.code for one in failures.values()}
    if "store_read" in codes:
        # What a task could not read is found and named; the next run makes it anew.
        damage.look_into(manifest_keys(fleet.output))
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
        alarms=tuple(alarms),
        seconds_by_stage={name: end - start for name, start, end in stages},
        damage=tuple(damage.found.values()),
        damage_left=tuple(damage.left({one.motor_id: one.nights for one in finished})),
    )
    heartbeat.say(stage="recording")
    with interrupts_held() as came:
        _publish_run(publisher, request, result, started, config_hash)
    interrupted = interrupted or bool(came) or not _join_months(fleet, request.clock, publisher)
    return replace(result, interrupted=interrupted)


def _join_months(fleet: Fleet, clock: dt.datetime, publisher: Publisher) -> bool:
    """Join the files of months that are long over, but for those with a night of this run.

    Where that fails, the next run does it. False if it was interrupted.
    """
    nights = fleet.execution.join_months_after
    try:
        tonight = fleets_tonight(fleet, clock) if nights else None
        if tonight is not None:
            last = last_month_over(tonight.night, nights)
            join_months(fleet.output, publisher.staging, last, publisher.months)
    except StoreError as error:
        log.warning("%s; the next run joins its month", error)
    except KeyboardInterrupt:
        return False
    return True


def _keys_of(outcomes: Sequence[MotorOutcome]) -> list[Key]:
    """The manifests of the nights that some motors have made."""
    nights = {night for outcome in outcomes for night in outcome.nights}
    return [(f"{night:%Y-%m}", night.isoformat()) for night in sorted(nights)]


def _outcomes(
    run_tasks: RunTasks, tasks: Sequence[MotorTask], execution: Execution, *, first: bool
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors with nothing new, then those of the others."""
    done = set()
    for outcome in unchanged_motors(tasks, execution):
        done.add(outcome.motor_id)
        yield outcome
    others = [task for task in tasks if task.spec.motor_id not in done]
    yield from _motors(run_tasks, others, first=first)


def _motors(
    run_tasks: RunTasks, tasks: Sequence[MotorTask], *, first: bool = False
) -> Iterator[MotorOutcome]:
    """Outcomes of motors and chunks; a motor for which no engine is left has failed."""
    left = {task.spec.motor_id: task for task in tasks}
    try:
        for outcome in run_motors(run_tasks, run_motor, tasks, first=first):
            if not outcome.chunk:
                del left[outcome.motor_id]
            yield outcome
    except EngineError as error:
        if len(left) == len(tasks):
            raise
        log.warning("%s; what is finished is kept", error)
        yield from (lost(task, Loss(error.code, error.message)) for task in left.values())


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


def _config_hash(tasks: Sequence[MotorTask]) -> str:
    return hash_of({task.spec.motor_id: hash_of_config(task.spec) for task in tasks})


def _run_id(outcomes: Sequence[MotorOutcome], config_hash: str) -> str:
    inputs = [one for outcome in outcomes for one in (outcome.motor_id, *outcome.inputs)]
    text = "|".join((own_version(), str(SCHEMA_VERSION), config_hash, *inputs))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _publish_run(
    publisher: Publisher,
    request: RunRequest,
    result: RunResult,
    started: dt.datetime,
    config_hash: str,
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
        **versions(),
        "schema_version": SCHEMA_VERSION,
        "config_hash": config_hash,
        "seed": min(seeds),
        "workers": fleet.execution.workers,
        "n_motors": len(result.outcomes),
        "n_motors_failed": len(result.failed),
        "n_nights": result.n_nights,
        "seconds": result.seconds,
        **result.seconds_by_stage,
        "damage": [f"{one.code}: {one.path}: {one.message}" for one in result.damage],
    }
    rows = [_outcome_row(outcome, result.run_id, started) for outcome in result.outcomes]
    publisher.of_run(started, {RUNS: [run], MOTOR_OUTCOMES: rows})
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
        **{stage: outcome.seconds.get(stage, 0.0) for stage in MOTOR_STAGES},
        **{f"n_{status}": outcome.counts.get(status, 0) for status in statuses},
        **{f"n_files_{fate}": outcome.files.get(fate, 0) for fate in FATES},
        "growing": list(outcome.growing),
    }

"""Motors over workers, each a task; those of which nothing is new are reported without any."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from queue import Empty, SimpleQueue
from threading import Thread

from polars.exceptions import PanicException

from pipeline.config import Execution, MotorSpec
from pipeline.logs.files import stat_log
from pipeline.logs.finding import find_logs
from pipeline.logs.processed import FileRecord, read_processed
from pipeline.run.night_plan import NightPlan
from pipeline.run.tasks import MotorOutcome, MotorTask, lost, without_lost_part
from pipeline.store.state import State
from pipeline.workers.engine import Workers


def motor_outcomes(
    workers: Workers, tasks: Sequence[MotorTask], execution: Execution, state: State
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
    """As `motor_task.run_motor`, with which a process loads the science."""
    from pipeline.run import motor_task

    return motor_task.run_motor(task)


def unchanged_motors(
    tasks: Sequence[MotorTask], execution: Execution, state: State
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors with nothing to be done, without workers and without the science.

    A thread asks the logs for size and time, as their folders may be on a mount that hangs; what it
    does not tell in time is left to the motors' tasks.
    """
    if execution.backend == "dask":  # the logs may be seen by its workers alone
        return
    asked = [task for task in tasks if not (task.redo or task.retry or task.spec.log_url)]
    answers: SimpleQueue[Mapping[str, FileRecord]] = SimpleQueue()

    def look() -> None:
        for task in asked:
            answers.put(_look(task.spec))

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


def _look(spec: MotorSpec) -> Mapping[str, FileRecord]:
    """Return the logs of a motor as they are, unopened; none where one is absent."""
    try:
        paths, absent = find_logs(spec)
    except OSError:
        return {}
    return {} if absent else {name: stat_log(name, path) for name, path in paths.items()}

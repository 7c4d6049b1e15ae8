"""Motors over an engine: one with many nights to read is done in chunks that all workers share.

The task of such a motor comes back with a plan. Its chunks are read and fitted side by side; then
the motor's task joins them, and judges the model before each night. The bytes are those of a motor
done in one.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.logs.ledger import read_ledger
from pipeline.run.tasks import MotorOutcome, MotorTask, lost, set_aside, without_lost_part
from pipeline.run.unchanged import unchanged_motors
from pipeline.schema.fits import FAILED
from pipeline.store.state import State
from pipeline.workers.engine import RunTasks, results_of
from pipeline.workers.process import Loss

log = logging.getLogger(__name__)

RunMotor = Callable[[MotorTask], MotorOutcome]


def motor_outcomes(
    run_tasks: RunTasks,
    tasks: Sequence[MotorTask],
    execution: Execution,
    state: State,
    *,
    first: bool,
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors with nothing new, then those of the others."""
    done = set()
    for outcome in unchanged_motors(tasks, execution, state):
        done.add(outcome.motor_id)
        yield outcome
    others = [
        replace(task, ledger=read_ledger(state, task.spec.motor_id))
        for task in tasks
        if task.spec.motor_id not in done
    ]
    yield from with_failures(run_tasks, others, first=first)


def with_failures(
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


def run_motor(task: MotorTask) -> MotorOutcome:
    """As `motor_task.run_motor`, with which a process loads the science."""
    from pipeline.run import motor_task

    return motor_task.run_motor(task)


def run_motors(
    run_tasks: RunTasks, function: RunMotor, tasks: Sequence[MotorTask], *, first: bool = False
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors as they finish, and before those of their chunks.

    A night that workers are lost in is given up, and so is a log that does not answer; a motor of
    which more are lost, or of which it is not known in what, has failed.

    Raises EngineError if there is nothing that tasks can run on any more.
    """

    def outcomes(some: Sequence[MotorTask]) -> Iterator[MotorOutcome]:
        lose = set_aside if first else lost
        return results_of(run_tasks, function, some, lose, without_lost_part, first=first)

    chunks: dict[str, list[MotorTask]] = {}
    for outcome in outcomes(tasks):
        if outcome.to_do:
            # A worker elsewhere has a staging folder of its own.
            staging = tasks[0].staging
            chunks[outcome.motor_id] = [replace(one, staging=staging) for one in outcome.to_do]
        else:
            yield outcome
    if not chunks:
        return
    n_done: Counter[str] = Counter()
    failed: dict[str, MotorOutcome] = {}
    for outcome in outcomes([chunk for some in chunks.values() for chunk in some]):
        motor_id = outcome.motor_id
        n_done[motor_id] += 1
        if outcome.status == FAILED:
            first_failed = failed.get(motor_id, outcome)
            failed[motor_id] = min(outcome, first_failed, key=lambda one: one.chunk)
        yield replace(outcome, chunks_done=(n_done[motor_id], len(chunks[motor_id])))
    for outcome in failed.values():
        yield replace(outcome, chunk="")
    yield from outcomes(
        [
            replace(some[0], nights=None, chunks=tuple(chunk.chunk for chunk in some))
            for motor_id, some in chunks.items()
            if motor_id not in failed
        ]
    )

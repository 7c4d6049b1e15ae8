"""Motors over workers, each a task; those of which nothing is new are told without any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from pipeline.config import Execution
from pipeline.logs.ledger import read_ledger
from pipeline.run.tasks import MotorOutcome, MotorTask, lost, without_lost_part
from pipeline.run.unchanged import unchanged_motors
from pipeline.store.state import State
from pipeline.workers.engine import Workers


def motor_outcomes(
    workers: Workers, tasks: Sequence[MotorTask], execution: Execution, state: State
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors with nothing new, then those of the others.

    A night that workers are lost in is given up, and so is a log that does not answer; a motor of
    which more are lost, or of which it is not known in what, has failed.

    Raises EngineError if there is nothing that tasks can run on.
    """
    done = set()
    for outcome in unchanged_motors(tasks, execution, state):
        done.add(outcome.motor_id)
        yield outcome
    # A ledger is read when its task is drawn: together they may not fit into the memory.
    others = (
        replace(task, ledger=read_ledger(state, task.spec.motor_id))
        for task in tasks
        if task.spec.motor_id not in done
    )
    yield from workers.run(run_motor, others, lost, without_lost_part)


def run_motor(task: MotorTask) -> MotorOutcome:
    """As `motor_task.run_motor`, with which a process loads the science."""
    from pipeline.run import motor_task

    return motor_task.run_motor(task)

"""Motors over an engine: one with many nights to read is split, so that all workers share them.

First every motor has its task; one whose plan is long comes back as parts. The parts are done side
by side, and then the motor's task once more, which takes each night that was made as if it had made
it itself. So a split motor has the bytes of one that is not.
"""

from __future__ import annotations

import datetime as dt
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from pipeline.run.motor_task import run_part
from pipeline.run.tasks import (
    MOST_GIVEN_UP,
    MotorOutcome,
    MotorTask,
    PartOutcome,
    PartTask,
    SplitMotor,
    lost,
    part_without_lost_part,
    set_aside,
    without_lost_part,
)
from pipeline.workers.engine import RunTasks, results_of
from pipeline.workers.process import Loss

RunMotor = Callable[[MotorTask], MotorOutcome | SplitMotor]


def run_motors(
    run_tasks: RunTasks, function: RunMotor, tasks: Sequence[MotorTask], *, first: bool = False
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors as they finish.

    A night that workers are lost in is given up, and so is a log that does not answer; a motor of
    which more are lost, or of which it is not known in what, has failed.

    Raises
    ------
    EngineError
        If there is nothing that tasks can run on any more.
    """
    by_id = {task.spec.motor_id: task for task in tasks}
    parts: list[PartTask] = []
    lose = set_aside if first else lost
    for outcome in results_of(run_tasks, function, tasks, lose, without_lost_part, first=first):
        if isinstance(outcome, SplitMotor):
            task = replace(by_id[outcome.motor_id], looked_at=outcome.looked_at)
            parts += [PartTask(task, nights, task.staging) for nights in outcome.parts]
        else:
            yield outcome
    if parts:
        yield from _in_parts(run_tasks, function, parts, first=first)


def _in_parts(
    run_tasks: RunTasks, function: RunMotor, parts: Sequence[PartTask], *, first: bool
) -> Iterator[MotorOutcome]:
    """Do the parts, then the tasks of the motors that they are of."""
    lose = set_aside if first else lost

    def lose_part(task: PartTask, loss: Loss) -> PartOutcome:
        failure = lose(task.motor, loss)
        return PartOutcome(task.motor.spec.motor_id, task.name, failure=failure)

    tasks = {part.motor.spec.motor_id: part.motor for part in parts}
    made: defaultdict[str, list[PartOutcome]] = defaultdict(list)
    for part in results_of(
        run_tasks, run_part, parts, lose_part, part_without_lost_part, first=first
    ):
        made[part.motor_id].append(part)
    joined: list[MotorTask] = []
    for motor_id, task in tasks.items():
        done = sorted(made[motor_id], key=lambda part: part.name)
        given_up = {night: loss for part in done for night, loss in part.given_up.items()}
        silent = {log: loss for part in done for log, loss in part.silent.items()}
        failure = next((part.failure for part in done if part.failure), None)
        if failure is None and len(given_up) > MOST_GIVEN_UP:
            failure = lost(task, _first_too_many(given_up))
        if failure is not None:
            yield failure
        else:
            names = tuple(part.name for part in done)
            joined.append(replace(task, parts=names, given_up=given_up, silent=silent))
    for outcome in results_of(run_tasks, function, joined, lose, without_lost_part, first=first):
        assert isinstance(outcome, MotorOutcome)
        yield _with_parts(outcome, made[outcome.motor_id])


def _first_too_many(given_up: Mapping[dt.date, Loss]) -> Loss:
    """The loss at which a task that is not split would have given up the motor."""
    return given_up[sorted(given_up)[MOST_GIVEN_UP]]


def _with_parts(outcome: MotorOutcome, parts: Sequence[PartOutcome]) -> MotorOutcome:
    """A motor's outcome with the time and the memory of its parts."""
    if not outcome.finished:
        return outcome
    seconds = Counter(outcome.seconds)
    for part in parts:
        seconds.update(part.seconds)
    memory = max(outcome.peak_memory_mib or 0.0, *(part.peak_memory_mib or 0.0 for part in parts))
    return replace(outcome, seconds=dict(seconds), peak_memory_mib=memory)

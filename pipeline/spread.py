"""Motors over an engine: one with many nights to read is split, so that all workers share them.

First every motor has its task; one whose plan is long comes back as parts. The parts are done side
by side, and then the motor's task once more, which takes each night that was made as if it had made
it itself. So a split motor has the bytes of one that is not.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from pipeline.engine import RunTasks
from pipeline.motor_task import (
    MotorOutcome,
    MotorTask,
    PartOutcome,
    PartTask,
    SplitMotor,
    run_part,
)

Lost = Callable[[MotorTask, str], MotorOutcome]


def run_motors(
    run_tasks: RunTasks,
    function: Callable[[MotorTask], MotorOutcome | SplitMotor],
    tasks: Sequence[MotorTask],
    lost_task: Lost,
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors as they finish.

    Parameters
    ----------
    run_tasks
        From `open_engine`.
    function
        Does a motor's task.
    tasks
        The motors; ``nights_a_part`` says which are split.
    lost_task
        The outcome of a motor one of whose tasks could not be done, and how.
    """
    by_id = {task.spec.motor_id: task for task in tasks}
    parts: list[PartTask] = []
    for outcome in run_tasks(function, tasks, lost_task):
        if isinstance(outcome, SplitMotor):
            task = replace(by_id[outcome.motor_id], looked_at=outcome.looked_at)
            parts += [PartTask(task, nights, task.staging) for nights in outcome.parts]
        else:
            yield outcome
    if parts:
        yield from _in_parts(run_tasks, function, parts, lost_task)


def _in_parts(
    run_tasks: RunTasks,
    function: Callable[[MotorTask], MotorOutcome | SplitMotor],
    parts: Sequence[PartTask],
    lost_task: Lost,
) -> Iterator[MotorOutcome]:
    """Do the parts, then the tasks of the motors that they are of."""

    def lost_part(task: PartTask, how: str) -> PartOutcome:
        return PartOutcome(task.motor.spec.motor_id, task.name, lost_task(task.motor, how))

    tasks = {part.motor.spec.motor_id: part.motor for part in parts}
    made: defaultdict[str, list[PartOutcome]] = defaultdict(list)
    for part in run_tasks(run_part, parts, lost_part):
        made[part.motor_id].append(part)
    joined: list[MotorTask] = []
    for motor_id, task in tasks.items():
        done = sorted(made[motor_id], key=lambda part: part.name)
        failure = next((part.failure for part in done if part.failure), None)
        if failure is not None:
            yield failure
        else:
            joined.append(replace(task, parts=tuple(part.name for part in done)))
    for outcome in run_tasks(function, joined, lost_task):
        assert isinstance(outcome, MotorOutcome)
        memory = [part.peak_memory_mib or 0.0 for part in made[outcome.motor_id]]
        yield replace(outcome, peak_memory_mib=max(memory)) if outcome.finished else outcome

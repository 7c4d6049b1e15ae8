"""Engines that do the tasks of a run: worker processes of this machine, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, TypeVar

from pipeline.config import Execution
from pipeline.errors import EngineError
from pipeline.workers.local import Crew
from pipeline.workers.process import Loss

Task = TypeVar("Task")
Result = TypeVar("Result")


class RunTasks(Protocol):
    """Runs tasks: their results as they finish, in any order.

    Parameters
    ----------
    function
        Does a task; what it is made of must be importable, as workers are fresh processes.
    tasks
        Plain data, small enough to send.
    lost
        The result of a task that was lost.
    first
        Whether each is tried only once, and one of which nothing is heard is not waited for.
    """

    def __call__(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        lost: Callable[[Task, Loss], Result],
        *,
        first: bool = False,
    ) -> Iterator[Result]: ...


@contextmanager
def open_engine(
    execution: Execution,
    folders: Sequence[Path] = (),
    stores: Sequence[str] = (),
) -> Iterator[RunTasks]:
    """The configured engine, for all tasks of a run.

    Parameters
    ----------
    execution
        Which one, and how much of it.
    folders
        What workers elsewhere must see: logs and output.
    stores
        URLs of object stores that they must have a way to.

    Raises
    ------
    EngineError
        If there is none: see `dask_cluster.connected`.
    """
    if execution.backend == "dask":
        from pipeline.workers.dask_cluster import connected
        from pipeline.workers.dask_engine import DaskEngine
        from pipeline.workers.dask_worker import Surroundings, own_versions

        expected = Surroundings(own_versions(), tuple(folders), tuple(stores))
        with connected(execution, expected) as client:
            yield DaskEngine(client, execution, expected).run_tasks
        return

    with Crew(execution) as crew:
        yield crew.run_tasks


def results_of(
    run_tasks: RunTasks,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    lost: Callable[[Task, Loss], Result],
    without: Callable[[Task, Loss], Task | None],
    *,
    first: bool = False,
) -> Iterator[Result]:
    """Results of tasks; one that was lost in a known part of its work is done without that part.

    `without` gives the task without the part that it was lost in; None where that is not known, or
    too much. The first time, a task that was lost is left as it is.

    Raises EngineError if nothing of it could be done.
    """
    if first:
        yield from run_tasks(function, tasks, lost, first=True)
        return
    rest: list[Task] = []

    def lose(task: Task, loss: Loss) -> Result | None:
        smaller = without(task, loss)
        if smaller is None:
            return lost(task, loss)
        rest.append(smaller)
        return None

    for result in run_tasks(function, tasks, lose):
        if result is not None:
            yield result
    if not rest:
        return
    try:
        yield from results_of(run_tasks, function, rest, lost, without)
    except EngineError as error:  # of them nothing is done, of the others all
        yield from (lost(task, Loss(error.code, error.message)) for task in rest)


def nights_a_chunk(execution: Execution, n_motors: int) -> int:
    """Nights of a chunk of a motor; 0 where its workers have enough motors to do."""
    if execution.backend == "dask" and execution.scheduler:
        return execution.nights_a_part
    alone = execution.backend == "sequential" or execution.workers <= n_motors
    return 0 if alone else execution.nights_a_part

"""What the tasks of a run are spread over: worker processes of this machine, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, TypeVar

from pipeline.config import Execution
from pipeline.workers import run_tasks

# Over a cluster a task that takes longer than this a night hangs.
LONGEST_NIGHT_S = 1800.0
NIGHTS_A_YEAR = 366

Task = TypeVar("Task")
Result = TypeVar("Result")


class RunTasks(Protocol):
    """Runs tasks: their results as they finish, in any order."""

    def __call__(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        lost: Callable[[Task, str], Result],
    ) -> Iterator[Result]: ...


@contextmanager
def open_engine(execution: Execution, folders: Sequence[Path] = ()) -> Iterator[RunTasks]:
    """The configured engine, for all tasks of a run.

    Parameters
    ----------
    execution
        Which one, and how much of it.
    folders
        What workers elsewhere must see: logs and output.

    Raises
    ------
    EngineError
        If there is none: see `dask_cluster.connected`.
    """
    if execution.backend == "dask":
        from pipeline.dask_cluster import connected
        from pipeline.dask_engine import DaskEngine
        from pipeline.dask_worker import Surroundings, own_versions

        # A task has a part's nights at most, unless none is split.
        limit_s = LONGEST_NIGHT_S * (execution.nights_a_part or NIGHTS_A_YEAR)
        expected = Surroundings(own_versions(), tuple(folders), limit_s)
        with connected(execution, expected) as client:
            yield DaskEngine(client, execution, expected).run_tasks
        return

    def here(
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        lost: Callable[[Task, str], Result],
    ) -> Iterator[Result]:
        return run_tasks(function, tasks, lost, execution)

    yield here


def nights_a_part(execution: Execution) -> int:
    """How many nights of a motor make a part; 0 where there is one worker to do them all."""
    if execution.backend == "dask" and execution.scheduler:
        return execution.nights_a_part
    alone = execution.backend == "sequential" or execution.workers == 1
    return 0 if alone else execution.nights_a_part

"""Tasks of a run over worker processes of this machine, a Dask cluster, or none of them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pipeline.config import Execution
from pipeline.workers.process import Done, Loss, attempt

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")

# Gives each task with what came of it, as they finish, with at most so many under way.
Tried = Callable[[Callable[[Any], Any], Iterable[Any], int], Iterator[tuple[Any, Done[Any] | Loss]]]


@contextmanager
def open_workers(
    execution: Execution, folders: Sequence[Path] = (), stores: Sequence[str] = ()
) -> Iterator[Workers]:
    """The configured workers, for all tasks of a run.

    `folders` and `stores` are what those of a cluster must see: logs and output, and URLs of object
    stores. Raises EngineError if there are none: see `cluster.open_cluster`.
    """
    if execution.backend == "sequential":
        # In the run's own process: a task that hangs or dies takes the run with it.
        yield Workers(lambda do, tasks, _: ((one, attempt(do, one)) for one in tasks), 1)
    elif execution.backend == "dask":
        from pipeline.workers.cluster import open_cluster

        with open_cluster(execution, folders, stores) as cluster:
            yield Workers(cluster.tried, execution.tasks_in_flight)
    else:
        from pipeline.workers.local import open_pool

        with open_pool(execution) as pool:
            yield Workers(pool.tried, execution.workers)


@dataclass(frozen=True, slots=True)
class Workers:
    """The way in which tasks are tried, and how many of them at a time."""

    tried: Tried
    at_a_time: int

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, Loss], Result],
        without: Callable[[Task, Loss], Task | None] = lambda *_: None,
    ) -> Iterator[Result]:
        """Results of tasks as they finish, in any order.

        One that was lost may have been so by its neighbour: it is tried again when all others are
        done, with nothing beside it. If it is lost again, what it was lost in is left out.

        Parameters
        ----------
        function
            Does a task; what it is made of must be importable, as workers are fresh processes.
        tasks
            Plain data, small enough to send; drawn one by one, and not always by this thread.
        lost
            The result of a task that was lost.
        without
            The task without the part that it was lost in; None where that is not known, or too
            much.

        Raises
        ------
        EngineError
            If there is nothing that tasks could run on, before any was done.
        """
        losses: list[tuple[Task, Loss]] = []
        for task, outcome in self.tried(function, tasks, self.at_a_time):
            if isinstance(outcome, Done):
                yield outcome.result
            else:
                losses.append((task, outcome))
        for task, loss in losses:
            # A log that does not answer is not asked twice.
            again = without(task, loss) if loss.log else task
            while again is not None and loss.code != "scheduler_lost":
                log.warning("a task is tried again, alone: %s", loss.how)
                task = again
                ((_, outcome),) = self.tried(function, [task], 1)
                if isinstance(outcome, Done):
                    yield outcome.result
                    break
                loss, again = outcome, without(task, outcome)
            else:
                yield lost(task, loss)

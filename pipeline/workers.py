"""Independent tasks over worker processes: a task that kills its worker costs itself alone."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from pipeline.config import Execution

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")

# Tasks handed out ahead, for each worker; of these one can have killed its worker.
SUSPECTS_A_WORKER = 2


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    lost: Callable[[Task, str], Result],
    execution: Execution,
) -> Iterator[Result]:
    """Results as the tasks finish, in any order.

    Parameters
    ----------
    function
        Does a task. It must be importable: workers are fresh processes.
    tasks
        Plain data, small enough to send.
    lost
        The result of a task whose worker died twice, and how it died.
    execution
        How many workers; with one the tasks are done here.
    """
    if execution.backend == "sequential" or execution.workers == 1 or len(tasks) < 2:
        yield from map(function, tasks)
        return
    # Workers read this when they start: with all threads each they would fight for the cores.
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    waiting = dict(enumerate(tasks))
    while waiting:
        try:
            for number, result in _parallel(function, waiting.items(), execution.workers):
                del waiting[number]
                yield result
        except TerminatedWorkerError:
            # Tasks start in order: whichever killed its worker is among the first that wait.
            suspects = list(waiting)[: SUSPECTS_A_WORKER * execution.workers]
            log.warning("a worker died; %d tasks are tried again, each alone", len(suspects))
            for number in suspects:
                yield _alone(function, waiting.pop(number), lost)


def _parallel(
    function: Callable[[Task], Result], tasks: Iterable[tuple[int, Task]], workers: int
) -> Iterator[tuple[int, Result]]:
    with parallel_config(backend="loky", inner_max_num_threads=1), warnings.catch_warnings():
        # An interrupted run cancels what is under way, and says so itself.
        warnings.filterwarnings("ignore", ".*still being processed by the workers", UserWarning)
        pool = Parallel(n_jobs=workers, return_as="generator_unordered", batch_size=1)
        yield from pool(delayed(_numbered)(function, number, task) for number, task in list(tasks))


def _numbered(function: Callable[[Task], Result], number: int, task: Task) -> tuple[int, Result]:
    return number, function(task)


def _alone(
    function: Callable[[Task], Result], task: Task, lost: Callable[[Task, str], Result]
) -> Result:
    """A task in a worker of its own, so that its death costs nobody else."""
    try:
        # Two workers, one task: a single one would run it in this very process.
        return next(result for _, result in _parallel(function, [(0, task)], 2))
    except TerminatedWorkerError as error:
        return lost(task, error.args[0].splitlines()[0])

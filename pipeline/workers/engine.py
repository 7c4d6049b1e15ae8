"""Tasks of a run over worker processes of this machine, a Dask cluster, or none of them.

On this machine joblib starts and feeds the workers. A worker that dies takes its whole pool with
it, whoever's fault that was: the tasks that were begun are tried again alone, the others go on in a
new call.
"""

from __future__ import annotations

import json
import logging
import os
import re
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from threading import Event, Thread
from typing import Any

from pipeline.config import Execution
from pipeline.workers.process import Loss, Mark, Result, Task, Tried, attempt, begin_worker, do

log = logging.getLogger(__name__)

# Read by the libraries as a worker loads them. With all threads each, workers would fight for the
# cores; Arrow's own allocator reserves a gibibyte at once, which would count as used. The C library
# (glibc; others ignore it) keeps the pages of arrays of up to 64 MiB, as fresh ones take 8 % of a
# motor-day at 10 Hz, and asks for huge ones, with which two workers hinder each other less.
ENVIRONMENT: Mapping[str, str] = {
    "POLARS_MAX_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_MMAP_THRESHOLD_": str(1 << 26),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 27),
}
HUGE_PAGES = "glibc.malloc.hugetlb=1"
# So often the run looks at the marks [s].
LOOK_S = 0.25
# A worker that has not ended by itself so long after its time is killed [s].
GRACE_S = 2.0
# What allocators in C, C++ and Rust say before they abort.
NO_MEMORY = re.compile(
    r"^.*(memory allocation|bad_alloc|out of memory|cannot allocate|MemoryError).*$",
    re.IGNORECASE | re.MULTILINE,
)
# Of joblib: the end of a process.
END = re.compile(r"(SIG\w+|EXIT)\(-?\d+\)")


@contextmanager
def open_workers(execution: Execution, folders: Sequence[Path] = ()) -> Iterator[Workers]:
    """The configured workers, for all tasks of a run.

    `folders` are what those of a cluster must see: logs and output. Raises EngineError if there are
    none: see `cluster.open_cluster`.
    """
    if execution.backend == "sequential":
        # In the run's own process: a task that hangs or dies takes the run with it.
        yield Workers(lambda function, tasks: ((task, attempt(function, task)) for task in tasks))
    elif execution.is_cluster:
        from pipeline.workers.cluster import open_cluster

        with open_cluster(execution, folders) as tried:
            yield Workers(tried)
    else:
        with open_pool(execution) as pool:
            yield Workers(pool.tried, pool.marks)


@dataclass(frozen=True, slots=True)
class Workers:
    """The way in which tasks are tried."""

    tried: Tried
    # Marks of tasks under way; a cluster gives none.
    marks: Callable[[], Sequence[Mark]] = tuple

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, Loss], Result],
        without: Callable[[Task, Loss], Task | None] = lambda *_: None,
    ) -> Iterator[Result]:
        """Yield results of tasks as they finish, in any order.

        A task may have been lost by its neighbour's fault: it is tried again when all others are
        done, with nothing beside it. If it is lost again, what it was lost in is left out.

        Tasks are plain data, drawn singly, and not always by this thread. `lost` gives the
        result of a lost task, `without` the task without the part that it was lost in; None where
        that is not known, or too much.
        """
        losses: list[tuple[Task, Loss]] = []
        for task, outcome in self.tried(function, tasks):
            if isinstance(outcome, Loss):
                losses.append((task, outcome))
            else:
                yield outcome
        for task, loss in losses:
            again: Task | None = task
            while again is not None and loss.code != "scheduler_lost":
                log.warning("%s: tried again, alone: %s", task, loss.how)
                task = again
                ((_, outcome),) = self.tried(function, [task])
                if not isinstance(outcome, Loss):
                    yield outcome
                    break
                loss, again = outcome, without(task, outcome)
            else:
                yield lost(task, loss)


@contextmanager
def open_pool(execution: Execution) -> Iterator[Pool]:
    """Worker processes for all tasks of a run, started when there are tasks for them."""
    before = dict(os.environ)
    # Tunables of the C library are added to those that are set.
    tunables = ":".join(filter(None, (os.environ.get("GLIBC_TUNABLES"), HUGE_PAGES)))
    os.environ.update(ENVIRONMENT, GLIBC_TUNABLES=tunables)
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as folder:
        pool = Pool(execution, Path(folder))
        watch = Thread(target=pool.watch, daemon=True, name="watch over workers")
        watch.start()
        try:
            yield pool
        finally:
            if "joblib" in sys.modules:
                from joblib.externals.loky import get_reusable_executor

                # A task under way is dropped, and has published nothing.
                get_reusable_executor(reuse=True).shutdown(kill_workers=True)
            pool.left.set()
            watch.join()
            for name in (*ENVIRONMENT, "GLIBC_TUNABLES"):
                del os.environ[name]
            os.environ.update(before)


@dataclass(frozen=True, slots=True)
class Pool:
    """Workers, and the folder of their marks and last words."""

    execution: Execution
    folder: Path
    left: Event = field(default_factory=Event)

    def tried(
        self, function: Callable[[Any], Any], tasks: Iterable[Any]
    ) -> Iterator[tuple[Any, Any]]:
        """Each task with what came of it, as they finish; never more than workers under way."""
        waiting: Iterator[tuple[int, Any]] = enumerate(tasks)
        under_way: dict[int, Any] = {}

        def calls(first: tuple[int, Any]) -> Iterator[Any]:
            for number, task in chain([first], waiting):
                under_way[number] = task
                yield delayed(do)(function, task, self.execution, number)

        while (first := next(waiting, None)) is not None:
            from joblib import Parallel, delayed  # which takes its time, and is not always needed

            parallel = Parallel(
                # A single worker would be the run's own process.
                n_jobs=max(2, self.execution.workers),
                pre_dispatch=self.execution.workers,
                batch_size=1,
                return_as="generator_unordered",
                # Otherwise arrays go through shared memory, which may be small.
                max_nbytes=None,
                initializer=begin_worker,
                initargs=(os.getpid(), str(self.folder), self.execution.memory_limit_mib << 20),
            )
            results: Generator[tuple[int, Any, str]] = parallel(calls(first))
            begun: set[int] = set()
            try:
                for number, outcome, words in results:
                    sys.stderr.write(words)
                    yield under_way.pop(number), outcome
            except BrokenProcessPool as error:
                begun, loss = self._loss(str(error))
            finally:
                with warnings.catch_warnings():  # that it is not at its end
                    warnings.simplefilter("ignore")
                    results.close()
            # Where none could be begun, all are lost.
            for number in begun.intersection(under_way) or list(under_way):
                yield under_way.pop(number), loss
            waiting, under_way = chain(list(under_way.items()), waiting), {}

    def _loss(self, error: str) -> tuple[set[int], Loss]:
        """Numbers of the tasks that a dead pool had begun; their loss, by a mark and last words."""
        marks = {mark.number: mark for _, mark in self._marks() if mark.number >= 0}
        mark = next(iter(marks.values()), Mark())
        words = "".join(path.read_text("utf-8", "replace") for path in self.folder.glob("*.words"))
        sys.stderr.write(words)
        for place in self.folder.iterdir():
            place.unlink()
        no_memory, end = NO_MEMORY.search(words), END.search(error)
        log_name = ""
        if time.monotonic() > mark.until_s:
            code, log_name = "log_no_answer" if mark.log else "task_timeout", mark.log
            how = f"{mark.log} did not answer" if mark.log else "not done"
            how += f" within {mark.limit_s:g} s"
        else:
            code = "task_memory" if no_memory else "worker_died"
            how = f"its worker process ended with {end.group() if end else 'no word'}"
            how += f": {no_memory.group().strip()}" if no_memory else ""
        how += f", at {mark.part}" if mark.part else ""
        return {*marks}, Loss(code, how, mark.part, log_name)

    def _marks(self) -> Iterator[tuple[int, Mark]]:
        """Yield marks of workers by their process."""
        for place in self.folder.glob("*.mark"):
            with suppress(ValueError, OSError):
                line = place.read_bytes().partition(b"\n")[0]
                yield int(place.stem), Mark(*json.loads(line))

    def marks(self) -> list[Mark]:
        """Return the marks of tasks under way."""
        return [mark for _, mark in self._marks() if mark.number >= 0]

    def watch(self) -> None:
        """Kill workers that cannot end by themselves."""
        while not self.left.wait(LOOK_S):
            for pid, mark in self._marks():
                if time.monotonic() > mark.until_s + GRACE_S:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)

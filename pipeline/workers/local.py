"""Independent tasks over worker processes of this machine, which joblib starts and feeds.

A worker that dies takes joblib's whole pool with it. Marks tell which tasks were under way; the
others go on in a new call.
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
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path, PurePath
from threading import Event, Lock, Thread
from typing import Any, TypeVar

from pipeline.config import Execution
from pipeline.workers.process import Done, Limits, Loss, Mark, begin_worker, do

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")

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
# Of what a worker writes to stderr, the end may tell what it died of [bytes].
LAST_WORDS = 1 << 16
# What allocators in C, C++ and Rust say before they abort.
NO_MEMORY = re.compile(
    r"^.*(memory allocation|bad_alloc|out of memory|cannot allocate|MemoryError).*$",
    re.IGNORECASE | re.MULTILINE,
)
# Of `faulthandler`: the first line where the time was up, and one of the stack, innermost first.
TIME_UP = re.compile(r"^Timeout \(.+\)!$", re.MULTILINE)
FRAME = re.compile(r'^  File "(.+)", line (\d+) in (.+)$', re.MULTILINE)
# Of joblib: the end of a process.
END = re.compile(r"(SIG\w+)\(-\d+\)|EXIT\((\d+)\)")


@contextmanager
def open_pool(execution: Execution) -> Iterator[Pool]:
    """Worker processes for all tasks of a run, started when there are tasks for them."""
    # Tunables of the C library are added to those that are set.
    tunables = ":".join(filter(None, (os.environ.get("GLIBC_TUNABLES"), HUGE_PAGES)))
    before = {name: os.environ.get(name) for name in (*ENVIRONMENT, "GLIBC_TUNABLES")}
    os.environ.update(ENVIRONMENT, GLIBC_TUNABLES=tunables)
    with tempfile.TemporaryDirectory(prefix="motor-leakage-") as folder:
        pool = Pool(execution, Path(folder))
        try:
            yield pool
        finally:
            pool.end()
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


@dataclass(slots=True)
class Pool:
    """Workers, and the folder of their marks and last words."""

    execution: Execution
    folder: Path
    killed: set[int] = field(default_factory=set)
    told: dict[Path, int] = field(default_factory=dict)
    left: Event = field(default_factory=Event)
    watch: Thread | None = None
    lock: Lock = field(default_factory=Lock)

    def tried(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], n_workers: int
    ) -> Iterator[tuple[Task, Done[Result] | Loss]]:
        """Each task with what came of it, as they finish; never more than so many under way.

        Of several that were under way when a worker died it is not known whose fault it was.
        """
        numbered: Iterator[tuple[int, Task]] = enumerate(tasks)
        under_way: dict[int, Task] = {}
        while True:
            try:
                for number, outcome in self._results(function, numbered, under_way, n_workers):
                    yield under_way.pop(number), outcome
            except BrokenProcessPool as error:
                lost = self._losses(under_way, n_workers, str(error))
                yield from ((under_way.pop(number), loss) for number, loss in lost.items())
                numbered, under_way = chain(under_way.items(), numbered), {}
            else:
                return

    def _results(
        self,
        function: Callable[[Task], Result],
        numbered: Iterator[tuple[int, Task]],
        under_way: dict[int, Task],
        n_workers: int,
    ) -> Iterator[tuple[int, Done[Result] | Loss]]:
        """Results by number; into `under_way` go the tasks that joblib takes."""
        if (first := next(numbered, None)) is None:
            return
        from joblib import Parallel, delayed

        if self.watch is None:
            self.watch = Thread(target=self._watch, daemon=True, name="watch over workers")
            self.watch.start()
        execution = self.execution
        limits = Limits(execution.timeout_s, execution.answer_s)
        parallel = Parallel(
            # One would be the run's own process.
            n_jobs=max(2, execution.workers),
            pre_dispatch=n_workers,
            batch_size=1,
            return_as="generator_unordered",
            # Otherwise arrays go through shared memory, which may be small.
            max_nbytes=None,
            initializer=begin_worker,
            initargs=(os.getpid(), str(self.folder), execution.memory_limit_mib << 20),
        )

        def calls() -> Iterator[Any]:
            for number, task in chain([first], numbered):
                under_way[number] = task
                yield delayed(do)(function, task, limits, number)

        with _interrupts_kept_from_workers():
            results: Generator[tuple[int, Any]] = parallel(calls())
        try:
            for result in results:  # noqa: UP028 - it would close it where it warns
                yield result
        finally:
            with warnings.catch_warnings():  # that it is not at its end
                warnings.simplefilter("ignore")
                results.close()

    def _losses(
        self, under_way: Mapping[int, object], n_workers: int, error: str
    ) -> dict[int, Loss]:
        """Losses by task; the pool and what its workers left are gone."""
        self._pass_on_words()
        lost = {
            mark.number: self._loss(place, mark, error)
            for place, mark in self._marks()
            if mark.number in under_way
        }
        with self.lock:
            for place in self.folder.iterdir():
                place.unlink()
            self.told.clear()
            self.killed.clear()
        # Without a mark: none of them could be begun.
        ended = Loss("worker_died", f"its worker process ended with {_end(error)}")
        return lost or dict.fromkeys(islice(under_way, n_workers), ended)

    def _loss(self, place: Path, mark: Mark, error: str) -> Loss:
        """The loss of the task of a worker that is dead."""
        said = place.with_suffix(".words").read_bytes()[mark.said :]
        words = said[-LAST_WORDS:].decode("utf-8", "replace")
        no_memory = NO_MEMORY.search(words)
        is_late = int(place.stem) in self.killed or TIME_UP.search(words) is not None
        if is_late and mark.log:
            verb = "answer" if mark.is_asked else "come to its end"
            how = f"{mark.log} did not {verb} within {mark.limit_s:g} s"
            return Loss("log_no_answer", how, mark.part, mark.log)
        if is_late:
            how = f"not done within {mark.limit_s:g} s"
        else:
            how = f"its worker process ended with {_end(error)}"
            how += f": {no_memory.group().strip()}" if no_memory else ""
        how += f", at {mark.part}" if mark.part else ""
        if frame := FRAME.search(words):
            file, line, function = frame.groups()
            how += f", in {function} ({PurePath(file).name}, line {line})"
        code = "task_timeout" if is_late else "task_memory" if no_memory else "worker_died"
        return Loss(code, how, mark.part)

    def _marks(self) -> Iterator[tuple[Path, Mark]]:
        for place in self.folder.glob("*.mark"):
            with suppress(ValueError, OSError):
                yield place, Mark(**json.loads(place.read_bytes().partition(b"\n")[0]))

    def _watch(self) -> None:
        """Kill workers that cannot end by themselves, and pass on what they say."""
        while not self.left.wait(LOOK_S):
            self._pass_on_words()
            for place, mark in self._marks():
                if mark.number >= 0 and time.monotonic() > mark.until_s + GRACE_S:
                    pid = int(place.stem)
                    self.killed.add(pid)
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)

    def _pass_on_words(self) -> None:
        with self.lock:
            for place in self.folder.glob("*.words"):
                begin = self.told.get(place, 0)
                text = place.read_bytes()[begin:]
                self.told[place] = begin + len(text)
                sys.stderr.write(text.decode("utf-8", "replace"))
        sys.stderr.flush()

    def end(self) -> None:
        """End all workers; a task under way is dropped, and has published nothing."""
        if self.watch is None:
            return
        from joblib.externals.loky import get_reusable_executor

        get_reusable_executor(reuse=True).shutdown(kill_workers=True)
        self.left.set()
        self.watch.join()
        self._pass_on_words()


@contextmanager
def _interrupts_kept_from_workers() -> Iterator[None]:
    """What a terminal sends to all processes is for the run, which decides what ends.

    Workers inherit what is blocked while they are started.
    """
    from multiprocessing import resource_tracker

    from joblib.externals.loky.backend import resource_tracker as tracker_of_joblib

    # These let the signals through again when they are started.
    resource_tracker.ensure_running()
    tracker_of_joblib.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(error: str) -> str:
    """The end of a process that joblib tells of, in words."""
    if (found := END.search(error)) is None:
        return "nothing that could be heard"
    name, exit_code = found.groups()
    if exit_code is not None:
        return f"exit code {exit_code}"
    hint = ", as the system does for want of memory" if name == "SIGKILL" else ""
    return f"{name}{hint}"

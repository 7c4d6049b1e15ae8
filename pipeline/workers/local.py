"""Independent tasks over worker processes: what a task does to its worker costs itself alone.

A worker has one task at a time and a connection of its own, so it is known which task it was that a
worker died of, hung in, or wanted too much memory for. A lost task is tried once more when all
others are done, with nothing beside it.
"""

from __future__ import annotations

import logging
import os
import re
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Self, TypeVar

from pipeline.workers.process import Assignment, Done, Loss, SignOfLife, attempt, start

if TYPE_CHECKING:
    from pipeline.config import Execution

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
# A worker takes a task up within this time, [s], loading of the program included.
START_S = 120.0
# A worker that is told to die is killed if it has not done so by then, [s].
GRACE_S = 5.0
# Of what a worker writes to stderr, the end may tell what it died of, [bytes].
LAST_WORDS = 1 << 16
# What allocators in C, C++ and Rust say before they abort.
NO_MEMORY = re.compile(
    r"^.*(memory allocation|bad_alloc|out of memory|cannot allocate|MemoryError).*$",
    re.IGNORECASE | re.MULTILINE,
)
# A line of `faulthandler`; the first is the innermost.
FRAME = re.compile(r'^  File "(.+)", line (\d+) in (.+)$', re.MULTILINE)


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    lost: Callable[[Task, Loss], Result],
    execution: Execution,
) -> Iterator[Result]:
    """As `Crew.run_tasks`, over workers that are there for these tasks alone."""
    with Crew(execution) as crew:
        yield from crew.run_tasks(function, tasks, lost)


class Crew:
    """Worker processes for all the tasks of a run, started when there are tasks for them.

    Parameters
    ----------
    execution
        Their number and limits. With backend ``sequential`` tasks are done here and once; one that
        hangs or dies takes the run with it.
    """

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        self._workers: list[Worker] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """End all workers; a task under way is dropped, and has published nothing."""
        for worker in self._workers:  # their memory is given back side by side
            worker.process.kill()
        while self._workers:
            self._workers.pop().kill()

    def run_tasks(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        lost: Callable[[Task, Loss], Result],
        *,
        first: bool = False,
    ) -> Iterator[Result]:
        """Results as `RunTasks` says."""
        tried: Iterator[tuple[Task, Done[Result] | Loss]]
        if self._execution.backend == "sequential":
            tried = ((task, attempt(function, task)) for task in tasks)
        elif first:
            tried = self._side_by_side(
                function, tasks, self._execution.workers, self._execution.hasty
            )
        else:
            tried = self._tried_twice(function, tasks)
        for task, outcome in tried:
            yield outcome.result if isinstance(outcome, Done) else lost(task, outcome)

    def _tried_twice(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[Task, Done[Result] | Loss]]:
        again: list[Task] = []
        workers, limits = self._execution.workers, self._execution
        for task, outcome in self._side_by_side(function, tasks, workers, limits):
            # A log that does not answer is not asked twice.
            if isinstance(outcome, Done) or outcome.log:
                yield task, outcome
            else:
                log.warning("a task is lost and will be tried again, alone: %s", outcome.how)
                again.append(task)
        if again:
            # In a fresh process, with all the memory that there is.
            self.end()
            yield from self._side_by_side(function, again, 1, limits)

    def _side_by_side(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        n_workers: int,
        execution: Execution,
    ) -> Iterator[tuple[Task, Done[Result] | Loss]]:
        """Each task with what came of it, as they finish."""
        waiting = deque(tasks)
        at_work: dict[Worker, Task] = {}
        finished: list[tuple[Task, Done[Result] | Loss]] = []
        try:
            while waiting or at_work:
                while waiting and len(at_work) < n_workers:
                    task = waiting.popleft()
                    worker = self._idle(at_work)
                    worker.begin(function, task, execution)
                    at_work[worker] = task
                # Workers go on while somebody looks at what is finished.
                yield from finished
                news = _news_of(at_work)
                found = [(worker, worker.outcome(news)) for worker in at_work]
                finished = [
                    (at_work.pop(worker), outcome)
                    for worker, outcome in found
                    if outcome is not None
                ]
            yield from finished
        finally:
            # Nobody waits any more for what these do.
            for worker in at_work:
                worker.kill()

    def _idle(self, at_work: Container[Worker]) -> Worker:
        for worker in self._workers:
            if worker not in at_work:
                return worker
        self._workers.append(Worker())
        return self._workers[-1]


def run_task(
    worker: Worker, function: Callable[[Task], Result], task: Task, execution: Execution
) -> Done[Result] | Loss:
    """Outcome of a task in a worker that has nothing else to do."""
    worker.begin(function, task, execution)
    while (outcome := worker.outcome(_news_of([worker]))) is None:
        pass
    return outcome


def _news_of(at_work: Collection[Worker]) -> Collection[object]:
    """Wait until a worker says something, dies, or has used up its time; ends with something."""
    due = min(worker.due for worker in at_work)
    ends = [end for worker in at_work for end in (worker.connection, worker.stderr)]
    return wait(ends, max(0.0, due - time.monotonic()))


def environment() -> dict[str, str]:
    """Variables of a worker; tunables of the C library are added to those that are set."""
    tunables = (os.environ.get("GLIBC_TUNABLES"), HUGE_PAGES)
    return {**ENVIRONMENT, "GLIBC_TUNABLES": ":".join(filter(None, tunables))}


class Worker:
    """A process that does one task at a time; if it dies of one, another does the next."""

    execution: Execution

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self.stderr, theirs = Pipe(duplex=False)
        os.set_blocking(self.stderr.fileno(), False)
        self.process, self.connection = start(
            "pipeline.workers.process.serve", environment(), theirs.fileno()
        )
        theirs.close()
        self.is_killed = False

    def begin(self, function: Callable[[Any], Any], task: object, execution: Execution) -> None:
        """Give it a task, and its limits."""
        if self.is_killed or self.process.poll() is not None:
            self._start()
        self.execution = execution
        self.sign, self.last_words, self.is_late = SignOfLife(), b"", False
        self.due = time.monotonic() + START_S
        with suppress(ConnectionError):  # dead already: heard of in a moment
            self.connection.send(Assignment(function, task, execution.memory_limit_mib))

    def outcome(self, news: Collection[object]) -> Done[Any] | Loss | None:
        """Outcome of its task, given the ends that have something; None while it is at work."""
        if self.stderr in news:
            self._pass_on_stderr()
        if self.connection not in news:
            # Others may have been waited for since: it may have spoken meanwhile.
            if time.monotonic() < self.due or self.connection.poll():
                return None
            self.is_late = True
            self.process.send_signal(signal.SIGALRM)
            return self._loss()
        try:
            message: SignOfLife | Done[Any] | Loss = self.connection.recv()
        except (EOFError, OSError):
            return self._loss()
        if isinstance(message, SignOfLife):
            self.sign = message
            self.due = time.monotonic() + self._limit_s
            return None
        return message

    @property
    def _limit_s(self) -> float:
        """Longest silence after the last sign of life."""
        return self.execution.answer_s if self.sign.is_asked else self.execution.timeout_s

    def _loss(self) -> Loss:
        """The loss that the worker died of."""
        self._wait_for_end()
        self.kill()
        self._pass_on_stderr()
        words = self.last_words.decode("utf-8", "replace")
        no_memory = NO_MEMORY.search(words)
        if self.is_late and self.sign.log:
            verb = "answer" if self.sign.is_asked else "come to its end"
            how = f"{self.sign.log} did not {verb} within {self._limit_s:g} s"
            return Loss("log_no_answer", how, self.sign.part, self.sign.log)
        if self.is_late:
            how = f"not done within {self._limit_s:g} s"
        else:
            how = f"its worker process ended with {_died(self.process.returncode)}"
            how += f": {no_memory.group().strip()}" if no_memory else ""
        how += f", at {self.sign.part}" if self.sign.part else ""
        if frame := FRAME.search(words):
            file, line, function = frame.groups()
            how += f", in {function} ({PurePath(file).name}, line {line})"
        code = "task_timeout" if self.is_late else "task_memory" if no_memory else "worker_died"
        return Loss(code, how, self.sign.part)

    def _pass_on_stderr(self) -> None:
        with suppress(BlockingIOError):
            while text := os.read(self.stderr.fileno(), LAST_WORDS):
                self.last_words = (self.last_words + text)[-LAST_WORDS:]
                sys.stderr.write(text.decode("utf-8", "replace"))
        sys.stderr.flush()

    def kill(self) -> None:
        """End the process, whatever it does, and wait for its end.

        Not for ever: in a call to a disk that hangs not even SIGKILL ends one.
        """
        self.process.kill()
        self._wait_for_end()
        self.is_killed = True

    def _wait_for_end(self) -> None:
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(GRACE_S)


def _died(exit_code: int | None) -> str:
    """The end of a process, in words."""
    if exit_code is None:
        return "nothing that could be heard"
    if exit_code >= 0:
        return f"exit code {exit_code}"
    name = signal.Signals(-exit_code).name
    hint = ", as the system does for want of memory" if name == "SIGKILL" else ""
    return f"{name}{hint}"

"""Inside a worker: the mark by which a run knows how far a task is, and its limits.

Whatever a task does to its process, the run goes on: the process ends when the run's does, when its
time is up, and when it asks for more memory than it may have.
"""

from __future__ import annotations

import ctypes
import faulthandler
import json
import logging
import math
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from threadpoolctl import ThreadpoolController

from pipeline.config import Execution

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")
# Gives each task with its result or loss, as they finish.
Tried = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[tuple[Any, Any]]]

PR_SET_PDEATHSIG = 1
# A task that goes on as before has its time limit anew at most so often [s].
AGAIN_S = 0.2


@dataclass(frozen=True, slots=True)
class Loss:
    """A task that was lost."""

    code: str  # from `docs/operations.md`
    how: str  # what happened, in words
    part: str = ""  # the part of its work that it was lost in; empty where it named none
    # The log that it was waiting for or reading when its time was up; empty without any.
    log: str = ""


class Mark(NamedTuple):
    """How far a task is."""

    number: int = -1  # of the task; -1: none is under way
    part: str = ""  # of its work
    log: str = ""  # the log that it waits for or reads; empty without any
    limit_s: float = 0.0  # the time that it has for it
    until_s: float = math.inf  # the end of that time, by the machine's monotonic clock
    n_done: int = 0  # parts of the task that are done
    n_left: int = 0  # parts to do, with that under way


# What was marked last, the file that it goes to, and the limits of a task, where there are any.
_mark = Mark()
_file: int | None = None
_limits: Execution | None = None


def begin_worker(run_pid: int, folder: str, memory_limit: int) -> None:
    """Prepare a process for tasks of a run whose death it does not outlive.

    Marks and last words go into files of a folder that are called after the process. The limit is
    that of its data [bytes], within what the system lets it have.
    """
    global _file
    # What a terminal sends to all processes is for the run, which decides what ends.
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != run_pid:  # it has died already
            os._exit(0)
    place = Path(folder) / str(os.getpid())
    words = os.open(place.with_suffix(".words"), os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(words, 2)
    os.close(words)
    # Dumped from C, without the interpreter, which may hang.
    faulthandler.enable(file=2)
    _file = os.open(place.with_suffix(".mark"), os.O_WRONLY | os.O_CREAT, 0o600)
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = memory_limit if most == resource.RLIM_INFINITY else min(memory_limit, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))


def do(
    function: Callable[[Task], Result], task: Task, limits: Execution, number: int = 0
) -> tuple[int, Result | Loss, str]:
    """Do a task within its limits; its number, what came of it, and what its process has said."""
    global _limits
    _limits = limits
    try:
        _say(Mark(number), limits.timeout_s)
        return number, attempt(function, task), _words()
    finally:
        faulthandler.cancel_dump_traceback_later()
        _limits = None
        _write(Mark())


def attempt(function: Callable[[Task], Result], task: Task) -> Result | Loss:
    """Do a task; what it raises is a loss and no exception."""
    try:
        return function(task)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a panic in Polars is no Exception
        log.exception("a task failed")
        return loss_of(error)


def loss_of(error: BaseException) -> Loss:
    """Return the loss by an error that nobody foresaw."""
    how = f"{type(error).__name__}: {error}"
    return Loss("task_memory" if isinstance(error, MemoryError) else "internal", how)


def sign_of_life(part: str, n_done: int = 0, n_left: int = 0) -> None:
    """Mark that a task begins with a part of its work, which has the whole time limit again."""
    if _limits:
        mark = _mark._replace(part=part, log="", n_done=n_done, n_left=n_left)
        _say(mark, _limits.timeout_s)


def still_alive() -> None:
    """Have the time of what was marked last begin anew."""
    if _limits and _mark.until_s - _mark.limit_s + AGAIN_S < time.monotonic():
        _say(_mark, _mark.limit_s)


@contextmanager
def reading(log: str, *, is_asked: bool = False) -> Iterator[None]:
    """Mark that a log is being read, or opened (asked), which may be on a mount that hangs."""
    if _limits is None:
        yield
        return
    before = _mark
    _say(before._replace(log=log), _limits.answer_s if is_asked else _limits.timeout_s)
    try:
        yield
    finally:
        _say(before, before.limit_s)


def _say(mark: Mark, limit_s: float) -> None:
    """Mark what is under way, and have the process end where that takes too long."""
    _write(mark._replace(limit_s=limit_s, until_s=time.monotonic() + limit_s))
    faulthandler.dump_traceback_later(limit_s, exit=True, file=2)


def _write(mark: Mark) -> None:
    global _mark
    _mark = mark
    if _file is not None:
        # One line: what is left of a longer line comes after it.
        os.pwrite(_file, json.dumps(mark).encode() + b"\n", 0)


def _words() -> str:
    """Return what a worker has said since it was asked last."""
    if _file is None:
        return ""
    words = os.pread(2, os.fstat(2).st_size, 0)
    os.ftruncate(2, 0)
    return words.decode("utf-8", "replace")


@cache
def _thread_pools() -> ThreadpoolController:
    """Return those loaded at the first call: to look takes longer than to limit."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Return linear algebra on a single thread: workers are as many as there are cores."""
    limited: AbstractContextManager[object] = _thread_pools().limit(limits=1)
    return limited

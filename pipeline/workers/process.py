"""Inside a worker: a process that does one task after the other and shares nothing with others.

Whatever a task does to its process, the run goes on: the process ends when the run's does, when its
time is up, and when it asks for more memory than it may have.
"""

from __future__ import annotations

import ctypes
import faulthandler
import logging
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache
from multiprocessing import Pipe
from multiprocessing import process as multiprocessing_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, TypeVar

from threadpoolctl import ThreadpoolController

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")
Item = TypeVar("Item")

MIB = 1 << 20
# So many files are looked at between two signs of life.
ITEMS_A_SIGN = 256
PR_SET_PDEATHSIG = 1

# The other end is the run; None where tasks are not done in a worker.
_run: Connection | None = None


@dataclass(frozen=True, slots=True)
class Done(Generic[Result]):
    """A task has come to its end."""

    result: Result


@dataclass(frozen=True, slots=True)
class Loss:
    """A task that was lost."""

    code: str  # from `docs/operations.md`
    how: str  # what happened, in words
    part: str = ""  # the part of its work that it was lost in; empty where it named none
    # The log that it was waiting for or reading when its time was up; empty without one.
    log: str = ""


@dataclass(frozen=True, slots=True)
class SignOfLife:
    """A task goes on, and with which part of its work."""

    part: str = ""  # of its work
    log: str = ""  # the log that it waits for or reads; empty without one
    is_asked: bool = False  # whether that is to answer at once: it is being opened


# What was said last.
_said = SignOfLife()


@dataclass(frozen=True, slots=True)
class Assignment:
    """A task for a worker."""

    # function, task: what to do, and with what.
    function: Callable[[Any], Any]
    task: Any
    memory_limit_mib: int  # largest size of the data of its process, [MiB]


def tell(run: Connection) -> None:
    """Say signs of life to a run from now on."""
    global _run
    _run = run


def sign_of_life(part: str) -> None:
    """Say that a task begins with a part of its work, which has the whole time limit again."""
    _say(SignOfLife(part))


def still_alive() -> None:
    """Say once more what was said last."""
    _say(_said)


def told_alive(items: Iterable[Item]) -> Iterator[Item]:
    """Items of which each takes little time, and all of them may take long."""
    for number, item in enumerate(items):
        if number % ITEMS_A_SIGN == 0:
            still_alive()
        yield item


@contextmanager
def asking(log: str) -> Iterator[None]:
    """Say that a log is being opened, which may be on a mount that hangs."""
    with _at(log, is_asked=True):
        yield


@contextmanager
def reading(log: str) -> Iterator[None]:
    """Say that a log which has answered is being read."""
    with _at(log, is_asked=False):
        yield


@contextmanager
def _at(log: str, *, is_asked: bool) -> Iterator[None]:
    before = _said
    _say(SignOfLife(before.part, log, is_asked))
    try:
        yield
    finally:
        _say(before)


def _say(sign: SignOfLife) -> None:
    global _said
    _said = sign
    if _run is not None:
        _run.send(sign)


def attempt(function: Callable[[Task], Result], task: Task) -> Done[Result] | Loss:
    """Do a task; what it raises is a loss and no exception."""
    try:
        return Done(function(task))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a panic in Polars is no Exception
        log.exception("a task failed")
        return loss_of(error)


def one_thread() -> AbstractContextManager[object]:
    """Linear algebra on one thread: workers are as many as there are cores.

    It limits the libraries that the process has loaded at the first call.
    """
    limited: AbstractContextManager[object] = _thread_pools().limit(limits=1)
    return limited


@cache
def _thread_pools() -> ThreadpoolController:
    """Libraries with threads of their own; to look for them takes longer than to limit them."""
    return ThreadpoolController()


def loss_of(error: BaseException) -> Loss:
    """The loss by an error that nobody foresaw."""
    how = f"{type(error).__name__}: {error}"
    return Loss("task_memory" if isinstance(error, MemoryError) else "internal", how)


def start(
    program: str, environment: Mapping[str, str] | None = None, stderr: int | None = None
) -> tuple[subprocess.Popen[bytes], Connection]:
    """Start a process beside this one, and open a connection to it.

    It is a fresh one: a fork of a process with threads may hang.

    Parameters
    ----------
    program
        A function, such as ``pipeline.workers.process.serve``; it is given the connection.
    environment
        Variables that it has beside those of this process.
    stderr
        File that takes what it writes to stderr; None: that of this process.
    """
    ours, theirs = Pipe()
    module, _, function = program.rpartition(".")
    # Relative entries are of the folder in which this process began.
    began_in = Path(getattr(multiprocessing_process, "ORIGINAL_DIR", None) or "")
    path = [str(began_in / one) for one in sys.path if isinstance(one, str)]
    code = (
        f"import sys; sys.path[:] = {path}; from {module} import {function}; "
        "from pipeline.workers.process import connected; "
        f"{function}(connected({theirs.fileno()}, {os.getpid()}, {stderr}))"
    )
    process = subprocess.Popen(  # noqa: S603 - it is this program
        [sys.executable, "-c", code],
        env={**os.environ, **(environment or {})},
        pass_fds=[theirs.fileno()] if stderr is None else [theirs.fileno(), stderr],
        # Out of reach of what a terminal sends to all processes: the run decides what ends.
        start_new_session=True,
    )
    # Once the process is the only one to hold it, the end closes with it.
    theirs.close()
    return process, ours


def connected(end: int, run_pid: int, stderr: int | None) -> Connection:
    """In a started process: its connection to the run, whose death it does not outlive."""
    _end_with_the_run(run_pid)
    if stderr is not None:  # nobody reads it before the process is loaded
        os.dup2(stderr, 2)
        os.close(stderr)
    connection = Connection(end)
    tell(connection)
    return connection


def serve(run: Connection) -> None:
    """Do the tasks that a run sends, until there is nobody left who sends any."""
    # The run sends SIGALRM when the time is up. Told from C, without the interpreter, which may
    # hang; then the process dies of it.
    faulthandler.enable()
    faulthandler.register(signal.SIGALRM, chain=True)
    while True:
        try:
            given: Assignment = run.recv()
        except EOFError:
            return
        _limit_memory(given.memory_limit_mib * MIB)
        sign_of_life("")
        run.send(attempt(given.function, given.task))


def _limit_memory(limit: int) -> None:
    """Limit the data of this process [bytes], within what the system lets it have."""
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    if most != resource.RLIM_INFINITY:
        limit = min(limit, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))


def _end_with_the_run(run_pid: int) -> None:
    """Have the kernel kill this process when the run dies; elsewhere it ends after its task."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != run_pid:  # it has died already
            os._exit(0)

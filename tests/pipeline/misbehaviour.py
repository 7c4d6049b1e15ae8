"""Tasks that do to their worker what a motor's task must not do to a run.

Libraries are loaded where they are needed, so that a worker for the others starts at once.
"""

from __future__ import annotations

import ctypes
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.workers.process import reading, sign_of_life, still_alive

GIB = 1 << 30


def do(task: str) -> str:
    """A task that does what it is called after, if that is a misbehaviour; else all is well."""
    if task in MISBEHAVIOUR:
        MISBEHAVIOUR[task]()
    return f"{task} done"


def own_pid(_: object) -> int:
    return os.getpid()


def environment(_: object) -> dict[str, str]:
    return dict(os.environ)


def raise_error() -> None:
    raise ZeroDivisionError("not foreseen")


def panic() -> None:
    """Raise the error of an internal fault of Polars; it does not derive from Exception."""
    from polars.exceptions import PanicException

    raise PanicException("not foreseen")


def hang_in_python() -> None:
    sign_of_life("the third night")
    while True:
        time.sleep(0.01)


def hang_at_a_log(asked: bool) -> None:
    """Hangs in the call that opens a log, or while it is read, with no handler of Python called."""
    sign_of_life("a night")
    with reading("a.csv", is_asked=asked):
        hang_in_c()


def hang_in_c() -> None:
    """Holds the interpreter's lock: no signal handler in Python is ever called."""
    ctypes.PyDLL(None).sleep(1000)


def stop() -> None:
    """As a debugger does: nothing but SIGKILL ends a stopped process."""
    sign_of_life("a night")
    os.kill(os.getpid(), signal.SIGSTOP)


def eat(piece: Callable[[], object]) -> None:
    held = []
    while True:
        held.append(piece())


def eat_with_numpy() -> None:
    import numpy as np

    eat(lambda: np.ones(GIB // 16))


def eat_with_polars() -> None:
    import polars as pl

    eat(lambda: pl.select(pl.int_range(GIB // 16, dtype=pl.Int64)))


def eat_at_once() -> None:
    """One column of 8 TiB."""
    import polars as pl

    pl.select(pl.int_range(1 << 40, dtype=pl.Int64))


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


MISBEHAVIOUR: dict[str, Callable[[], None]] = {
    "segfault": lambda: ctypes.string_at(8),
    **{
        misbehaviour.__name__: misbehaviour
        for misbehaviour in (
            *(raise_error, panic, hang_in_python, hang_in_c, stop, kill),
            *(eat_with_numpy, eat_with_polars, eat_at_once),
        )
    },
}


@dataclass(frozen=True, slots=True)
class Misbehaving:
    """In place of a run's stage for a motor: the stage, in which that motor misbehaves.

    Here and not in a test's module, so that workers load no more than a run does.
    """

    motor_id: str
    what: str
    night: str = ""

    def fit(self, task: Any) -> Any:
        """Fit a motor's nights; one of them does what is said."""
        import pipeline.run.motor_task as module

        fit_night = module.fit_night

        def fit_or_misbehave(spec: Any, here: Any, channels: Any) -> Any:
            if (str(here.date), spec.motor_id) == (self.night, self.motor_id):
                MISBEHAVIOUR[self.what]()
            return fit_night(spec, here, channels)

        module.fit_night = fit_or_misbehave
        return module.run_motor(task)

    def watch(self, task: Any) -> Any:
        """Make trends; those of the motor do what is said."""
        from pipeline.run.publishing import run_trends
        from pipeline.trends.course import Course

        step = Course.step

        def step_or_misbehave(course: Course) -> None:
            if course.spec.motor_id == self.motor_id:
                MISBEHAVIOUR[self.what]()
            step(course)

        Course.step = step_or_misbehave  # type: ignore[method-assign]
        return run_trends(task)


def fit_with_pipes_as_files(task: Any) -> Any:
    """Fit a motor to which a pipe looks like a file, as one on a mount that hangs does."""
    import pipeline.logs.files
    from pipeline.run.motor_task import run_motor

    pipeline.logs.files.stat.S_ISREG = lambda _: True  # type: ignore[attr-defined]
    return run_motor(task)


def slow_by(what: str) -> str:
    """Takes a second for each of three items, or parts."""
    for number in range(3):
        still_alive() if what == "items" else sign_of_life(f"part {number}")
        time.sleep(1.0)
    return what


def die_once(marker: str) -> str:
    """Dies unless it has done so before."""
    if not Path(marker).exists():
        Path(marker).touch()
        kill()
    return "done"


def workers_of(parent: int) -> int:
    """Number of workers of a process that are at work: those that have something loaded."""
    import psutil

    processes = psutil.process_iter(["ppid", "cmdline"])
    mine = (
        process.info["cmdline"] or () for process in processes if process.info["ppid"] == parent
    )
    return sum("popen_loky_posix" in " ".join(command) for command in mine)


def count_beside_or_die(marker: str) -> int:
    """Dies; the second time it counts the tasks beside it."""
    die_once(marker)
    at_work = Path(f"{marker}-at-work")
    at_work.touch()
    time.sleep(0.3)
    found = len(list(at_work.parent.glob("*-at-work"))) - 1
    at_work.unlink()
    return found


def pid_and_wait(folder: str) -> None:
    """Says which process it is, and hangs."""
    (Path(folder) / str(os.getpid())).touch()
    hang_in_c()


def wait_until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it has not come to that"
        time.sleep(0.02)


# Tasks of a Dask cluster, which workers import by name


@dataclass(frozen=True, slots=True)
class Number:
    """A number to be squared; the square is staged, too."""

    value: int
    staging: Path


def square(task: Number) -> int:
    (task.staging / "squares").mkdir(exist_ok=True)
    (task.staging / "squares" / f"{task.value}.txt").write_text(str(task.value**2), "utf-8")
    return task.value**2


def kill_workers_at_three(number: int) -> int:
    """A task that takes every Dask worker with it that tries it."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


@dataclass(frozen=True, slots=True)
class Wait:
    """A task that says that it runs, and waits for a word to go on."""

    number: int
    folder: Path


def wait_for_word(task: Wait) -> int:
    (task.folder / f"started-{task.number}").touch()
    if task.number:
        wait_until((task.folder / "go").exists)
    return task.number

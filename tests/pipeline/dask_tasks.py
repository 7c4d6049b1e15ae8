"""Tasks for the tests of Dask clusters, which workers import by name."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

from tests.pipeline.misbehaviour import wait_until


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

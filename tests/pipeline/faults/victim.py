"""A process that does some work on a fleet and is killed on the way: by its own hand, with SIGKILL.

It imports everything once and does each work in a copy of itself, so that a death costs little.
Requests come as lines of JSON on stdin; for each the copy's exit code, or the number of points at
which it may die, is written to stdout.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pipeline.run.fleet
from pipeline.run.mending import repair
from pipeline.store.state import make_ready, open_state
from tests.pipeline.faults.disk import Disk, on
from tests.pipeline.faults.fleet import TinyFleet


def run(folder: Path, output: Path) -> None:
    """A run, one task at a time."""
    TinyFleet(folder).run(output)


def mend(_: Path, output: Path) -> None:
    """What `check --repair` does."""
    make_ready(output)
    with open_state(output) as state:
        repair(state)


WORK: dict[str, Callable[[Path, Path], None]] = {"run": run, "repair": mend}


def die() -> None:
    """As the system kills a process for want of memory, or an impatient person."""
    os.kill(os.getpid(), signal.SIGKILL)
    signal.pause()


def count(work: str, folder: Path, before: Path, output: Path) -> int:
    """Points at which a work that is done to its end may die."""
    shutil.copytree(before, output)
    with on(Disk("killed", 0)) as disk:
        WORK[work](folder, output)
    shutil.rmtree(output)
    return disk.seen


def obey(asked: dict[str, str]) -> None:
    """Do a work, or count its points: they are written to stdout."""
    work, folder, output = asked["work"], Path(asked["folder"]), Path(asked["output"])
    if "before" in asked:
        sys.stdout.write(f"{count(work, folder, Path(asked['before']), output)}\n")
        sys.stdout.flush()
    else:
        with on(Disk("killed", int(asked["point"]), die=die)):
            WORK[work](folder, output)


def main() -> None:
    """Do what the lines of stdin ask for."""
    for line in sys.stdin:
        asked = json.loads(line)
        child = os.fork()
        if child == 0:
            try:
                obey(asked)
            finally:
                os._exit(0)
        ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if "before" not in asked:
            sys.stdout.write(f"{ended}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    assert pipeline.run.fleet
    main()

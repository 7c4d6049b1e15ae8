"""A process that runs the tiny fleet and is killed on the way: by its own hand, with SIGKILL.

It imports everything once and then does each run in a copy of itself, so that a death costs little.
Requests come as lines of JSON on stdin; for each the copy's exit code is written to stdout.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pipeline.run.fleet
from tests.pipeline.faults.disk import Disk, on
from tests.pipeline.faults.fleet import TinyFleet

# Where a run is when it enters a stage.
STAGES = {
    "planning": "pipeline.run.motor_nights.LogShelf",
    "reading": "pipeline.logs.motor_logs.read_log",
    "fitting": "pipeline.run.motor_task.fit_night",
    "staging": "pipeline.run.motor_task.stage",
    "publishing": "pipeline.store.publishing.prepare_file",
    "announcing": "pipeline.store.publishing.announce",
    "landing": "pipeline.store.atomic_files.Prepared.land",
    "recording": "pipeline.store.publishing.update_manifest",
    "remembering": "pipeline.run.publishing.write_change",
    "trends": "pipeline.trends.stage.read_nights",
    "staging trends": "pipeline.trends.stage.stage",
    "publishing the run": "pipeline.store.publishing.Publisher.add",
}
# Those of a run whose fleet tells somebody of its alarms.
OF_TELLING = {
    "opening the outbox": "pipeline.run.fleet.open_outbox",
    "taking up": "pipeline.run.telling.take_up",
    "telling": "pipeline.run.telling.deliver",
    "told": "pipeline.telling.delivering.was_taken",
}
# Those that a worker goes through.
OF_MOTORS = ("planning", "reading", "fitting", "staging")
OF_TRENDS = ("trends", "staging trends")


def die() -> None:
    """As the system kills a process for want of memory, or an impatient person."""
    os.kill(os.getpid(), signal.SIGKILL)
    signal.pause()


def at_entry(stage: str, number: int, then: Callable[[], None]) -> pytest.MonkeyPatch:
    """Do something when a stage is entered for the Nth time."""
    owner, _, name = (STAGES | OF_TELLING)[stage].rpartition(".")
    try:
        holder: Any = importlib.import_module(owner)
    except ModuleNotFoundError:
        module, _, kind = owner.rpartition(".")
        holder = getattr(importlib.import_module(module), kind)
    real = getattr(holder, name)
    calls = 0

    def entered(*arguments: Any, **settings: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == number:
            then()
        return real(*arguments, **settings)

    patched = pytest.MonkeyPatch()
    patched.setattr(holder, name, entered)
    return patched


def run(folder: str, output: str, stage: str, number: int) -> None:
    """Run the fleet until the call of the disk, or the entry into the stage, that is its last."""
    fleet = TinyFleet(Path(folder))
    if stage == "call":
        with on(Disk("killed", number, die=die)):
            fleet.run(Path(output))
    else:
        at_entry(stage, number, die)
        fleet.run(Path(output))


def main() -> None:
    """Do what the lines of stdin ask for."""
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            try:
                run(**json.loads(line))
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    assert pipeline.run.fleet
    main()

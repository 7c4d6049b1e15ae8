"""SIGKILL of the process and of its workers, anywhere: the next run repairs all."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pipeline.run.fleet
import pipeline.run.motors
import pipeline.run.publishing
from pipeline.run.fleet import run_fleet
from pipeline.run.motor_task import run_motor
from pipeline.run.publishing import run_trends
from pipeline.run.tasks import MotorTask
from tests.pipeline.faults.fleet import (
    ENVIRONMENT,
    MOTORS,
    TinyFleet,
    check_old_or_new,
    check_repaired,
    remembered_fits,
)
from tests.pipeline.faults.sweep import count_points
from tests.pipeline.faults.victim import OF_MOTORS, OF_TRENDS, STAGES, at_entry, die

Kill = Callable[[Path, str, int], None]
Run = Callable[[Any], Any]


@pytest.fixture(scope="module")
def kill(tiny_fleet: TinyFleet) -> Iterator[Kill]:
    """Kills a run of the tiny fleet."""
    with killer() as kill_run:
        yield lambda output, stage, number: kill_run(tiny_fleet.folder, output, stage, number)


@contextmanager
def killer() -> Iterator[Callable[[Path, Path, str, int], None]]:
    """Kills a run of the fleet in a folder at the Nth call of the disk, or entry into a stage."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.pipeline.faults.victim"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )

    def ask(folder: Path, output: Path, stage: str, number: int) -> None:
        request = {"folder": str(folder), "output": str(output), "stage": stage, "number": number}
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        assert process.stdout.readline() == f"{-signal.SIGKILL}\n", (stage, number)

    yield ask
    process.stdin.close()
    assert process.wait(60) == 0
    process.stdout.close()


def kill_and_repair(fleet: TinyFleet, output: Path, kill: Kill, stage: str, number: int) -> None:
    fleet.copy(output)
    kill(output, stage, number)
    check_old_or_new(output, fleet)
    with remembered_fits():
        # Nobody holds the lock any more.
        fleet.run(output)
    check_repaired(output, fleet)


SOME = (("fitting", 1), ("landing", 2), ("remembering", 1), ("trends", 1))
ENTERED_ONCE = (("trends", 2), ("publishing the run", 2))


@pytest.mark.parametrize(
    ("stage", "number"),
    [
        pytest.param(*one, marks=() if one in SOME else pytest.mark.full)
        for one in product(STAGES, (1, 2))
        if one not in ENTERED_ONCE
    ],
)
def test_killed_in_a_stage(
    tiny_fleet: TinyFleet, tmp_path: Path, kill: Kill, stage: str, number: int
) -> None:
    kill_and_repair(tiny_fleet, tmp_path / "out", kill, stage, number)


def test_killed_at_a_call(tiny_fleet: TinyFleet, tmp_path: Path, kill: Kill) -> None:
    output = tmp_path / "out"
    n = count_points(tiny_fleet, "killed")
    for point in np.random.default_rng(3).choice(n, 2, replace=False):
        kill_and_repair(tiny_fleet, output, kill, "call", int(point) + 1)


@pytest.mark.full
@pytest.mark.parametrize("part", range(4))
def test_killed_at_many_calls(tiny_fleet: TinyFleet, tmp_path: Path, kill: Kill, part: int) -> None:
    """The process itself; that each call can be the last is shown without it, too."""
    output = tmp_path / "out"
    points = range(1 + part, count_points(tiny_fleet, "killed") + 1, 40)
    for point in points:
        kill_and_repair(tiny_fleet, output, kill, "call", point)
    sys.stdout.write(f"SIGKILL, {part + 1} of 4: {len(points)} points tried and survived\n")


# Workers. What is to be done reaches them with the task. (In the tests of every change, workers are
# killed in `tests/pipeline/run/test_fleet.py`: starting some takes longer than all of the above.)


def killing(run: Run, stage: str, motor: str, marker: Path | None) -> Run:
    """A motor's task, of its nights or its trends, that dies in a stage; once, if with a marker."""

    def run_or_die(task: Any) -> Any:
        spec = task.spec if isinstance(task, MotorTask) else task.specs[0]
        if spec.motor_id != motor or (marker and marker.exists()):
            return run(task)

        def then() -> None:
            if marker:
                marker.touch()
            die()

        patched = at_entry(stage, 1, then)
        try:
            return run(task)
        finally:
            patched.undo()

    return run_or_die


def check_worker(
    fleet: TinyFleet, tmp_path: Path, patched: pytest.MonkeyPatch, stage: str, always: bool
) -> None:
    """A worker dies once and nothing is lost; or whenever it does a motor, and that alone fails."""
    output, motor = fleet.copy(tmp_path / "out"), MOTORS[1]
    marker = None if always else tmp_path / "died"
    if stage in OF_MOTORS:
        patched.setattr(pipeline.run.motors, "run_motor", killing(run_motor, stage, motor, marker))
    else:
        patched.setattr(
            pipeline.run.publishing, "run_trends", killing(run_trends, stage, motor, marker)
        )
        # A task a motor: one alone would be done in this very process.
        patched.setattr(pipeline.run.publishing, "MOTORS_A_TREND_TASK", 1)
    result = fleet.run(output, workers=2, backend="loky")
    patched.undo()
    failed = [outcome.motor_id for outcome in result.failed]
    assert failed == ([motor] if always else [])
    assert always or (marker is not None and marker.exists())
    check_old_or_new(output, fleet, failed)
    if always:
        with remembered_fits():
            run_fleet(replace(fleet.request(output), retry=True))
    check_repaired(output, fleet)


@pytest.mark.full
@pytest.mark.parametrize("always", [False, True], ids=["once", "always"])
@pytest.mark.parametrize("stage", [*OF_MOTORS, *OF_TRENDS])
def test_a_worker_killed_in_every_stage(
    tiny_fleet: TinyFleet,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stage: str,
    always: bool,
) -> None:
    check_worker(tiny_fleet, tmp_path, monkeypatch, stage, always)

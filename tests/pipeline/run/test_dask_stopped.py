"""A run over Dask that is stopped or killed: its tasks are taken back, and the next run repairs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.config import Execution, load_fleet
from pipeline.run.fleet import RunRequest, run_fleet
from tests.pipeline.dask_processes import ROOT, Processes, wait_until
from tests.pipeline.mini_fleet import mini_fleet
from tests.pipeline.run.demo_runs import check_same_tables, output_of, table_files

# The command, in which every motor but the first waits for a word.
WAITING = """
import sys, time
from pathlib import Path
import pipeline.run.fleet
import pipeline.run.motors
from pipeline.cli import main

folder = Path(sys.argv.pop())


def wait(task):
    from pipeline.run.motor_task import run_motor

    if task.spec.motor_id != "M1":
        (folder / task.spec.motor_id).touch()
        while not (folder / "go").exists():
            time.sleep(0.02)
    return run_motor(task)


pipeline.run.motors.run_motor = wait
main()
"""


@contextmanager
def begun(fleet: Path, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A run that has finished one motor, and waits in another."""
    process = subprocess.Popen(
        [sys.executable, "-c", WAITING, "fit-fleet", str(fleet), str(folder)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stdout is not None
        assert any(line.startswith("M1: ok") for line in process.stdout)
        wait_until(lambda: any(path.name.startswith("M") for path in folder.iterdir()))
        yield process
    finally:
        (folder / "go").touch()
        process.kill()
        process.communicate()


def plain_run(fleet_file: Path, output: Path) -> tuple[int, int]:
    """A run without Dask: nights that it made, and motors that failed."""
    fleet = load_fleet(fleet_file)
    how = Execution(backend="sequential")
    result = run_fleet(RunRequest(replace(fleet, execution=how, output=output)))
    return result.n_nights, len(result.failed)


@pytest.mark.full
def test_ctrl_c_publishes_what_is_finished(two_workers: Processes, tmp_path: Path) -> None:
    how = f'backend = "dask"\nscheduler = "{two_workers.address}"\n'
    fleet = mini_fleet(tmp_path, 2, 1, execution=how)
    folder = tmp_path / "waits"
    folder.mkdir()
    with begun(fleet, folder) as process:
        # As a terminal does: to every process of the run.
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
        assert process.returncode == 130
    assert "interrupted; 1 night of 1 motor " in out
    assert "Traceback" not in err
    assert plain_run(fleet, output_of(fleet)) == (1, 0)
    plain_run(fleet, tmp_path / "plain")
    check_same_tables(output_of(fleet), tmp_path / "plain", "M1", "M2")


@pytest.mark.full
def test_a_killed_run_is_repaired_by_a_plain_one(two_workers: Processes, tmp_path: Path) -> None:
    how = f'backend = "dask"\nscheduler = "{two_workers.address}"\n'
    fleet = mini_fleet(tmp_path, 3, 1, execution=how)
    folder = tmp_path / "waits"
    folder.mkdir()
    with begun(fleet, folder) as process:
        os.kill(process.pid, signal.SIGKILL)
        process.wait(timeout=60)
        assert list((output_of(fleet) / "staging").iterdir())
        # Workers are still at their tasks: what they make goes nowhere.
        assert plain_run(fleet, output_of(fleet)) == (3, 0)
    plain_run(fleet, tmp_path / "plain")
    assert table_files(output_of(fleet)) == table_files(tmp_path / "plain")
    assert not (output_of(fleet) / "staging").exists()

"""Runs that are interrupted, and workers, outputs and nights that are lost."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from polars.testing import assert_frame_equal

from pipeline.errors import LockedError, StoreError
from pipeline.run.fleet import staging_folder
from tests.conftest import OwnFleet
from tests.pipeline.run.demo_runs import (
    CSV,
    NIGHTS,
    PARQUET,
    check_same_tables,
    log_file,
    nights_of,
    output_of,
    rows,
    run,
)
from tests.pipeline.workshop import Workshop

# Room on the disk


@pytest.mark.parametrize(("minimum_mib", "is_refused"), [(100, True), (99, False), (0, False)])
def test_a_run_with_too_little_room_touches_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, minimum_mib: int, is_refused: bool
) -> None:
    shop = Workshop.at(tmp_path)
    shop.log(NIGHTS[0])
    fleet = shop.fleet
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=(100 << 20) - 1))
    if not is_refused:
        assert run(fleet, minimum_free_mib=minimum_mib).n_nights == 1
        return
    with pytest.raises(StoreError, match=r"minimum_free_mib is 100") as caught:
        run(fleet, minimum_free_mib=minimum_mib)
    assert caught.value.code == "disk_space"
    assert not output_of(fleet).exists()


# A worker that dies


# The lock, and outputs that cannot be written


@pytest.mark.parametrize("place", ["out", "out/tables", "out/staging", "out/lock", "out/state.db"])
def test_an_output_that_cannot_be_written(own_fleet: OwnFleet, place: str) -> None:
    fleet = own_fleet(PARQUET)
    blocked = fleet.parent.parent / place
    blocked.parent.mkdir(exist_ok=True)
    if place in ("out/lock", "out/state.db"):
        blocked.mkdir()
    else:
        blocked.write_text("in the way")
    with pytest.raises(StoreError) as caught:
        run(fleet)
    assert caught.value.code == "store_write"
    assert blocked.exists()
    # Once it is out of the way all is done.
    blocked.rmdir() if blocked.is_dir() else blocked.unlink()
    assert run(fleet).n_nights == 3


def test_nobody_else_may_enter_the_folder_of_staged_rows(tmp_path: Path) -> None:
    """What lies there is published."""
    before = os.umask(0)
    try:
        with staging_folder(tmp_path / "out") as folder:
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    finally:
        os.umask(before)


WAITING = """
import signal, sys
import pipeline.run.fleet
import pipeline.run.motors
from pipeline.cli import main
from pipeline.run.motor_task import run_motor

waits = sys.argv.pop()

def run_or_wait(task):
    while task.spec.motor_id == waits:
        signal.pause()
    return run_motor(task)

pipeline.run.motors.run_motor = run_or_wait
main()
"""


@pytest.fixture
def waiting_run(
    own_fleet: OwnFleet,
) -> Iterator[Callable[[int], tuple[Path, subprocess.Popen[str]]]]:
    """Starts a run that has done one motor and waits in another."""
    processes = []

    def start(jobs: int) -> tuple[Path, subprocess.Popen[str]]:
        fleet = own_fleet(CSV, PARQUET)
        process = subprocess.Popen(
            [sys.executable, "-c", WAITING, "fit-fleet", str(fleet), f"--jobs={jobs}", PARQUET],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        processes.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == f"{CSV}: ok (3 ok)\n"
        return fleet, process

    yield start
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


# Signals. The run is a process of its own; one of its motors waits for ever.


@pytest.mark.parametrize(
    ("jobs", "number", "to_all", "code"),
    [
        pytest.param(1, signal.SIGINT, False, 130, marks=pytest.mark.full),
        (2, signal.SIGINT, True, 130),
        (2, signal.SIGTERM, False, 143),
    ],
)
def test_a_signal_keeps_what_is_done(
    waiting_run: Callable[[int], tuple[Path, subprocess.Popen[str]]],
    fitted_output: Path,
    jobs: int,
    number: signal.Signals,
    to_all: bool,
    code: int,
) -> None:
    fleet, process = waiting_run(jobs)
    # A second run is turned away at once, and told by whom.
    with pytest.raises(LockedError, match=rf"process {process.pid} on \S+ since"):
        run(fleet)
    (os.killpg if to_all else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert out.startswith("interrupted; 3 nights of 1 motor ")
    assert "Traceback" not in err
    # What its tasks made; `nights` comes with the trends, of the next run.
    assert_frame_equal(*(rows(one, "fits", CSV) for one in (output_of(fleet), fitted_output)))
    for table, motor in (("fits", PARQUET), ("nights", CSV)):
        assert rows(output_of(fleet), table, motor).is_empty()
    assert rows(output_of(fleet), "runs")["status"].to_list() == ["interrupted"]
    assert nights_of(run(fleet)) == {CSV: [], PARQUET: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET)


def test_a_fleet_whose_logs_are_gone_says_so(
    own_fleet: OwnFleet, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    run(fleet)
    assert "is the folder mounted" not in caplog.text
    shutil.rmtree(log_file(fleet, PARQUET, NIGHTS[1]).parent)
    assert run(fleet).n_nights == 0
    assert "no log of any motor is below" in caplog.text


def test_rows_that_cannot_be_staged_are_told_as_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refused(*_: object) -> None:
        raise StoreError("store_write", "File too large")

    shop = Workshop.at(tmp_path)
    shop.log(NIGHTS[0])
    fleet = shop.fleet
    monkeypatch.setattr("pipeline.run.motor_task.stage", refused)
    (lost,) = run(fleet).failed
    assert (lost.error_code, lost.message) == ("store_write", "File too large")
    assert "no log of any motor" not in caplog.text
    monkeypatch.undo()
    assert run(fleet).n_nights == 1

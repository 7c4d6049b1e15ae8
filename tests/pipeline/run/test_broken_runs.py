"""Runs that are interrupted, and workers, outputs and nights that are lost."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import pipeline.run.fleet
import pipeline.run.motors
import pipeline.store.publishing
from pipeline.config import load_fleet
from pipeline.errors import LockedError, StoreError
from pipeline.logs.ledger import Ledger
from pipeline.run.fleet import RunRequest, run_fleet, staging_folder
from pipeline.run.motor_task import run_motor
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.schema import FITS
from pipeline.store.night_files import NewFile, prepare_file
from pipeline.store.tables import night_file, read_table
from tests.conftest import OwnFleet
from tests.pipeline.faults.damage import rot
from tests.pipeline.mini_fleet import mini_fleet
from tests.pipeline.misbehaviour import MISBEHAVIOUR
from tests.pipeline.remembered import ledger_of
from tests.pipeline.run.demo_runs import (
    CSV,
    FIRST,
    MCAP,
    NIGHTS,
    PARQUET,
    check_same_tables,
    log_file,
    nights_of,
    output_of,
    rows,
    run,
    status_of,
    table_files,
)
from tests.pipeline.telling.fleet import keep, told

# A worker that dies


def test_a_worker_that_dies_costs_its_motor_alone_and_nothing_if_it_dies_once(
    own_fleet: OwnFleet, fitted_output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet, died = own_fleet(CSV, PARQUET, MCAP), tmp_path / "died"

    def run_or_die(task: MotorTask) -> MotorOutcome:
        if task.spec.motor_id == CSV:
            MISBEHAVIOUR["segfault"]()
        if task.spec.motor_id == PARQUET and not died.exists():
            died.touch()
            MISBEHAVIOUR["kill"]()
        return run_motor(task)

    monkeypatch.setattr(pipeline.run.motors, "run_motor", run_or_die)
    result = run(fleet, backend="loky")
    assert died.exists()
    assert status_of(result) == {CSV: "failed", PARQUET: "ok", MCAP: "ok"}
    (lost,) = result.failed
    assert lost.error_code == "worker_died"
    assert ledger_of(output_of(fleet), CSV) == Ledger()
    check_same_tables(output_of(fleet), fitted_output, PARQUET, MCAP)
    assert rows(output_of(fleet), "fits", CSV).is_empty()
    (last,) = rows(output_of(fleet), "motor_outcomes", CSV).to_dicts()
    assert (last["status"], last["error_code"]) == ("failed", "worker_died")
    assert "SIGSEGV, in string_at" in last["message"]
    # The next run has it all to do.
    monkeypatch.undo()
    assert nights_of(run(fleet, CSV)) == {CSV: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET, MCAP)


def test_a_back_fill_whose_worker_dies_ends_as_one_in_which_none_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its tables, alarms and notifications: a motor that is done last is not silent meanwhile."""

    def run_or_die(task: MotorTask) -> MotorOutcome:
        if task.spec.motor_id == "M1" and not (task.output / "died").exists():
            (task.output / "died").touch()
            MISBEHAVIOUR["kill"]()
        return run_motor(task)

    found = {}
    for name in ("died", "whole"):
        settings = f'backend = "loky"\n[alarms]\n{keep(tmp_path / name / "told")}\n'
        fleet = mini_fleet(tmp_path / name, 2, 12, settings)
        # The night that came before: a motor with no more nights than that is `stale`.
        run(fleet, until=FIRST)
        if name == "died":
            monkeypatch.setattr(pipeline.run.motors, "run_motor", run_or_die)
        result = run_fleet(RunRequest(load_fleet(fleet)))
        monkeypatch.undo()
        assert (result.n_nights, result.failed) == (22, ())
        assert "stale" not in rows(output_of(fleet), "watch")["state"].to_list()
        found[name] = table_files(output_of(fleet)), told(tmp_path / name)
    assert (output_of(tmp_path / "died" / "configs" / "fleet.toml") / "died").exists()
    assert found["died"] == found["whole"]


def test_a_fault_of_ours_costs_its_motor_alone(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> object:
        raise ZeroDivisionError("not foreseen")

    fleet = own_fleet(CSV, PARQUET)
    monkeypatch.setattr("pipeline.logs.locations.find_logs", broken)
    result = run(fleet)
    assert status_of(result) == {CSV: "failed", PARQUET: "failed"}
    assert {outcome.error_code for outcome in result.outcomes} == {"internal"}
    assert "ZeroDivisionError: not foreseen" in (result.outcomes[0].message or "")


# The lock, and outputs that cannot be written


def test_two_runs_never_write_at_once(own_fleet: OwnFleet) -> None:
    fleet = own_fleet(PARQUET)
    seen: list[str] = []

    def second(_: MotorOutcome) -> None:
        with pytest.raises(LockedError) as caught:
            run(fleet)
        seen.append(str(caught.value))

    sequential = load_fleet(fleet).execution.model_copy(update={"backend": "sequential"})
    run_fleet(RunRequest(replace(load_fleet(fleet), execution=sequential)), second)
    (message,) = seen
    assert f"process {os.getpid()} on {socket.gethostname()} since 20" in message
    # It is free again, and the first run's tables are whole.
    assert run(fleet).n_nights == 0
    assert rows(output_of(fleet), "fits").height == 3


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
    check_same_tables(output_of(fleet), fitted_output, CSV)
    assert rows(output_of(fleet), "fits", PARQUET).is_empty()
    assert rows(output_of(fleet), "runs")["status"].to_list() == ["interrupted"]
    assert nights_of(run(fleet)) == {CSV: [], PARQUET: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET)


def test_a_killed_run_leaves_nothing_that_the_next_cannot_mend(
    waiting_run: Callable[[int], tuple[Path, subprocess.Popen[str]]], fitted_output: Path
) -> None:
    fleet, process = waiting_run(1)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    (output_of(fleet) / "tables" / "fits" / "month=2026-01").mkdir(parents=True)
    leftover = output_of(fleet) / "tables" / "fits" / "month=2026-01" / ".writing-abc"
    leftover.write_bytes(b"half a table")
    assert nights_of(run(fleet)) == {CSV: NIGHTS, PARQUET: NIGHTS}
    assert not leftover.exists()
    assert not (output_of(fleet) / "staging").exists()
    check_same_tables(output_of(fleet), fitted_output, CSV, PARQUET)


@pytest.mark.parametrize(
    "after", [4, 15, *(pytest.param(one, marks=pytest.mark.full) for one in (1, 9))]
)
def test_an_interrupt_while_publishing_is_mended_by_the_next_run(
    own_fleet: OwnFleet, fitted_output: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    fleet = own_fleet(PARQUET)
    calls = 0

    def interrupted(*arguments: Any) -> NewFile:
        nonlocal calls
        calls += 1
        if calls > after:
            raise KeyboardInterrupt
        return prepare_file(*arguments)

    monkeypatch.setattr(pipeline.store.publishing, "prepare_file", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(fleet)
    monkeypatch.undo()
    assert nights_of(run(fleet)) == {PARQUET: NIGHTS}
    check_same_tables(output_of(fleet), fitted_output, PARQUET)


def test_a_damaged_night_is_made_anew_for_all_motors_by_the_run_after(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damage that is found only when the night is made, as the file keeps its time stamp."""
    monkeypatch.setattr("pipeline.run.fleet.share_due", lambda *_: set())
    config = own_fleet("CB400-01", "CB400-02", fitted=True)
    fleet, night = load_fleet(config), FIRST
    before = read_table(night_file(fleet.output, FITS, night), FITS).drop("run_id")
    rot(night_file(fleet.output, FITS, night))
    log = min((fleet.log_root / "CB400-01").iterdir())
    log.write_text(log.read_text("utf-8").rsplit("\n", 2)[0] + "\n", "utf-8")
    run(config)
    alone = read_table(night_file(fleet.output, FITS, night), FITS)
    assert alone["motor_id"].unique().to_list() == ["CB400-01"]
    run(config)
    after = read_table(night_file(fleet.output, FITS, night), FITS).drop("run_id")
    assert after["motor_id"].to_list() == ["CB400-01", "CB400-02"] * 3
    other = pl.col("motor_id") == "CB400-02"
    assert after.filter(other).equals(before.filter(other))


def test_a_fleet_whose_logs_are_gone_says_so(
    own_fleet: OwnFleet, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = own_fleet(PARQUET, fitted=True)
    run(fleet)
    assert "is the folder mounted" not in caplog.text
    shutil.rmtree(log_file(fleet, PARQUET, NIGHTS[1]).parent)
    assert run(fleet).n_nights == 0
    assert "no log of any motor is below" in caplog.text

"""A fleet's run over a Dask cluster: the tables of a run on one machine, byte for byte."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.cli import main
from pipeline.config import load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from tests.conftest import OwnFleet
from tests.pipeline.dask_processes import Processes
from tests.pipeline.run.demo_runs import (
    MOTORS,
    output_of,
    status_of,
    table_files,
)


def run(fleet_file: Path, output: Path, execution: Any, progress: Any = None) -> RunResult:
    fleet = replace(load_fleet(fleet_file), output=output, execution=execution)
    return run_fleet(RunRequest(fleet), progress or (lambda _: None))


@pytest.mark.full
def test_a_cluster_that_loses_a_worker_writes_the_same_bytes(
    two_workers: Processes, demo_folder: Path, fitted_output: Path, tmp_path: Path
) -> None:
    from distributed import Client

    killed: list[int] = []

    def kill_one(_: object) -> None:
        if not killed:
            with Client(two_workers.address, set_as_default=False) as client:
                killed.append(min(client.run(os.getpid).values()))
            os.kill(killed[0], signal.SIGKILL)

    fleet = demo_folder / "configs" / "fleet.toml"
    result = run(fleet, tmp_path, two_workers.execution(), kill_one)
    assert killed
    assert status_of(result) == dict.fromkeys(MOTORS, "ok")
    assert table_files(tmp_path) == table_files(fitted_output)
    assert not (tmp_path / "staging").exists()
    # And nothing is new for the next run, wherever that is done.
    again = run(fleet, tmp_path, two_workers.execution())
    assert again.n_nights == 0
    assert table_files(tmp_path) == table_files(fitted_output)


def test_the_command_ends_with_4_without_a_scheduler(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fleet = own_fleet("CB400-02")
    text = fleet.read_text("utf-8").replace(
        "[execution]",
        '[execution]\nbackend = "dask"\nscheduler = "tcp://127.0.0.1:1"',
    )
    fleet.write_text(text, "utf-8")
    monkeypatch.setattr("pipeline.workers.cluster.WAIT_S", 0.5)
    monkeypatch.setattr(sys, "argv", ["motor-leakage", "fit-fleet", str(fleet)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 4
    err = capfd.readouterr().err
    assert (
        "scheduler_unreachable: no Dask scheduler with a worker answers at tcp://127.0.0.1:1" in err
    )
    assert "Traceback" not in err
    assert not list(output_of(fleet).rglob("*.parquet"))

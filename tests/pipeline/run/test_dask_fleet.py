"""A fleet's run over a Dask cluster: the tables of a run on one machine, byte for byte."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.cli import main
from pipeline.config import load_fleet
from pipeline.errors import EngineError
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.run.publishing import run_trends
from pipeline.store.object_store import ObjectStore
from pipeline.workers.engine import Workers
from pipeline.workers.process import Done
from tests.conftest import OwnFleet
from tests.pipeline.dask_processes import Processes, scheduler_with
from tests.pipeline.dask_tasks import kill_worker_of_parquet
from tests.pipeline.mini_fleet import mini_fleet
from tests.pipeline.run.demo_runs import (
    MOTORS,
    check_same_tables,
    output_of,
    rows,
    status_of,
    table_files,
)
from tests.pipeline.s3_server import s3_server


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


@pytest.mark.full
def test_a_motor_that_kills_every_worker_fails_alone(
    two_workers: Processes,
    own_fleet: OwnFleet,
    fitted_output: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = own_fleet("CB400-01", "CB400-02")
    monkeypatch.setattr("pipeline.run.motors.run_motor", kill_worker_of_parquet)
    result = run(fleet, output_of(fleet), two_workers.execution())
    assert status_of(result) == {"CB400-01": "ok", "CB400-02": "failed"}
    (failed,) = result.failed
    assert failed.error_code == "worker_died"
    assert "2 workers died of it" in (failed.message or "")
    check_same_tables(output_of(fleet), fitted_output, "CB400-01")


def test_the_command_ends_with_4_without_a_scheduler(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fleet = own_fleet("CB400-02")
    text = fleet.read_text("utf-8").replace(
        "[execution]",
        '[execution]\nbackend = "dask"\nscheduler = "tcp://127.0.0.1:1"\nscheduler_wait_s = 0.5',
    )
    fleet.write_text(text, "utf-8")
    monkeypatch.setattr(sys, "argv", ["motor-leakage", "fit-fleet", str(fleet)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 4
    err = capfd.readouterr().err
    assert "scheduler_unreachable: no Dask scheduler answers at tcp://127.0.0.1:1" in err
    assert "Traceback" not in err
    assert not list(output_of(fleet).rglob("*.parquet"))


@pytest.mark.full
def test_a_scheduler_lost_before_any_motor_was_done_publishes_nothing(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = own_fleet("CB400-02")
    with scheduler_with(1, "--no-nanny") as processes:
        monkeypatch.setattr("pipeline.run.motors.run_motor", kill_worker_of_parquet)
        with pytest.raises(EngineError) as caught:
            run(fleet, output_of(fleet), processes.execution(scheduler_wait_s=1.0))
    assert caught.value.code == "scheduler_lost"
    assert not list(output_of(fleet).rglob("*.parquet"))


@pytest.mark.full
def test_workers_read_logs_from_a_bucket_and_the_tables_go_into_one(
    own_fleet: OwnFleet, fitted_output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = own_fleet("CB400-01", "CB400-02")
    with s3_server(monkeypatch, "test-dask"), scheduler_with(2) as processes:
        store = ObjectStore.at("s3://test-dask/logs")
        for path in sorted((tmp_path / "demo" / "logs").rglob("*.*")):
            store.create(path.relative_to(tmp_path / "demo" / "logs").as_posix(), path.read_bytes())
        shutil.rmtree(tmp_path / "demo" / "logs")
        text = fleet.read_text("utf-8").replace("../demo/logs", store.url)
        fleet.write_text(
            text.replace("[folders]", '[folders]\nobject_store = "s3://test-dask/fleet"'), "utf-8"
        )
        result = run(fleet, tmp_path / "work", processes.execution())
        assert status_of(result) == {"CB400-01": "ok", "CB400-02": "ok"}
        elsewhere = run(fleet, tmp_path / "elsewhere", processes.execution())
        assert elsewhere.n_nights == 0
    check_same_tables(tmp_path / "work", fitted_output, "CB400-01", "CB400-02")
    assert table_files(tmp_path / "elsewhere") == table_files(tmp_path / "work")


def test_trends_without_an_engine_are_made_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = mini_fleet(tmp_path, 2, 2)

    @contextmanager
    def lost_before_trends(*_: object) -> Iterator[Workers]:
        def tried(function: Any, tasks: Iterable[Any], _: int) -> Iterator[Any]:
            if function is run_trends:
                raise EngineError("scheduler_lost", "the connection to the scheduler is lost")
            return ((task, Done(function(task))) for task in tasks)

        yield Workers(tried, 1)

    with monkeypatch.context() as patched:
        patched.setattr("pipeline.run.fleet.open_workers", lost_before_trends)
        result = run_fleet(RunRequest(load_fleet(fleet)))
    # The nights are published, and it is told why the motors have no trends.
    assert (result.n_nights, result.interrupted) == (4, False)
    told = {(one.error_code, one.message) for one in result.failed}
    assert told == {("scheduler_lost", "trends: the connection to the scheduler is lost")}
    assert len(result.failed) == 2
    assert rows(output_of(fleet), "fits")["status"].to_list() == ["ok"] * 4
    assert not (output_of(fleet) / "tables" / "trends").exists()
    again = run_fleet(RunRequest(load_fleet(fleet)))
    assert (again.n_nights, again.failed) == (0, ())
    run_fleet(RunRequest(replace(load_fleet(fleet), output=tmp_path / "whole")))
    check_same_tables(output_of(fleet), tmp_path / "whole", "M1", "M2")

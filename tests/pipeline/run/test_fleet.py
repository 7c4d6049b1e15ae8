"""A run over the demo fleet: the same bytes however it is spread; outputs it cannot write to."""

from __future__ import annotations

import datetime as dt
import os
import shutil
import signal
import stat
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.intraday.check import MotorCheck
from pipeline.notification.outbox import Backlog
from pipeline.run.fleet import RunRequest, run_fleet, staging_folder
from pipeline.run.notification import (
    HEAD,
    intraday_metrics_file,
    intraday_metrics_text,
    metrics_text,
    write_metrics,
)
from pipeline.schema import LATEST
from pipeline.trends.motor_states import MotorState
from tests.conftest import OwnFleet
from tests.pipeline.calling import CSV, MOTORS, PARQUET, output_of, run, status_of, table_files
from tests.pipeline.dask_processes import Processes


def test_one_after_the_other_and_two_workers_write_the_same_bytes_wherever_they_lie(
    own_fleet: OwnFleet, tmp_path: Path
) -> None:
    fleet = own_fleet(CSV, PARQUET, nights=1)
    result = run(fleet, backend="loky", workers=2)
    assert status_of(result) == {CSV: "ok", PARQUET: "ok"}
    (tmp_path / "moved").mkdir()
    for name in ("configs", "demo"):
        shutil.copytree(tmp_path / name, tmp_path / "moved" / name)
    run(tmp_path / "moved/configs/fleet.toml")
    first = table_files(output_of(fleet))
    assert first == table_files(tmp_path / "moved/out")
    assert len(first) >= 6


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

    fleet = load_fleet(demo_folder / "configs" / "fleet.toml")
    request = RunRequest(replace(fleet, output=tmp_path, execution=two_workers.execution()))
    result = run_fleet(request, kill_one)
    assert killed
    assert status_of(result) == dict.fromkeys(MOTORS, "ok")
    assert table_files(tmp_path) == table_files(fitted_output)
    assert not (tmp_path / "staging").exists()
    # And nothing is new for the next run, wherever that is done.
    assert run_fleet(request).n_nights == 0
    assert table_files(tmp_path) == table_files(fitted_output)


def test_a_run_with_too_little_room_touches_nothing(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = own_fleet(PARQUET, nights=1)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=(100 << 20) - 1))
    with pytest.raises(StoreError, match="100 MiB free, and a run needs 100;") as caught:
        run(fleet)
    assert caught.value.code == "disk_space"
    assert not output_of(fleet).exists()


def test_nobody_else_may_enter_the_folder_of_staged_rows(tmp_path: Path) -> None:
    """What lies there is published."""
    before = os.umask(0)
    try:
        with staging_folder(tmp_path / "out") as folder:
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    finally:
        os.umask(before)


# Metrics: names that must be escaped, what is not known, and a folder that is absent

WHEN = dt.datetime(2026, 3, 2, 6, tzinfo=dt.UTC)
FLEET: Any = SimpleNamespace(name='Mill "A"\\ north')


def test_what_is_of_the_fleet_and_what_is_not_known() -> None:
    none = dict.fromkeys(LATEST.schema)
    risen = {"motor_id": "M1", "state": "alarm", "leakage_change_percent": 21.0}
    young = {"motor_id": "M2", "state": "insufficient"}
    states = [MotorState(none | risen), MotorState(none | young)]
    backlogs = [Backlog("hook", WHEN, 3, WHEN, None)]
    text = metrics_text(FLEET, states, [], {"trends_s": 0.25}, backlogs, WHEN)
    fleet = 'fleet="Mill \\"A\\"\\\\ north"'
    assert f'motor_leakage_undelivered_changes{{{fleet},receiver="hook"}} 3.0\n' in text
    assert f'motor_leakage_stage_duration_seconds{{{fleet},stage="trends"}} 0.25\n' in text
    assert f"last_good_run_timestamp_seconds{{{fleet}}} {WHEN.timestamp()!r}\n" in text
    # What is not known has no sample.
    assert "model_error_percent{" not in text
    assert text.count("leakage_change_percent{") == 1


def test_an_absent_folder_is_not_made(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="is no folder"):
        write_metrics(tmp_path / "absent" / "fleet.prom", HEAD)
    assert list(tmp_path.iterdir()) == []


def test_the_intraday_check_has_a_file_of_its_own() -> None:
    assert intraday_metrics_file(Path("/a/mill.prom")) == Path("/a/mill-intraday.prom")
    risen = MotorCheck("M1", "risen", "+82 %", end_us=round(WHEN.timestamp() * 1e6))
    checks = [risen, MotorCheck("M2", "not_judged", "no new samples")]
    lines = intraday_metrics_text(FLEET, checks).splitlines()
    states = [line for line in lines if "intraday_state{" in line and line.endswith(" 1.0")]
    assert 'motor="M1",state="risen"' in states[0]
    assert 'motor="M2",state="not_judged"' in states[1]
    (judged,) = (line for line in lines if line.startswith("motor_leakage_intraday_judged"))
    assert judged.endswith(f" {WHEN.timestamp()!r}")

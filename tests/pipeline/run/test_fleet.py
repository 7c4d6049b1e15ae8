"""A run over the demo fleet: the same bytes however it is spread; outputs it cannot write to."""

from __future__ import annotations

import os
import shutil
import signal
import stat
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.run.fleet import RunRequest, run_fleet, staging_folder
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
    # The tests of faults take any disk, in the same process.
    monkeypatch.setattr("pipeline.run.fleet.MINIMUM_FREE_MIB", 100)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=(100 << 20) - 1))
    with pytest.raises(StoreError, match="100 MiB free, and a run needs 100;") as caught:
        run(fleet)
    assert caught.value.code == "disk_space"
    assert not output_of(fleet).exists()


@pytest.mark.parametrize("place", ["out", "out/tables", "out/staging", "out/lock", "out/state.db"])
def test_an_output_that_cannot_be_written(own_fleet: OwnFleet, place: str) -> None:
    fleet = own_fleet(PARQUET, nights=1)
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
    assert run(fleet).n_nights == 1


def test_nobody_else_may_enter_the_folder_of_staged_rows(tmp_path: Path) -> None:
    """What lies there is published."""
    before = os.umask(0)
    try:
        with staging_folder(tmp_path / "out") as folder:
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    finally:
        os.umask(before)

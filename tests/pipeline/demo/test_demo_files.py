"""The demo on disk: its formats, and what it refuses to overwrite."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.config import MotorSpec
from pipeline.demo.fleet import DemoNight
from pipeline.demo.recording import record_night
from pipeline.demo.writing import write_demo, write_log
from pipeline.errors import UsageError
from pipeline.ingest import read_log
from tests.pipeline.calling import contents, refused
from tests.pipeline.demo.conftest import MOTORS, PLAN, night_of


@pytest.mark.parametrize("motor_id", MOTORS)
def test_reader_gets_back_what_was_recorded(
    specs: dict[str, MotorSpec], tmp_path: Path, motor_id: str
) -> None:
    night = night_of(specs, motor_id)
    recording, motor = record_night(night), night.spec.file
    path = tmp_path / f"log.{motor.logs.format}"
    write_log(path, recording, motor)
    log = read_log(path, motor.logs, motor.channels)
    assert list(tmp_path.iterdir()) == [path]
    since_measured_us = 1500 if motor.logs.time == "log_time" else 0
    for name, values in recording.values.items():
        there, read = ~np.isnan(values), log.channels[name]
        np.testing.assert_allclose(
            read.value[~read.missing], values[there], atol=6e-4
        )  # MCAP has three decimals
        stamps = recording.time_us + recording.own_delay_us.get(name, 0) + since_measured_us
        np.testing.assert_array_equal(read.time_us[~read.missing], stamps[there])


def small_demo(folder: Path, **arguments: Any) -> None:
    write_demo(folder, **({"nights": 2, "minutes": 10.0, "workers": 1} | arguments))


def test_a_demo_is_replaced_and_other_files_in_it_are_not(tmp_path: Path) -> None:
    small_demo(tmp_path, nights=2)
    (tmp_path / "demo" / "truth.json").unlink()  # as if interrupted
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "demo" / "notes.txt").write_text("mine")
    small_demo(tmp_path, nights=1)
    assert (tmp_path / "demo" / "truth.json").is_file()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "demo" / "notes.txt").read_text() == "mine"
    names = {path.name for path in (tmp_path / "demo" / "logs" / "CB400-01").iterdir()}
    assert names == {"CB400-01_2026-01-02.csv"}


def test_the_fleet_s_own_config_is_used_and_left_alone(tmp_path: Path) -> None:
    small_demo(tmp_path, nights=1)
    motors = tmp_path / "configs" / "motors"
    changed = motors / "CB400-01.toml"
    changed.write_text(changed.read_text().replace('"drain_flow_lpm"', '"case_drain"'))
    before = contents(tmp_path / "configs")
    small_demo(tmp_path, nights=1)
    assert contents(tmp_path / "configs") == before
    (log,) = (tmp_path / "demo" / "logs" / "CB400-01").iterdir()
    assert "case_drain" in log.read_text().splitlines()[0]
    (motors / "CB560-01.toml").unlink()
    with pytest.raises(UsageError, match="no motor CB560-01"):
        small_demo(tmp_path, nights=1)
    assert (tmp_path / "demo" / "truth.json").is_file()


def test_something_else_in_the_folder_or_in_its_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "one" / "demo").mkdir(parents=True)
    (tmp_path / "one" / "demo" / "thesis.txt").write_text("mine")
    (tmp_path / "demo").write_text("mine")
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "demo").symlink_to(tmp_path / "nowhere")
    for folder in (tmp_path / "one", tmp_path / "two", tmp_path):
        with refused("demo_folder", "neither empty nor a demo"):
            small_demo(folder)
        assert not (folder / "configs").exists()
    with pytest.raises(UsageError, match="cannot be written: Not a directory"):
        small_demo(tmp_path / "demo")
    assert contents(tmp_path / "one" / "demo") == {"thesis.txt": b"mine"}
    assert (tmp_path / "demo").read_text() == "mine"


def test_a_long_log_stays_within_its_night(specs: dict[str, MotorSpec]) -> None:
    plan = replace(PLAN, minutes=1440.0, rate_hz=1.0)
    recording = record_night(DemoNight(MOTORS["CB400-01"], specs["CB400-01"], plan, 1))
    end = dt.datetime(2026, 1, 2, 6, tzinfo=dt.UTC)
    span = np.array([recording.time_us.min(), recording.time_us.max()]) / 1e6
    assert span[0] == (end - dt.timedelta(days=1)).timestamp()
    assert span[1] < end.timestamp()

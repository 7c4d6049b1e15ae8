"""The demo's truth, physics, noise and faults; its files, and what it refuses to overwrite."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.config import MotorSpec, load_fleet
from pipeline.demo import shipped_configs
from pipeline.demo.fleet import (
    DEMO_FLEET,
    DemoNight,
    Plan,
    autoregression,
    coefficients_of,
    phi_of,
    record_night,
    reference_leakage,
)
from pipeline.demo.writing import write_demo, write_log
from pipeline.errors import UsageError
from pipeline.ingest import read_log
from tests.pipeline.calling import contents, refused

PLAN = Plan(nights=75, minutes=90.0, rate_hz=5.0, seed=1, first_night=dt.date(2026, 1, 2))
MOTORS = {demo.motor_id: demo for demo in DEMO_FLEET}


@pytest.fixture(scope="module")
def specs() -> dict[str, MotorSpec]:
    fleet = load_fleet(shipped_configs() / "fleet.toml")
    return {spec.motor_id: spec for spec in fleet.motors}


def night_of(specs: dict[str, MotorSpec], motor_id: str, number: int = 1) -> DemoNight:
    return DemoNight(MOTORS[motor_id], specs[motor_id], PLAN, number)


def test_reference_leakage_of_an_unworn_motor_as_built_is_the_published_one(
    specs: dict[str, MotorSpec],
) -> None:
    # model.md, section 3: the whole CB560 at 200 bar, 50 °C, 30 rpm: 1.371423 l/min.
    as_drawn = replace(MOTORS["CB560-01"], gap_factors={})
    nights = [DemoNight(as_drawn, specs["CB560-01"], PLAN, number) for number in range(1, 31)]
    mean = np.mean([reference_leakage(night, coefficients_of(night)) for night in nights])
    assert mean == pytest.approx(1.371423, rel=2e-3)


def test_every_kind_of_fault_is_there(specs: dict[str, MotorSpec]) -> None:
    recordings = [record_night(night_of(specs, "CB400-02", number)) for number in range(1, 7)]
    flow = np.concatenate([recording.values["leakage_flow"] for recording in recordings])
    speed = np.concatenate([recording.values["speed"] for recording in recordings])
    steps = np.concatenate([np.diff(recording.time_us) for recording in recordings])
    assert np.sum(flow == 16.0) > 50  # back-flow, for seconds
    assert np.isinf(flow).any()
    assert np.isnan(flow).any()
    assert (flow == -1.0).any()
    assert (speed == 9999.0).any()
    assert (steps == 0).any()
    assert (steps < 0).any()
    assert (steps > 20_000_000).any()
    assert np.mean(np.isfinite(flow) & (np.abs(speed) > 0.5)) > 0.8


def test_a_sensor_freezes_on_one_night_alone(specs: dict[str, MotorSpec]) -> None:
    def longest_standstill(number: int) -> int:
        flow = record_night(night_of(specs, "CB400-01", number)).values["leakage_flow"]
        changes = np.flatnonzero((np.diff(flow) != 0.0) & (flow[:-1] > 0.3))
        return int(np.diff(changes).max())

    assert longest_standstill(12) > 5 * 120
    assert longest_standstill(11) < 5 * 360  # a halt and no more


SERIES = 20_000


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.95, 0.999])
def test_autoregression_has_variance_one_from_the_start_and_forgets_by_phi_a_step(
    phi: float,
) -> None:
    noise = autoregression(np.random.default_rng(1).standard_normal((41, SERIES)), phi)
    covariance = noise @ noise.T / SERIES
    lags = np.abs(np.subtract.outer(np.arange(41), np.arange(41)))
    # Standard error of a covariance of unit normals: at most √(2 / SERIES).
    assert covariance == pytest.approx(phi**lags, abs=5 * math.sqrt(2 / SERIES))
    assert phi_of(0.1, -0.1 / math.log(0.95)) == pytest.approx(0.95)


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

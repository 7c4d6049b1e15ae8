"""The demo: its truth, its physics, its faults, its formats, and what it refuses to overwrite."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from leakage import OperatingConditions, leakage_l_per_min, regressors
from pipeline.config import MotorSpec, load_fleet
from pipeline.demo import shipped_configs, write_demo
from pipeline.demo.fleet import DEMO_FLEET, DemoMotor, DemoNight, Plan, truth_document, truth_of
from pipeline.demo.log_writers import as_logged, write_log
from pipeline.demo.mcap_writer import fixed_width_numbers
from pipeline.demo.operation import Duty, simulate_operation
from pipeline.demo.recording import record_night
from pipeline.errors import UsageError
from pipeline.ingest import read_log

PLAN = Plan(nights=75, minutes=90.0, rate_hz=5.0, seed=1, first_night=dt.date(2026, 1, 2))
MOTORS = {demo.motor_id: demo for demo in DEMO_FLEET}
EXCITED = [motor_id for motor_id, demo in MOTORS.items() if demo.is_excited]


@pytest.fixture(scope="module")
def specs() -> dict[str, MotorSpec]:
    fleet = load_fleet(shipped_configs() / "fleet.toml")
    return {spec.motor_id: spec for spec in fleet.motors}


@pytest.fixture(scope="module")
def truth(specs: dict[str, MotorSpec]) -> dict[str, Any]:
    nights = [
        DemoNight(demo, specs[demo.motor_id], PLAN, number)
        for demo in DEMO_FLEET
        for number in range(1, PLAN.nights + 1)
    ]
    motors: dict[str, Any] = json.loads(json.dumps(truth_document(PLAN, nights)))["motors"]
    return motors


def night_of(specs: dict[str, MotorSpec], motor_id: str, number: int = 1) -> DemoNight:
    return DemoNight(MOTORS[motor_id], specs[motor_id], PLAN, number)


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


# Truth


def test_reference_leakage_of_an_unworn_motor_as_built_is_the_published_one(
    specs: dict[str, MotorSpec],
) -> None:
    # model.md, section 3: the whole CB560 at 200 bar, 50 °C, 30 rpm: 1.371423 l/min.
    as_drawn = replace(MOTORS["CB560-01"], gap_factors={})
    nights = [DemoNight(as_drawn, specs["CB560-01"], PLAN, number) for number in range(1, 31)]
    mean = np.mean([truth_of(night).reference_leakage_l_per_min for night in nights])
    assert mean == pytest.approx(1.371423, rel=2e-3)


@pytest.mark.parametrize("motor_id", MOTORS)
def test_no_wear_before_night_31_and_more_than_the_alarm_level_by_night_70(
    truth: dict[str, Any], motor_id: str
) -> None:
    nights = list(truth[motor_id]["nights"].values())
    worn = set(truth[motor_id]["worn_paths"])
    for path in nights[0]["K_m3"]:
        factors = np.array([night["K_m3"][path] for night in nights])
        factors /= factors[:30].mean()
        assert np.all(np.abs(factors[:30] - 1.0) < 0.03)
        assert (factors[69] > 1.3) == (path in worn)
        assert (abs(factors[74] - 1.0) < 0.03) == (path not in worn)
    assert (motor_id == "CB400-01") == (not worn)


def test_step_comes_on_night_45(truth: dict[str, Any]) -> None:
    motor = truth["CB560-01"]
    sleeve = [night["K_m3"]["balance_sleeve"] for night in motor["nights"].values()]
    assert sleeve[44] / sleeve[43] > 1.4
    assert motor["first_night_of_wear"] == list(motor["nights"])[44] == "2026-02-15"


def test_truth_names_flushing_and_what_is_not_excited(truth: dict[str, Any]) -> None:
    assert [name for name, motor in truth.items() if not motor["excited"]] == ["CB1120-02"]
    for name, motor in truth.items():
        flows = [night["C_f_l_per_min"] for night in motor["nights"].values()]
        assert flows == pytest.approx([4.0 if name == "CB1120-01" else 0.0] * 75, rel=0.03)


# Physics and operation


def test_slow_errors_change_the_flow_alone_and_remember_for_their_minutes(
    specs: dict[str, MotorSpec],
) -> None:
    plain = night_of(specs, "CB400-01")
    slow = replace(plain, plan=replace(PLAN, slow_errors_min=15.0))
    before, after = (record_night(night).values for night in (plain, slow))
    changed = [name for name in before if not np.array_equal(before[name], after[name], True)]
    assert changed == ["leakage_flow"]
    added = after["leakage_flow"] - before["leakage_flow"]
    added = added[np.abs(added) < 0.5]
    # Forgets 1 − exp(−1/15) of its variance in a minute.
    minutes = added[: added.size // 300 * 300].reshape(-1, 300).mean(axis=1)
    assert np.var(np.diff(minutes)) < 0.5 * np.var(minutes)
    leakage = np.nanmedian(before["leakage_flow"])
    assert 0.003 < minutes.std() / leakage < 0.03


@pytest.mark.parametrize("motor_id", EXCITED)
def test_least_squares_recovers_the_truth(specs: dict[str, MotorSpec], motor_id: str) -> None:
    errors = np.array([recovery(night_of(specs, motor_id, number)) for number in (1, 40, 75)])
    assert np.all(np.median(np.abs(errors), axis=0) < [0.1] * (errors.shape[1] - 1) + [0.01])


def recovery(night: DemoNight) -> NDArray[np.float64]:
    """Relative errors of K of each path and of the reference leakage, by plain least squares."""
    recording, truth, motor = record_night(night), truth_of(night), night.motor
    values = {name: np.asarray(column) for name, column in recording.values.items()}
    pressure = values.get("pressure_difference")
    if pressure is None:
        pressure = values["high_port_pressure"] - values["low_port_pressure"]
    seconds = np.flatnonzero(np.abs(values["oil_temperature"] - 48.0) < 15.0)
    temperature = np.interp(
        np.arange(pressure.size), seconds, median(values["oil_temperature"][seconds])
    )
    flow, speed = values["leakage_flow"], values["speed"]
    calm = np.abs(flow - median(flow)) < 0.1 * median(flow)
    calm &= np.abs(pressure - median(pressure)) < 10.0
    running = np.abs(median(speed)) > 2.0
    rows = np.flatnonzero(running & calm & (np.abs(speed) < 150.0))
    conditions = OperatingConditions.from_bar(pressure[rows], temperature[rows], speed[rows])
    columns = regressors(motor, conditions)
    names = [path.name for path in motor.column_paths]
    used = columns[:, : len(names) + (night.demo.flushing_l_per_min > 0.0)]
    scale = np.linalg.norm(used, axis=0)
    solution, *_ = np.linalg.lstsq(used / scale, flow[rows] - columns[:, -1])
    found = dict(zip(names, solution / scale, strict=False))
    at_reference = leakage_l_per_min(motor, OperatingConditions.from_bar(200.0, 50.0, 30.0), found)
    pairs = [(found[name], truth.coefficients[name]) for name in names]
    pairs.append((float(at_reference[0]), truth.reference_leakage_l_per_min))
    return np.array([estimate / true - 1.0 for estimate, true in pairs])


def median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(median_filter(np.nan_to_num(values, posinf=0.0), 15))


def test_motor_that_is_not_excited_stays_at_its_pressure(specs: dict[str, MotorSpec]) -> None:
    values = record_night(night_of(specs, "CB1120-02")).values
    running = values["speed"] > 20.0
    inside = np.abs(values["pressure_difference"][running] - 180.0) <= 0.3
    assert np.mean(inside) > 0.98  # ramps and single faults are what is left


def test_halts_stop_the_motor_and_back_flow_follows_at_once() -> None:
    time_s = np.arange(27_000) / 5.0
    operation = simulate_operation(Duty(reverses=True), time_s, np.random.default_rng(1))
    halted = operation.speed_rpm == 0.0
    assert 120.0 <= halted.sum() / 5.0 <= 480.0
    assert np.all(operation.pressure_difference_bar[halted] == 0.0)
    assert np.all(halted[operation.back_flow])
    starts = np.flatnonzero(np.diff(operation.back_flow.astype(int)) == 1)
    assert np.array_equal(starts, np.flatnonzero(np.diff(halted.astype(int)) == 1))
    backward = operation.speed_rpm < 0.0
    assert backward.any()
    assert np.all(operation.pressure_difference_bar[backward] < 0.0)


def test_duty_covers_low_pressures_and_the_reference_conditions(
    specs: dict[str, MotorSpec],
) -> None:
    for motor_id in EXCITED:
        rng = np.random.default_rng(2)
        operation = simulate_operation(MOTORS[motor_id].duty, np.arange(27_000) / 5.0, rng)
        pressure = np.abs(operation.pressure_difference_bar)
        assert 0.2 < np.mean((pressure > 15.0) & (pressure < 100.0)) < 0.7
        assert pressure.max() > 220.0
        assert np.abs(operation.speed_rpm).max() < 125.0
        assert operation.oil_temperature_c.min() < 46.0
        assert operation.oil_temperature_c.max() > 54.0


# Faults


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


def test_messages_with_stamps_of_their_own_repeat_too(specs: dict[str, MotorSpec]) -> None:
    recordings = [record_night(night_of(specs, "CB1120-02", number)) for number in range(1, 7)]
    steps = [
        np.diff(recording.time_us + recording.own_delay_us["speed"]) for recording in recordings
    ]
    assert np.any(np.concatenate(steps) == 0)


def test_a_sensor_freezes_on_one_night_alone(specs: dict[str, MotorSpec]) -> None:
    def longest_standstill(number: int) -> int:
        flow = record_night(night_of(specs, "CB400-01", number)).values["leakage_flow"]
        changes = np.flatnonzero((np.diff(flow) != 0.0) & (flow[:-1] > 0.3))
        return int(np.diff(changes).max())

    assert longest_standstill(12) > 5 * 120
    assert longest_standstill(11) < 5 * 360  # a halt and no more


def test_sensors_are_coarse(specs: dict[str, MotorSpec]) -> None:
    for motor_id, resolution in (("CB400-01", 0.02), ("CB1120-01", 0.1)):
        flow = record_night(night_of(specs, motor_id)).values["leakage_flow"]
        steps = flow[np.isfinite(flow)] / resolution
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


# Formats


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


def test_csv_is_text_as_loggers_write_it(specs: dict[str, MotorSpec], tmp_path: Path) -> None:
    night = night_of(specs, "CB560-02")
    write_log(tmp_path / "log.csv", record_night(night), night.spec.file)
    header, first, second, *_ = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    assert header == "time;p_high;p_low;t_oil;n;q_drain"
    assert first.startswith("2026-01-01T21:30:00.000Z;")
    assert second.startswith("2026-01-01T21:30:00.200Z;")
    assert "," in first
    assert second.split(";")[3] == ""


def test_parquet_has_time_stamps_or_milliseconds_and_nulls(
    specs: dict[str, MotorSpec], tmp_path: Path
) -> None:
    for motor_id, column, kind in (
        ("CB400-02", "timestamp", "timestamp[us, tz=UTC]"),
        ("CB1120-01", "t_ms", "int64"),
    ):
        night = night_of(specs, motor_id)
        path = tmp_path / f"{motor_id}.parquet"
        write_log(path, record_night(night), night.spec.file)
        table = pq.read_table(path)
        assert str(table.schema.field(column).type) == kind
        assert table.column("oil_temperature").null_count == pytest.approx(
            0.8 * table.num_rows, rel=0.02
        )
    kelvin = pl.read_parquet(tmp_path / "CB1120-01.parquet")["oil_temperature"].median()
    assert isinstance(kelvin, float)
    assert 311.0 < kelvin < 331.0


def test_official_reader_agrees_with_the_mcap_file(
    specs: dict[str, MotorSpec], tmp_path: Path
) -> None:
    night = DemoNight(MOTORS["CB560-01"], specs["CB560-01"], replace(PLAN, minutes=20.0), 1)
    recording, motor = record_night(night), night.spec.file
    path = tmp_path / "log.mcap"
    write_log(path, recording, motor)
    expected = {
        channel.source: as_logged(name, values[~np.isnan(values)], channel)
        for name, channel in motor.channels.items()
        for values in [recording.values[name]]
    }
    with path.open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        messages = list(reader.iter_messages(log_time_order=False))
        channels = {number: channel.topic for number, channel in summary.channels.items()}
        counts = summary.statistics.channel_message_counts
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 1
    assert {channels[number]: count for number, count in counts.items()} == {
        topic: values.size for topic, values in expected.items()
    }
    for topic, values in expected.items():
        of_topic = [message for _, channel, message in messages if channel.topic == topic]
        read = [json.loads(message.data)["value"] for message in of_topic]
        np.testing.assert_allclose(read, values, atol=6e-4)
        assert [message.sequence for message in of_topic] == list(range(values.size))
    with path.open("rb") as stream:
        streamed = list(NonSeekingReader(stream, validate_crcs=True).iter_messages())
    assert len(streamed) == summary.statistics.message_count == len(messages)


def test_seeking_in_the_mcap_file_finds_a_time(specs: dict[str, MotorSpec], tmp_path: Path) -> None:
    night = DemoNight(MOTORS["CB560-01"], specs["CB560-01"], replace(PLAN, minutes=20.0), 1)
    write_log(tmp_path / "log.mcap", record_night(night), night.spec.file)
    start = dt.datetime(2026, 1, 1, 21, 40, tzinfo=dt.UTC)
    first_ns = int(start.timestamp()) * 1_000_000_000
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        topic = "/mill/motor_1/oil_temperature"
        found = [
            message.log_time
            for _, _, message in reader.iter_messages(
                topics=[topic], starting_at=first_ns, ending_before=first_ns + 10_000_000_000
            )
        ]
    assert 5 <= len(found) <= 11
    assert all(first_ns <= log_time < first_ns + 10_000_000_000 for log_time in found)


@given(st.lists(st.floats(-99_999.0, 99_999.0), min_size=1))
def test_fixed_width_numbers_are_python_s(values: list[float]) -> None:
    whole = np.rint(np.array(values) * 1000.0).astype(int).tolist()
    expected = [
        f"{'-' if number < 0 else ''}{abs(number) // 1000}.{abs(number) % 1000:03d}".rjust(10)
        for number in whole
    ]
    written = [bytes(row).decode() for row in fixed_width_numbers(np.array(values))]
    assert written == expected


# The folder


def small_demo(folder: Path, **arguments: Any) -> None:
    write_demo(folder, **({"nights": 2, "minutes": 10.0, "workers": 1} | arguments))


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "demo"
    small_demo(folder)
    return folder


def test_demo_is_whole(demo: Path) -> None:
    fleet = load_fleet(demo / "configs" / "fleet.toml")
    assert [spec.motor_id for spec in fleet.motors] == sorted(MOTORS)
    assert fleet.log_root == (demo / "demo" / "logs").resolve()
    for spec in fleet.motors:
        (pattern,) = spec.file.logs.files
        assert len(list(fleet.log_root.glob(pattern))) == 2
    assert list(json.loads((demo / "demo" / "truth.json").read_text())["motors"]) == list(MOTORS)
    assert not list(demo.rglob("*.partial"))


def test_two_workers_write_the_same_bytes(demo: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    small_demo(tmp_path, workers=2, progress=lambda *done: seen.append(done))
    assert digests(tmp_path) == digests(demo)
    assert seen[-1] == (12, 12)


def test_another_seed_makes_other_logs(demo: Path, tmp_path: Path) -> None:
    small_demo(tmp_path, nights=1, seed=2)
    before = digests(demo)
    for name, digest in digests(tmp_path / "demo" / "logs").items():
        assert before[f"demo/logs/{name}"] != digest


def test_a_night_does_not_depend_on_how_many_are_made(demo: Path, tmp_path: Path) -> None:
    small_demo(tmp_path, nights=1)
    assert digests(tmp_path / "demo" / "logs").items() <= digests(demo / "demo" / "logs").items()


def test_a_demo_is_replaced_and_other_files_in_it_are_not(tmp_path: Path) -> None:
    small_demo(tmp_path, nights=2)
    (tmp_path / "demo" / "truth.json").unlink()  # as if interrupted
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "demo" / "logs" / "CB400-01" / "mine.csv").write_text("mine")
    small_demo(tmp_path, nights=1)
    assert (tmp_path / "demo" / "truth.json").is_file()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    names = {path.name for path in (tmp_path / "demo" / "logs" / "CB400-01").iterdir()}
    assert names == {"CB400-01_2026-01-02.csv", "mine.csv"}


def test_a_folder_with_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="neither empty nor a demo") as caught:
        small_demo(tmp_path)
    assert caught.value.code == "demo_folder"
    assert [path.name for path in (tmp_path / "demo").iterdir()] == ["thesis.txt"]


def test_the_fleet_s_own_config_is_used_and_left_alone(tmp_path: Path) -> None:
    small_demo(tmp_path, nights=1)
    motors = tmp_path / "configs" / "motors"
    changed = motors / "CB400-01.toml"
    changed.write_text(changed.read_text().replace('"drain_flow_lpm"', '"case_drain"'))
    before = digests(tmp_path / "configs")
    small_demo(tmp_path, nights=1)
    assert digests(tmp_path / "configs") == before
    (log,) = (tmp_path / "demo" / "logs" / "CB400-01").iterdir()
    assert "case_drain" in log.read_text().splitlines()[0]
    (motors / "CB560-01.toml").unlink()
    with pytest.raises(UsageError, match="needs motor CB560-01"):
        small_demo(tmp_path, nights=1)
    assert (tmp_path / "demo" / "truth.json").is_file()


def test_a_file_in_the_folder_s_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "demo").write_text("mine")
    with pytest.raises(UsageError, match="neither empty nor a demo"):
        small_demo(tmp_path)
    with pytest.raises(UsageError, match="cannot be written: Not a directory"):
        small_demo(tmp_path / "demo")


@pytest.mark.parametrize(
    "arguments",
    [
        {"nights": 0},
        {"minutes": 0.5},
        {"minutes": float("nan")},
        {"minutes": 1441.0},
        {"rate_hz": 0.05},
        {"rate_hz": float("inf")},
        {"seed": -1},
        {"workers": 0},
        {"first_night": dt.date(1960, 1, 1)},
        {"slow_errors_min": -1.0},
    ],
)
def test_nonsense_is_refused_before_anything_is_written(
    tmp_path: Path, arguments: dict[str, Any]
) -> None:
    with pytest.raises(UsageError) as caught:
        small_demo(tmp_path / "demo", **arguments)
    assert caught.value.code == "demo_arguments"
    assert not (tmp_path / "demo").exists()


def test_a_long_log_stays_within_its_night(specs: dict[str, MotorSpec]) -> None:
    plan = replace(PLAN, minutes=1440.0, rate_hz=1.0)
    recording = record_night(DemoNight(MOTORS["CB400-01"], specs["CB400-01"], plan, 1))
    end = dt.datetime(2026, 1, 2, 6, tzinfo=dt.UTC)
    span = np.array([recording.time_us.min(), recording.time_us.max()]) / 1e6
    assert span[0] == (end - dt.timedelta(days=1)).timestamp()
    assert span[1] < end.timestamp()


def test_demo_motors_are_those_of_the_configs(specs: dict[str, MotorSpec]) -> None:
    assert set(specs) == set(MOTORS)
    formats = [spec.file.logs.format for spec in specs.values()]
    assert sorted(formats) == ["csv", "csv", "mcap", "mcap", "parquet", "parquet"]
    assert all(isinstance(demo, DemoMotor) for demo in DEMO_FLEET)

"""`check`: what is wrong with config and logs, before a night depends on them."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.channel_check import ChannelCheck
from pipeline.check import MotorCheck, check_fleet
from pipeline.config import load_fleet
from tests.conftest import OwnFleet
from tests.pipeline.simulated import NIGHT, motor_toml, operate, write_configs, write_log

MOTORS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]


def checks_of(fleet_file: Path) -> dict[str, MotorCheck]:
    return {one.motor_id: one for one in check_fleet(load_fleet(fleet_file))}


def test_a_sound_fleet(demo_folder: Path) -> None:
    checks = checks_of(demo_folder / "configs" / "fleet.toml")
    assert list(checks) == MOTORS
    for motor, one in checks.items():
        assert motor.startswith(one.motor_type)
        assert (one.n_files, one.n_nights) == (3, 3)
        assert (one.first, one.last) == ("2026-01-02", "2026-01-04")
        assert one.faults == ()
        assert one.placeholders
    assert [checks[motor].log_format for motor in MOTORS] == [
        *("parquet", "mcap", "csv", "parquet", "mcap", "csv")
    ]


def test_nothing_is_written_and_nothing_remembered(own_fleet: OwnFleet) -> None:
    fleet = own_fleet("CB400-02")
    before = sorted(fleet.parent.parent.rglob("*"))
    check_fleet(load_fleet(fleet))
    assert sorted(fleet.parent.parent.rglob("*")) == before


def test_a_check_does_not_read_logs_to_their_end(
    demo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A year of logs is looked at in seconds: neither hashed nor read."""

    def forbidden(*_: object) -> object:
        raise AssertionError

    monkeypatch.setattr("pipeline.logs.content_hash", forbidden)
    monkeypatch.setattr("pipeline.logs.read_log", forbidden)
    assert all(not one.faults for one in checks_of(demo_folder / "configs" / "fleet.toml").values())


@pytest.mark.parametrize("motor", ["CB400-01", "CB400-02", "CB560-01"])
@pytest.mark.parametrize(
    "content", [b"", b"\x00" * 4096, b"nonsense\n" * 1000], ids=["empty", "zeros", "text"]
)
def test_a_broken_log_is_a_fault_with_its_name(
    own_fleet: OwnFleet, motor: str, content: bytes
) -> None:
    fleet = own_fleet(motor)
    path = sorted((fleet.parent.parent / "logs" / motor).iterdir())[1]
    path.write_bytes(content)
    one = checks_of(fleet)[motor]
    assert (one.n_files, one.n_nights) == (3, 2)
    (fault,) = one.faults
    assert fault.startswith("log_")
    assert path.name in fault


def test_names_that_are_absent_and_channels_that_are_not_there(tmp_path: Path) -> None:
    text = motor_toml("M1", files='"M1/a.parquet", "M1/b.parquet", "M1/c*.parquet"')
    fleet = write_configs(tmp_path, {"M1": text})
    operation = operate()
    values = operation.channels(operation.pressure_bar)
    del values["speed"]
    write_log(tmp_path / "logs" / "M1" / "a.parquet", operation.time_us, values)
    one = checks_of(fleet)["M1"]
    assert one.n_files == 1
    assert any("log_missing" in fault and "M1/b.parquet" in fault for fault in one.faults)
    assert not any("c*" in fault for fault in one.faults)


def test_no_logs_at_all(tmp_path: Path) -> None:
    one = checks_of(write_configs(tmp_path, {"M1": motor_toml("M1")}))["M1"]
    assert (one.n_files, one.n_nights, one.first, one.last) == (0, 0, None, None)
    assert (one.faults, one.channels) == ((), ())
    (note,) = one.notes
    assert note.startswith("no file matches M1/*.parquet below ")


def test_a_newest_log_that_cannot_be_read_is_a_fault(own_fleet: OwnFleet) -> None:
    """A column that is not there shows only where a log is read."""
    fleet = own_fleet("CB400-02")
    motor = fleet.parent / "motors" / "CB400-02.toml"
    text = motor.read_text("utf-8").replace('source = "speed"', 'source = "velocity"')
    motor.write_text(text, "utf-8")
    one = checks_of(fleet)["CB400-02"]
    assert any(fault.startswith("log_column_missing") for fault in one.faults)


def test_constants_from_a_drawing_are_no_placeholders(tmp_path: Path) -> None:
    fleet = write_configs(tmp_path, {"M1": motor_toml("M1")})
    path = tmp_path / "configs" / "motor_types" / "CB560.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"placeholder"', '"drawing 4711"', 3), encoding="utf-8")
    assert checks_of(fleet)["M1"].placeholders
    path.write_text(text.replace('"placeholder"', '"drawing 4711"'), encoding="utf-8")
    assert checks_of(fleet)["M1"].placeholders == ("ISO VG 68 hydraulic oil",)
    oil = tmp_path / "configs" / "oils" / "vg68.toml"
    oil.write_text(oil.read_text("utf-8").replace('"placeholder"', '"data sheet"'), "utf-8")
    assert not checks_of(fleet)["M1"].placeholders


def test_a_whole_night_counts_once_however_many_files(tmp_path: Path) -> None:
    fleet = write_configs(tmp_path, {"M1": motor_toml("M1")})
    operation = operate()
    for number, rows in enumerate((slice(0, 900), slice(900, None))):
        values = operation.channels(operation.pressure_bar)
        write_log(
            tmp_path / "logs" / "M1" / f"{number}.parquet",
            operation.time_us[rows],
            {name: value[rows] for name, value in values.items()},
        )
    one = checks_of(fleet)["M1"]
    assert (one.n_files, one.n_nights, one.first) == (2, 1, NIGHT.isoformat())


def channels_of(fleet: Path, motor: str) -> dict[str, ChannelCheck]:
    return {one.channel: one for one in checks_of(fleet)[motor].channels}


def test_each_channel_of_the_newest_log_is_described(own_fleet: OwnFleet) -> None:
    channels = channels_of(own_fleet("CB400-01"), "CB400-01")
    assert set(channels) == {"pressure_difference", "oil_temperature", "speed", "leakage_flow"}
    for name, one in channels.items():
        assert one.suspicion == ""
        assert one.rate_hz == pytest.approx(1.0 if name == "oil_temperature" else 5.0, rel=0.01)
        assert 0 <= one.share_missing <= one.share_refused < 0.2
    assert 30 < (channels["oil_temperature"].median or 0) < 70


@pytest.mark.parametrize(
    ("right", "wrong", "channel"),
    [
        ("kPa", "bar", "pressure_difference"),
        ("K", "degC", "oil_temperature"),
        ("m3/h", "l/min", "leakage_flow"),
    ],
)
def test_a_wrong_unit_is_suspected_and_the_right_one_named(
    own_fleet: OwnFleet, right: str, wrong: str, channel: str
) -> None:
    fleet = own_fleet("CB1120-01")
    assert channels_of(fleet, "CB1120-01")[channel].suspicion == ""
    motor = fleet.parent / "motors" / "CB1120-01.toml"
    motor.write_text(motor.read_text("utf-8").replace(f'"{right}"', f'"{wrong}"'), "utf-8")
    assert right in channels_of(fleet, "CB1120-01")[channel].suspicion


def test_a_motor_without_a_readable_log_has_no_channels(own_fleet: OwnFleet) -> None:
    fleet = own_fleet("CB400-02")
    for path in (fleet.parent.parent / "logs" / "CB400-02").iterdir():
        path.write_bytes(b"nonsense")
    assert checks_of(fleet)["CB400-02"].channels == ()

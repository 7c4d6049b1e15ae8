"""A fleet's files together: what is shipped, folders, defaults, what holds when and for whom."""

from __future__ import annotations

import datetime as dt
import os
from pathlib import Path

import pytest

from pipeline.config import ConfigError, load_fleet
from tests.pipeline.config.conftest import MOTOR, OIL, SAMPLE, TYPE, Configs
from tests.pipeline.simulated import FLEET, write_configs
from tests.reference_pages import config_reference

MOST_SETTINGS = 130


def test_no_more_settings_than_a_plant_has_reasons_for() -> None:
    """What no plant would change is a constant with its reason beside it."""
    lines = config_reference().splitlines()
    assert sum(line.startswith("- `") and "` (" in line for line in lines) <= MOST_SETTINGS


def test_shipped_configs_load(configs: Configs) -> None:
    fleet = configs.load()
    ids = [f"{kind}-0{number}" for kind in ("CB1120", "CB400", "CB560") for number in (1, 2)]
    assert [spec.motor_id for spec in fleet.motors] == ids
    folder = configs.folder.parent
    assert (fleet.log_root, fleet.output) == (folder / "demo" / "logs", folder / "out")
    for spec in fleet.motors:
        for mode in ("none", "fixed", "estimated"):
            columns = spec.motor(dt.date(2026, 1, 2), mode).columns
            assert columns[-3:] == ("one", "known", "measured")


# Files and folders


@pytest.mark.parametrize("kind", ["pipe", "device", "huge"])
def test_what_never_ends_is_reported_and_not_read(
    configs: Configs, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = configs / MOTOR
    if kind == "huge":
        monkeypatch.setattr("pipeline.config.loading.LARGEST", path.stat().st_size - 1)
    else:
        path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    words = "is larger than" if kind == "huge" else "is no regular file"
    assert words in next(fault.message for fault in configs.faults() if fault.file == MOTOR)


def test_a_file_may_begin_with_a_byte_order_mark(configs: Configs) -> None:
    """As editors of Windows write it; a file that is no TOML by its name is none."""
    for file in ("fleet.toml", MOTOR, TYPE, OIL):
        path = configs / file
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    configs.add("motors/CB400-01.toml~", "backup")
    assert len(configs.load().motors) == 6


@pytest.mark.parametrize(
    ("key", "name"),
    [("logs", "a\\u0000b"), ("logs", "x" * 300), ("output", "../circle/x"), ("output", "")],
    ids=["a null character", "a long name", "links in a circle", "nothing"],
)
def test_folders_that_cannot_be(configs: Configs, key: str, name: str) -> None:
    (configs.folder.parent / "circle").symlink_to("circle")
    text = (configs / "fleet.toml").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(f"{key} = ")]
    at = next(number for number, line in enumerate(lines) if line.startswith("[folders]"))
    lines.insert(at + 1, f'{key} = "{name}"')
    (configs / "fleet.toml").write_text("\n".join(lines), "utf-8")
    (fault,) = (fault for fault in configs.faults() if fault.file == "fleet.toml")
    assert fault.key == f"folders.{key}"
    assert fault.message.startswith(f'got "{name}"; expected ')


REACHES = "of CB400-01 reaches into it"


@pytest.mark.parametrize(
    ("logs", "output", "pattern", "words"),
    [
        ("../logs", "../x/../logs/.", "CB400-01/*.csv", "another folder than that of the logs"),
        ("../out/staging", "../out", "CB400-01/*.csv", "expected a folder without the logs"),
        ("../out/tables/fits", "../out", "CB400-01/*.csv", "expected a folder without the logs"),
        ("..", "../CB400-01/", "CB400-01/*.csv", REACHES),
        ("..", "../out", "**/*.csv", REACHES),
        ("..", "../out", "o?t/**/*.csv", REACHES),
        ("..", "../out", "*/*.csv", REACHES),
        ("..", "../out/deep", "*/*.csv", ""),
        ("..", "../out", "logs/**/*.csv", ""),
        ("..", "../out", "*.csv", ""),
        ("../out/logs", "../out", "CB400-01/*.csv", ""),
    ],
)
def test_output_and_logs_that_spoil_each_other(
    configs: Configs, logs: str, output: str, pattern: str, words: str
) -> None:
    configs.change("fleet.toml", '"../demo/logs"', f'"{logs}"')
    configs.change("fleet.toml", '"../out"', f'"{output}"')
    configs.change(MOTOR, "CB400-01/*.csv", pattern)
    if not words:
        assert configs.load().output == (configs / output).resolve()
        return
    (fault,) = configs.faults()
    assert (fault.file, fault.key) == ("fleet.toml", "folders.output")
    assert fault.message.startswith(f'got "{output}"; expected ')
    assert words in fault.message


# What a motor is, when, and by which file


def test_an_oil_change_is_dated(configs: Configs) -> None:
    configs.add(MOTOR, '\n[[events]]\ndate = 2026-03-01\nkind = "oil_change"\noil = "vg46"\n')
    configs.add(MOTOR, '\n[[events]]\ndate = 2026-02-01\nkind = "oil_change"\noil = "vg32"\n')
    configs.add(MOTOR, '\n[[events]]\ndate = 2026-04-01\nkind = "overhaul"\n')
    spec = configs.motor()
    dates = [dt.date(2026, *day) for day in ((1, 31), (2, 1), (2, 28), (3, 1), (5, 1))]
    assert [spec.file.oil_on(date) for date in dates] == ["vg68", "vg32", "vg32", "vg46", "vg46"]
    assert len({spec.motor(date, "none").oil.name for date in dates}) == 3


def test_an_override_holds_for_its_motor_alone(configs: Configs) -> None:
    configs.change("fleet.toml", "[execution]", "[smoothing]\nwindow_s = 5.0\n[execution]")
    configs.add(MOTOR, "\n[override]\nsmoothing.window_s = 7.0\nnights.end_hour = 5\n")
    own, other = (configs.motor(name).settings for name in ("CB400-01", "CB400-02"))
    assert (own.smoothing.window_s, own.nights.end_hour) == (7.0, 5)
    assert (other.smoothing.window_s, other.nights.end_hour) == (5.0, 6)


@pytest.mark.parametrize(
    ("has_ports", "model", "is_two_sided"),
    [
        (False, "", False),
        (False, "two_sided = true", True),
        (True, "", True),
        (True, "two_sided = false", False),
    ],
)
def test_leakage_is_two_sided_where_the_low_side_is_known(
    configs: Configs, has_ports: bool, model: str, is_two_sided: bool
) -> None:
    if has_ports:
        low = '[channels.low_port_pressure]\nsource = "x"\nunit = "bar"\n[channels.speed]'
        configs.change(MOTOR, "[channels.pressure_difference]", "[channels.high_port_pressure]")
        configs.change(MOTOR, "[channels.speed]", low)
    configs.add(MOTOR, f"\n[override.model]\n{model}\n")
    assert configs.motor().settings.model.two_sided is is_two_sided


def test_motors_of_a_circuit_share_its_file(configs: Configs) -> None:
    configs.add("oil_circuits/winch.toml", SAMPLE)
    samples = {motor.motor_id: motor.circuit_samples for motor in configs.load().motors}
    assert {name for name, own in samples.items() if own} == {"CB1120-01", "CB1120-02"}


# `[defaults]`: motors that differ by a name in their log

DEFAULTS = """
[defaults]
motor_type = "CB560"
oil = "vg68"
logs = { format = "csv", files = ["plant/*.csv"], separator = ";" }
[defaults.channels]
pressure_difference = { source = "{name_in_log}_dp", unit = "bar", resolution = 0.1 }
oil_temperature = { source = "{name_in_log}_T", unit = "degC" }
speed = { source = "{name_in_log}_n", unit = "rpm" }
[defaults.channels.leakage_flow]
source = "{name_in_log}_q"
unit = "l/min"
"""
OWN = """
motor_id = "W1"
oil = "vg46"
logs.files = ["W1/*.csv"]
channels.pressure_difference.resolution = 0.5
channels.speed = { constant = 24.5, unit = "rpm" }
"""


def fleet_with(folder: Path, motors: dict[str, str], defaults: str = DEFAULTS) -> Path:
    return write_configs(folder, motors, fleet=FLEET + defaults)


def test_a_line_a_motor_which_has_the_last_word(tmp_path: Path) -> None:
    motors = {"W1": OWN, "W2": 'motor_id = "W2"'}
    motors["M3"] = 'motor_id = "M3"\nname_in_log = "Mill3/Motor2"'
    third, own, second = load_fleet(fleet_with(tmp_path, motors)).motors
    assert {spec.file.logs.separator for spec in (own, second, third)} == {";"}
    assert second.file.channels["speed"].source == "W2_n"
    assert third.file.channels["speed"].source == "Mill3/Motor2_n"
    assert (own.file.oil, own.file.motor_type) == ("vg46", "CB560")
    assert own.file.logs.files == ("W1/*.csv",)
    pressure, speed = (own.file.channels[name] for name in ("pressure_difference", "speed"))
    assert (pressure.source, pressure.resolution) == ("W1_dp", 0.5)
    assert (speed.source, speed.constant) == ("", 24.5)


@pytest.mark.parametrize(
    ("defaults", "own", "file", "key"),
    [
        (DEFAULTS.replace('"rpm"', '"turns"'), "", "fleet.toml", "defaults.channels.speed.unit"),
        (
            DEFAULTS,
            '\n[channels.speed]\nunit = "rounds"\n',
            "motors/W2.toml",
            "channels.speed.unit",
        ),
        (
            DEFAULTS + "resolutoin = 0.1\n",
            "",
            "fleet.toml",
            "defaults.channels.leakage_flow.resolutoin",
        ),
        (
            DEFAULTS + "[reference]\ntemperature_c = 2900.0",
            "",
            "fleet.toml",
            "reference.temperature_c",
        ),
    ],
)
def test_a_fault_of_the_defaults_is_reported_once_and_of_the_fleet_file(
    tmp_path: Path, defaults: str, own: str, file: str, key: str
) -> None:
    motors = {name: f'motor_id = "{name}"' for name in ("W1", "W2", "W3")}
    motors["W2"] += own
    with pytest.raises(ConfigError) as caught:
        load_fleet(fleet_with(tmp_path, motors, defaults))
    assert [(fault.file, fault.key) for fault in caught.value.faults] == [(file, key)]

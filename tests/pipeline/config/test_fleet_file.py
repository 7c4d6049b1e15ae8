"""The fleet file: its settings, those who are told, and what its motors have in common."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.config import load_fleet
from tests.pipeline.config.shipped import check_fault, faults, faults_in, load
from tests.pipeline.simulated import FLEET, write_configs
from tests.reference_pages import config_reference

MOST_SETTINGS = 165


def test_no_more_settings_than_a_plant_has_reasons_for() -> None:
    """What no plant would change is a constant with its reason beside it."""
    lines = config_reference().splitlines()
    assert sum(line.startswith("- `") and "` (" in line for line in lines) <= MOST_SETTINGS


@pytest.mark.parametrize(
    ("table", "line", "key", "words"),
    [
        ("nights", 'time_zone = "Europe/Atlantis"', "nights.time_zone", "IANA"),
        ("nights", 'time_zone = "right/UTC"', "nights.time_zone", "IANA"),
        ("execution", 'backend = "spark"', "execution.backend", "'loky', 'sequential' or 'dask'"),
        ("smoothing", "window_s = 120.0", "smoothing.window_s", "less than 120"),
        ("smothing", "window_s = 1.0", "smothing", "spelling"),
    ],
)
def test_faults_of_the_fleet_file(
    configs: Path, table: str, line: str, key: str, words: str
) -> None:
    (configs / "fleet.toml").write_text(f'name = "F"\n[{table}]\n{line}\n', encoding="utf-8")
    check_fault(configs, "fleet.toml", key, words)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *(
            (f"webhook_url = {url}", "webhook_url: expected http:// or https:// and a host")
            for url in (
                *('"file:///T0KEN"', '"http://"', '"http:/T0KEN"', '"http://h/T0 KEN"'),
                *('"http://h/T0KEN\\r\\n"', '"http://[::1"', '"http://h:T0KEN/"'),
                *('"http://h:99999/"', '"h.example/T0KEN"'),
            )
        ),
        ('webhook_url = "https://me:T0KEN@h/"', "webhook_url: expected no name or password"),
        ('webhook_url = ["http://h/T0KEN"]', "webhook_url: expected a valid string"),
        ("deadband_percent = 15.0\nwebhook_url = 'http://h/T0KEN'", "is no key of this table"),
        ('webhook_headers = { "X:" = "T0KEN" }', "webhook_headers: expected names of letters"),
        ('webhook_headers = { Host = "T0KEN" }', "webhook_headers: expected no Host: the program"),
        ('webhook_headers = { webhook-id = "T0KEN" }', "expected no webhook-id"),
        *(
            (f"webhook_headers = {{ X = {value} }}", "webhook_headers: expected printable ASCII")
            for value in (
                *('"$T0KEN"', '"${T0KEN"', '"${}"', '"${1}"', '"T0KENñ"', '"T0\\nKEN"', '""'),
            )
        ),
        ("webhook_headers = { X = 1 }", "webhook_headers.X: expected a valid string"),
        ('webhook_secret = "whsec_T0KEN"', "webhook_secret: expected ${NAME}, with the secret in"),
        ('webhook_secret = "${A}${B}"', "webhook_secret: expected ${NAME}"),
    ],
)
def test_a_web_hook_that_cannot_be_posted_to(configs: Path, line: str, words: str) -> None:
    path = configs / "fleet.toml"
    path.write_text(path.read_text("utf-8") + f"\n[alarms]\n{line}\n", "utf-8")
    (fault,) = faults(configs)
    assert words in str(fault)
    assert "T0KEN" not in str(fault)


def test_a_web_hook_with_all_that_it_may_have(configs: Path) -> None:
    path = configs / "fleet.toml"
    lines = """
        [alarms]
        webhook_url = "https://h.example:8443/a/b?c=d"
        webhook_headers = { Authorization = "Bearer ${HOOK_TOKEN}", X-Plant = "3, hall ${HALL}" }
        webhook_secret = "${HOOK_SECRET}"
    """
    path.write_text(path.read_text("utf-8") + lines, "utf-8")
    alarms = load(configs).settings.alarms
    assert alarms.webhook_headers["X-Plant"] == "3, hall ${HALL}"


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


def fleet_with(folder: Path, motors: dict[str, str], defaults: str = DEFAULTS) -> Path:
    return write_configs(folder, motors, fleet=FLEET + defaults)


def test_a_line_a_motor(tmp_path: Path) -> None:
    motors = {name: f'motor_id = "{name}"' for name in ("W1", "W2")}
    motors["M3"] = 'motor_id = "M3"\nname_in_log = "Mill3/Motor2"'
    fleet = load_fleet(fleet_with(tmp_path, motors))
    sources = {motor.motor_id: motor.file.channels["speed"].source for motor in fleet.motors}
    assert sources == {"W1": "W1_n", "W2": "W2_n", "M3": "Mill3/Motor2_n"}
    assert {motor.file.logs.separator for motor in fleet.motors} == {";"}


def test_a_motor_has_the_last_word(tmp_path: Path) -> None:
    own = """
motor_id = "W1"
oil = "vg46"
logs.files = ["W1/*.csv"]
channels.pressure_difference.resolution = 0.5
channels.speed = { constant = 24.5, unit = "rpm" }
"""
    (spec,) = load_fleet(fleet_with(tmp_path, {"W1": own})).motors
    assert (spec.file.oil, spec.file.motor_type) == ("vg46", "CB560")
    assert (spec.file.logs.files, spec.file.logs.separator) == (("W1/*.csv",), ";")
    pressure, speed = (spec.file.channels[name] for name in ("pressure_difference", "speed"))
    assert (pressure.source, pressure.resolution) == ("W1_dp", 0.5)
    assert (speed.source, speed.constant) == ("", 24.5)


def test_a_fault_of_the_defaults_is_told_once_and_of_the_fleet_file(tmp_path: Path) -> None:
    motors = {name: f'motor_id = "{name}"' for name in ("W1", "W2", "W3")}
    path = fleet_with(tmp_path, motors, DEFAULTS.replace('"rpm"', '"turns"'))
    (fault,) = faults_in(path)
    assert (fault.file, fault.key) == ("fleet.toml", "defaults.channels.speed.unit")
    motors["W2"] += '\n[channels.speed]\nunit = "rounds"\n'
    found = {(fault.file, fault.key) for fault in faults_in(fleet_with(tmp_path, motors))}
    assert found == {("motors/W2.toml", "channels.speed.unit")}


def test_a_key_that_no_motor_has_is_a_fault(tmp_path: Path) -> None:
    path = fleet_with(tmp_path, {"W1": 'motor_id = "W1"'}, DEFAULTS + "resolutoin = 0.1\n")
    (fault,) = faults_in(path)
    assert (fault.file, fault.key) == ("fleet.toml", "defaults.channels.leakage_flow.resolutoin")

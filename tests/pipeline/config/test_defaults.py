"""`[defaults]` of the fleet file: motors that differ by a name in their log."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest

from pipeline.config import ConfigError, Fault, load_fleet
from pipeline.config.hashes import SettingsHashes, config_hash, reading_hash
from pipeline.demo import shipped_configs
from tests.pipeline.simulated import FLEET, write_configs

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


def configs(folder: Path, motors: dict[str, str], defaults: str = DEFAULTS) -> Path:
    return write_configs(folder, motors, fleet=FLEET + defaults)


def faults_of(path: Path) -> tuple[Fault, ...]:
    with pytest.raises(ConfigError) as caught:
        load_fleet(path)
    return caught.value.faults


def test_a_line_a_motor(tmp_path: Path) -> None:
    motors = {name: f'motor_id = "{name}"' for name in ("W1", "W2")}
    motors["M3"] = 'motor_id = "M3"\nname_in_log = "Mill3/Motor2"'
    fleet = load_fleet(configs(tmp_path, motors))
    sources = {one.motor_id: one.file.channels["speed"].source for one in fleet.motors}
    assert sources == {"W1": "W1_n", "W2": "W2_n", "M3": "Mill3/Motor2_n"}
    assert {one.file.logs.separator for one in fleet.motors} == {";"}


def test_a_motor_has_the_last_word(tmp_path: Path) -> None:
    own = """
motor_id = "W1"
oil = "vg46"
logs.files = ["W1/*.csv"]
channels.pressure_difference.resolution = 0.5
channels.speed = { constant = 24.5, unit = "rpm" }
"""
    (spec,) = load_fleet(configs(tmp_path, {"W1": own})).motors
    assert (spec.file.oil, spec.file.motor_type) == ("vg46", "CB560")
    assert (spec.file.logs.files, spec.file.logs.separator) == (("W1/*.csv",), ";")
    pressure, speed = (spec.file.channels[name] for name in ("pressure_difference", "speed"))
    assert (pressure.source, pressure.resolution) == ("W1_dp", 0.5)
    assert (speed.source, speed.constant) == ("", 24.5)


def test_a_fault_of_the_defaults_is_told_once_and_of_the_fleet_file(tmp_path: Path) -> None:
    motors = {name: f'motor_id = "{name}"' for name in ("W1", "W2", "W3")}
    path = configs(tmp_path, motors, DEFAULTS.replace('"rpm"', '"turns"'))
    (fault,) = faults_of(path)
    assert (fault.file, fault.key) == ("fleet.toml", "defaults.channels.speed.unit")
    motors["W2"] += '\n[channels.speed]\nunit = "rounds"\n'
    found = {(fault.file, fault.key) for fault in faults_of(configs(tmp_path, motors))}
    assert found == {("motors/W2.toml", "channels.speed.unit")}


def test_a_key_that_no_motor_has_is_a_fault(tmp_path: Path) -> None:
    path = configs(tmp_path, {"W1": 'motor_id = "W1"'}, DEFAULTS + "resolutoin = 0.1\n")
    (fault,) = faults_of(path)
    assert (fault.file, fault.key) == ("fleet.toml", "defaults.channels.leakage_flow.resolutoin")


def test_hashes_of_the_shipped_motors_stay() -> None:
    """Regression: another one makes every plant's nights anew, which the change log must say."""
    found = [
        (reading_hash(spec), dated.statistics(night), dated.figures(night), config_hash(spec))
        for night in [dt.date(2026, 3, 1)]
        for spec in load_fleet(shipped_configs() / "fleet.toml").motors
        for dated in [SettingsHashes(spec)]
    ]
    assert found == [
        ("38f0f28070caaced", "b2655957f9315310", "f183d1215fe95a41", "cc3a9ee3605b2229"),
        ("bbd6f4694fb63749", "44ffe40b20d60db3", "50bea82a3980611c", "f36ecc296bcc5af7"),
        ("c8ce36800478243a", "6ab6264f76cef782", "d4ff9581b5ff7999", "74334aac3de45494"),
        ("ad67cbdd48f2775a", "0dcb336e93a1257d", "d4ff9581b5ff7999", "ba00fc68941a1119"),
        ("f1c87f90e8e1a73e", "70a63ef4f9f4110a", "b7d067d194772636", "7613cad1276d25ab"),
        ("f791ae6380505b7e", "431a95e0dc8579d4", "bcf4f72391a7b729", "7534bb3ab22c65bd"),
    ]

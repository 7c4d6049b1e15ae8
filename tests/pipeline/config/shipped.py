"""The shipped config with changes, and its faults."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.config import ConfigError, Fault, Fleet, load_fleet

MOTOR = "motors/CB400-01.toml"
TYPE = "motor_types/CB400.toml"
OIL = "oils/vg46.toml"
SAMPLE = "[[oil_samples]]\ndate = 2020-01-05\nviscosity_40_c_mm2_per_s = 46.0\n"


def change(configs: Path, file: str, before: str, after: str) -> None:
    path = configs / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after, 1), encoding="utf-8")


def add(configs: Path, file: str, text: str) -> None:
    with (configs / file).open("a", encoding="utf-8") as stream:
        stream.write(text)


def load(configs: Path) -> Fleet:
    return load_fleet(configs / "fleet.toml")


def faults(configs: Path) -> tuple[Fault, ...]:
    return faults_in(configs / "fleet.toml")


def faults_in(fleet_file: Path) -> tuple[Fault, ...]:
    with pytest.raises(ConfigError) as caught:
        load_fleet(fleet_file)
    for fault in caught.value.faults:
        assert str(fault) in str(caught.value)
    return caught.value.faults


def only_fault(configs: Path) -> Fault:
    (fault,) = faults(configs)
    return fault


def check_fault(configs: Path, file: str, key: str, words: str) -> None:
    found = {(fault.file, fault.key): fault.message for fault in faults(configs)}
    assert words in found[file, key]

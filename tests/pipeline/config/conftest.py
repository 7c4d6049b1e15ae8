"""The shipped config in a folder of its own, to be changed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline.config import ConfigError, Fault, Fleet, MotorSpec, load_fleet
from pipeline.demo import shipped_configs

MOTOR = "motors/CB400-01.toml"
TYPE = "motor_types/CB400.toml"
OIL = "oils/vg46.toml"
SAMPLE = "[[oil_samples]]\ndate = 2020-01-05\nviscosity_40_c_mm2_per_s = 46.0\n"


@dataclass(frozen=True)
class Configs:
    """A folder of config files."""

    folder: Path

    def __truediv__(self, file: str) -> Path:
        return self.folder / file

    def change(self, file: str, before: str, after: str) -> None:
        """Replace a text of a file once."""
        text = (self / file).read_text(encoding="utf-8")
        assert before in text
        (self / file).write_text(text.replace(before, after, 1), encoding="utf-8")

    def add(self, file: str, text: str) -> None:
        """Write a text behind a file, which need not be there."""
        (self / file).parent.mkdir(exist_ok=True)
        with (self / file).open("a", encoding="utf-8") as stream:
            stream.write(text)

    def load(self) -> Fleet:
        return load_fleet(self / "fleet.toml")

    def motor(self, motor_id: str = "CB400-01") -> MotorSpec:
        return self.load().motor(motor_id)

    def faults(self) -> tuple[Fault, ...]:
        """The faults that there are, each of which is shown."""
        with pytest.raises(ConfigError) as caught:
            self.load()
        assert all(str(fault) in str(caught.value) for fault in caught.value.faults)
        return caught.value.faults

    def places(self) -> set[tuple[str, str]]:
        """File and key of the faults."""
        return {(fault.file, fault.key) for fault in self.faults()}


@pytest.fixture
def configs(tmp_path: Path) -> Configs:
    shutil.copytree(shipped_configs(), tmp_path / "configs")
    return Configs(tmp_path / "configs")

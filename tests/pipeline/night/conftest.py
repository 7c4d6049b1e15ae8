"""The motor of most nights here."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.config import MotorSpec
from tests.pipeline.simulated import load_motor, motor_toml


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    return load_motor(tmp_path, motor_toml("M1"))

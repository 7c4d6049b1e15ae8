"""A motor whose logs are looked at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.config import MotorSpec, load_fleet
from pipeline.demo import shipped_configs
from tests.pipeline.logs.looked_at import with_files


@pytest.fixture(scope="session")
def shipped() -> MotorSpec:
    return load_fleet(shipped_configs() / "fleet.toml").motors[0]


@pytest.fixture
def spec(shipped: MotorSpec, tmp_path: Path) -> MotorSpec:
    """A motor with CSV logs below the test's folder, nights of UTC that end at 6."""
    return with_files(replace(shipped, log_root=tmp_path), "*.csv")

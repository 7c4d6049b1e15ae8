"""The shipped config in a folder of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pipeline.demo import shipped_configs


@pytest.fixture
def configs(tmp_path: Path) -> Path:
    shutil.copytree(shipped_configs(), tmp_path / "configs")
    return tmp_path / "configs"

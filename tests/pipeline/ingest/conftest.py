"""Real files that nobody of this project wrote."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

VARIABLE = "MOTOR_LEAKAGE_TEST_DATA"
DEFAULT = Path(__file__).parents[4] / "shared" / "data"


@pytest.fixture(scope="session")
def foreign_files() -> Path:
    """Folder of recordings and malformed files from other projects' own tests."""
    folder = Path(os.environ.get(VARIABLE, DEFAULT))
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there: set {VARIABLE} to the folder of real files")
    return folder

"""One tiny fleet for all tests of faults, made once, however many workers there are."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import made_once
from tests.pipeline.faults.fleet import TinyFleet


@pytest.fixture(scope="session")
def tiny_fleet(shared_folder: Path) -> TinyFleet:
    """Two motors and two nights; only to be read."""
    return TinyFleet(made_once(shared_folder / "tiny", TinyFleet.at))

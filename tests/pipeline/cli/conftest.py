"""A fleet of two motors."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import OwnFleet
from tests.pipeline.calling import CSV, PARQUET, without_workers


@pytest.fixture
def fleet(own_fleet: OwnFleet) -> Path:
    """Two motors that are fitted already: a run over them is quick."""
    return without_workers(own_fleet(CSV, PARQUET, fitted=True))

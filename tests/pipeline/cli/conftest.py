"""A fleet of two motors that are fitted already: a run over them is quick."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.conftest import OwnFleet, copy_motors
from tests.pipeline.calling import CSV, PARQUET, without_workers


@pytest.fixture
def fleet(own_fleet: OwnFleet) -> Path:
    """Two motors of one's own."""
    return without_workers(own_fleet(CSV, PARQUET, fitted=True))


@pytest.fixture(scope="module")
def untouched(
    demo_folder: Path, fitted_output: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The same, only to be read."""
    folder = tmp_path_factory.mktemp("untouched")
    shutil.copytree(fitted_output, folder / "out")
    return without_workers(copy_motors(demo_folder, folder, (CSV, PARQUET)))

"""A table file on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.schema import QUALITY
from pipeline.store.tables import night_file, write_table
from tests.pipeline.store.made_rows import NIGHT, row, rows


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = night_file(tmp_path, QUALITY, NIGHT)
    write_table(path, rows(*(row(f"M{number:03}", refused=number) for number in range(200))))
    return path

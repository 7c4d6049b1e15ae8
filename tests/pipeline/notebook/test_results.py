"""Published tables read back."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import UsageError
from pipeline.notebook import open_tables
from pipeline.schema import ALARMS, FITS, frame
from tests.pipeline.written import write_nights

# In two months, so in two files.
NIGHTS = [dt.date(2026, 1, 31), dt.date(2026, 2, 1)]


def test_tables_hold_all_nights_and_fits_the_primary_ones(tmp_path: Path) -> None:
    rows = [
        {"motor_id": "M1", "night": night, "flushing_mode": mode, "is_primary": mode == "none"}
        for night in NIGHTS
        for mode in ("none", "fixed")
    ]
    write_nights(tmp_path, FITS, frame(FITS, rows))
    tables = open_tables(tmp_path)
    assert tables.table("fits").collect().height == 4
    found = tables.fits().collect()
    assert (found["night"].to_list(), found["is_primary"].all()) == (NIGHTS, True)
    # What has no files is empty, with its columns.
    assert tables.table("alarms").collect().schema == pl.Schema(ALARMS.schema)
    with pytest.raises(UsageError, match="no table fit; there are nights"):
        tables.table("fit")
    with pytest.raises(UsageError, match="run fit-fleet first"):
        open_tables(tmp_path / "nowhere")

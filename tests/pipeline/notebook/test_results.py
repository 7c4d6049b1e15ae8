"""Published tables read back: the same rows, and damage told."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import polars as pl
import pytest

from pipeline.errors import StoreError, UsageError
from pipeline.notebook import open_tables
from pipeline.notebook.results import Tables
from pipeline.schema import ALARMS, FITS, TRENDS, frame
from pipeline.store.tables import night_file
from tests.pipeline.written import write_nights

FIRST = dt.date(2026, 1, 30)
NIGHTS = [FIRST + dt.timedelta(days=at) for at in range(4)]


def trend(night: dt.date, indicator: str, value: float) -> dict[str, object]:
    row = {"motor_id": "M1", "night": night, "indicator": indicator, "unit": "%"}
    return row | {"value": value, "lower": value - 1.0, "upper": value + 1.0}


@pytest.fixture
def tables(tmp_path: Path) -> Tables:
    for at, night in enumerate(NIGHTS):
        fits = [
            {"motor_id": "M1", "night": night, "flushing_mode": mode, "is_primary": mode == "none"}
            for mode in ("none", "fixed")
        ]
        courses = [trend(night, "gap_change_ring", 2.0 * at), trend(night, "drain_flow", 1.0)]
        for table, rows in ((FITS, fits), (TRENDS, courses)):
            write_nights(tmp_path, table, frame(table, rows))
    return open_tables(tmp_path)


def test_fits_are_the_primary_ones_of_all_nights_and_a_trend_is_one_indicator(
    tables: Tables,
) -> None:
    found = tables.fits().collect()
    assert found["night"].to_list() == NIGHTS
    assert found["is_primary"].all()
    course = tables.trend("M1", "gap_change_ring").collect()
    assert course["value"].to_list() == [0.0, 2.0, 4.0, 6.0]
    # What has no rows or no files is empty, with its columns.
    assert tables.trend("M2", "gap_change_ring").collect().height == 0
    assert tables.alarms().collect().schema == pl.Schema(ALARMS.schema)


def test_what_is_not_there_is_told(tables: Tables, tmp_path: Path) -> None:
    for ask, words in (
        (lambda: tables.table("fit"), "no table fit; there are latest"),
        (lambda: open_tables(tmp_path / "nowhere"), "run fit-fleet first"),
    ):
        with pytest.raises(UsageError, match=words):
            ask()


def test_a_changed_file_is_found_where_that_is_asked_for(tables: Tables) -> None:
    open_tables(tables.output, verify=True)
    path = night_file(tables.output, FITS, FIRST)
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    with pytest.raises(StoreError, match=path.name):
        open_tables(tables.output, verify=True)

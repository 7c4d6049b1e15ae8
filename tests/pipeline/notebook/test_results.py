"""Published tables read back: the same rows, and damage told."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import matplotlib as mpl
import polars as pl
import pytest

from pipeline.errors import StoreError, UsageError
from pipeline.notebook import open_tables, plot_course
from pipeline.notebook.results import Tables
from pipeline.schema import ALARMS, FITS, LATEST, TRENDS, frame
from pipeline.store.encoding import write_table
from pipeline.store.manifest import update_manifest
from pipeline.store.months import join_months
from pipeline.store.tables import files_of, night_file, table_folder

FIRST = dt.date(2026, 1, 30)
NIGHTS = [FIRST + dt.timedelta(days=at) for at in range(4)]


def trend(night: dt.date, indicator: str, value: float) -> dict[str, object]:
    row = {"motor_id": "M1", "night": night, "indicator": indicator, "unit": "%"}
    return row | {"value": value, "lower": value - 1.0, "upper": value + 1.0}


@pytest.fixture
def tables(tmp_path: Path) -> Tables:
    for at, night in enumerate(NIGHTS):
        digests: dict[str, str | None] = {}
        fits = [
            {"motor_id": "M1", "night": night, "flushing_mode": mode, "is_primary": mode == "none"}
            for mode in ("none", "fixed")
        ]
        courses = [trend(night, "gap_change_ring", 2.0 * at), trend(night, "drain_flow", 1.0)]
        # Levels of K ∝ h³: a gap 10 % and 20 % higher.
        levels = {"baseline_mean": 1.0, "warning_limit": 1.1**3, "alarm_limit": 1.2**3}
        courses.append(trend(night, "K_ring", 1.0) | levels)
        for table, rows in ((FITS, fits), (TRENDS, courses)):
            path = night_file(tmp_path, table, night)
            path.parent.mkdir(parents=True, exist_ok=True)
            digests[path.relative_to(tmp_path / "tables").as_posix()] = write_table(
                path, frame(table, rows)
            )
        update_manifest(tmp_path, f"{night:%Y-%m}", str(night), digests)
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


def test_a_joined_month_and_a_table_without_nights_are_read_once_and_whole(tables: Tables) -> None:
    before = tables.fits().collect()
    join_months(tables.output, tables.output / "staging", f"{FIRST:%Y-%m}")
    assert len(files_of(tables.output, FITS)) == 3
    assert tables.fits().collect().equals(before)
    path = table_folder(tables.output, LATEST) / "latest.parquet"
    path.parent.mkdir(parents=True)
    write_table(path, frame(LATEST, [{"motor_id": "M1", "state": "ok"}]))
    assert tables.latest().collect()["motor_id"].to_list() == ["M1"]


def test_what_is_not_there_is_told(tables: Tables, tmp_path: Path) -> None:
    for ask, words in (
        (lambda: tables.table("fit"), "no table fit; there are latest"),
        (lambda: open_tables(tmp_path / "nowhere"), "run fit-fleet first"),
        (lambda: open_tables("s3://bucket/fleet"), "run fit-fleet first"),
        (lambda: plot_course(tables, "M2"), "no trend of M2"),
    ):
        with pytest.raises(UsageError, match=words):
            ask()


def test_a_changed_file_is_found_where_that_is_asked_for(tables: Tables) -> None:
    open_tables(tables.output, verify=True)
    path = night_file(tables.output, FITS, FIRST)
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    with pytest.raises(StoreError, match=path.name):
        open_tables(tables.output, verify=True)


def test_the_course_of_each_gap_is_plotted_with_its_levels(tables: Tables) -> None:
    mpl.use("agg")
    axes = plot_course(tables, "M1")
    line, warning, alarm, *_ = axes.get_lines()
    assert list(line.get_ydata()) == [0.0, 2.0, 4.0, 6.0]
    assert list(warning.get_ydata()) == pytest.approx([10.0] * 4)
    assert list(alarm.get_ydata()) == pytest.approx([20.0] * 4)
    told = [text.get_text() for text in axes.get_legend().get_texts()]
    assert told == ["ring", "level of warning", "level of alarm"]

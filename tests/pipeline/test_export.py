"""CSV export: it reads back as published, and no text is a formula."""

from __future__ import annotations

import datetime as dt
import math
import re
import shutil
from pathlib import Path

import polars as pl
from hypothesis import given
from hypothesis import strategies as st

from pipeline.export import CsvRequest, as_text, export_csv, tables_named
from pipeline.schema import FITS, LOG_FILES, PARAMETERS, TABLES, Table, frame
from pipeline.store.tables import read_table, table_folder
from tests.pipeline.calling import contents, refused
from tests.pipeline.written import night_file

NIGHT = dt.date(2026, 1, 3)
HARMLESS = ["", "1 - 2", "a=b", "x, -2; +3", "ok", "'quoted'", "é − 漢", "line\nbreak", "a;b"]


def export(output: Path, folder: Path, *tables: Table, **others: object) -> dict[str, int]:
    request = CsvRequest(tables=tables or TABLES, **others)  # type: ignore[arg-type]
    return {path.stem: n_rows for path, n_rows in export_csv(output, folder, request)}


def published(output: Path, table: Table) -> pl.DataFrame:
    files = sorted(table_folder(output, table).rglob("*.parquet"))
    assert files or table not in (FITS, LOG_FILES)
    return pl.concat([frame(table, []), *(read_table(path, table) for path in files)])


def test_how_values_are_written() -> None:
    rows = pl.DataFrame({"a": [None, ""], "b": [-1, 2], "c": [-1.5e-14, 2.0]})
    assert as_text(rows).write_csv() == 'a,b,c\n,-1,-1.5e-14\n"",2,2.0\n'
    night = dt.datetime(2026, 1, 2, 3, 4, 5, 67, dt.UTC)
    row = {"motor_id": "A", "night": NIGHT, "window_start": night, "is_primary": True}
    (text,) = as_text(frame(FITS, [row | {"coefficients": [1.5, 2e-14, math.nan]}])).to_dicts()
    assert text["window_start"] == "2026-01-02T03:04:05.000067Z"
    assert text["window_end"] is None
    assert text["coefficients"] == "[1.5, 2e-14, null]"
    line = as_text(frame(FITS, [row])).write_csv().splitlines()[1]
    assert line.startswith("A,2026-01-03,,true,2026-01-02T03:04:05.000067Z,,")
    assert as_text(pl.DataFrame({"a": HARMLESS}))["a"].to_list() == HARMLESS


def is_formula(cell: str) -> bool:
    return cell[:1] in set("=+-@\t\r\n\x00＝＋－＠")


def hides_a_formula(cell: str) -> bool:
    """True if a spreadsheet with another separator would find one, with or without blanks."""
    parts = re.split("[;\t\r\n]", cell)
    return any(part.lstrip("\x00")[:1] in set("=+-@＝＋－＠") for part in parts)


@given(st.text(alphabet=st.sampled_from("=+-@＝＋－＠;,\t\r\n\x00'\"ab "), max_size=12))
def test_no_text_whatever_is_a_formula(text: str) -> None:
    (cell,) = as_text(pl.DataFrame({"a": [text]}))["a"].to_list()
    assert not is_formula(cell)
    assert cell.replace("'", "") == text.replace("'", "")
    assert not hides_a_formula(cell)


def test_runs_are_chosen_by_the_day_they_began(fitted_output: Path, tmp_path: Path) -> None:
    runs, parameters, fits = tables_named(["runs", "parameters", "fits", "fits"])
    assert (parameters, fits, tables_named([])) == (PARAMETERS, FITS, TABLES)
    day = published(fitted_output, runs)["started_at"][0].date()
    next_day = day + dt.timedelta(days=1)
    assert export(fitted_output, tmp_path, runs, since=day, until=day) == {"runs": 1}
    assert export(fitted_output, tmp_path, runs, since=next_day) == {"runs": 0}
    assert (tmp_path / "runs.csv").read_text() == ",".join(runs.schema) + "\n"


def test_what_cannot_be_exported_leaves_the_file_before(
    fitted_output: Path, tmp_path: Path
) -> None:
    output, folder = tmp_path / "out", tmp_path / "csv"
    shutil.copytree(table_folder(fitted_output, FITS), table_folder(output, FITS))
    export(output, folder, FITS)
    before = contents(folder)
    path = night_file(output, FITS, NIGHT)
    path.write_bytes(path.read_bytes()[:-100])
    with refused("store_read", "2026-01.parquet of fits"):
        export(output, folder, FITS)
    assert contents(folder) == before
    (tmp_path / "link").symlink_to(output / "tables")
    for own in (output / "tables" / "fits", tmp_path / "link"):
        with refused("csv_folder"):
            export(output, own, FITS)

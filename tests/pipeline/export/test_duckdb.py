"""All tables in one DuckDB file: the rows of every table, whole or not at all."""

from __future__ import annotations

from pathlib import Path

import duckdb
import polars as pl
import pytest

from pipeline.errors import StoreError, UsageError
from pipeline.export.duckdb import export_duckdb
from pipeline.schema import FITS, INPUT_FILES, TABLES, frame
from pipeline.store.encoding import write_table
from pipeline.store.tables import files_of, read_table, table_folder
from tests.pipeline.calling import refused


def test_the_file_has_every_row_and_the_views(fitted_output: Path, tmp_path: Path) -> None:
    path = tmp_path / "new" / "fleet.duckdb"
    counts = {one.table: one.n_rows for one in export_duckdb(fitted_output, path)}
    assert list(counts) == [table.name for table in TABLES]
    with duckdb.connect(str(path), read_only=True) as file:
        for table in TABLES:
            rows = [read_table(one, table) for one in files_of(fitted_output, table)]
            expected = pl.concat([frame(table, []), *rows])
            found = file.table(table.name)
            assert found.columns == list(table.schema)
            assert found.count("*").fetchall() == [(expected.height,)]
            assert counts[table.name] == expected.height
        primary = file.execute("SELECT count(*) FROM leakage").fetchall()
        assert primary == file.execute("SELECT count(*) FROM fits WHERE is_primary").fetchall()
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_a_damaged_table_leaves_the_file_before(tmp_path: Path) -> None:
    output, path = tmp_path / "out", tmp_path / "fleet.duckdb"
    table = table_folder(output, INPUT_FILES) / "month=2026-01" / "2026-01-02.parquet"
    write_table(table, frame(INPUT_FILES, []))
    list(export_duckdb(output, path))
    before = path.read_bytes()
    table.write_bytes(b"junk")
    with pytest.raises(StoreError, match="damaged"):
        list(export_duckdb(output, path))
    assert path.read_bytes() == before
    assert sorted(one.name for one in tmp_path.iterdir()) == ["fleet.duckdb", "out"]


def test_places_that_are_refused(tmp_path: Path) -> None:
    folder = table_folder(tmp_path / "out", FITS)
    with pytest.raises(UsageError, match="no tables"):
        list(export_duckdb(tmp_path / "out", tmp_path / "x.duckdb"))
    folder.mkdir(parents=True)
    for path in (tmp_path, folder / "x.duckdb"):
        with refused("duckdb_file"):
            list(export_duckdb(tmp_path / "out", path))

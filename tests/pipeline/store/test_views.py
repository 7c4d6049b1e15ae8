"""Views of all tables: they hold on an empty output, and on one of an older version."""

from __future__ import annotations

from pathlib import Path

import duckdb
import pytest

from pipeline.schema import TABLES
from pipeline.store.publishing import VIEWS, write_views


def opened(output: Path, monkeypatch: pytest.MonkeyPatch) -> duckdb.DuckDBPyConnection:
    """As `duckdb -init views.sql` in the output folder."""
    monkeypatch.chdir(output)
    connection = duckdb.connect()
    connection.execute(Path(VIEWS).read_text("utf-8"))
    return connection


def test_views_on_an_empty_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_views(tmp_path)
    with opened(tmp_path, monkeypatch) as connection:
        for table in TABLES:
            view = connection.table(table.name)
            assert (view.columns, view.fetchall()) == (list(table.schema), [])


def test_types_of_an_empty_view_are_those_of_its_files(
    tmp_path: Path, fitted_output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_views(tmp_path)
    with opened(tmp_path, monkeypatch) as empty, opened(fitted_output, monkeypatch) as full:
        for table in TABLES:
            assert empty.table(table.name).types == full.table(table.name).types, table.name

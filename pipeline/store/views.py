"""Views of all tables for DuckDB: `views.sql` in the output, made from the schema."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import polars as pl

from pipeline.schema import TABLES, TIMESTAMP, Table
from pipeline.store.atomic_files import put
from pipeline.store.tables import ENDING, files_of, table_folder

NAME = "views.sql"
TYPES = {
    pl.String: "VARCHAR",
    pl.Int64: "BIGINT",
    pl.Float64: "DOUBLE",
    pl.Float32: "FLOAT",
    pl.Boolean: "BOOLEAN",
    pl.Date: "DATE",
    TIMESTAMP: "TIMESTAMPTZ",
}


def write_views(output: Path) -> None:
    """Write `views.sql`, with paths relative to its folder.

    Raises StoreError if it cannot be written.
    """
    head = f"-- Views of all tables; made by each run. In this folder: duckdb -init {NAME}\n"
    tables = (_view(output, table) for table in TABLES)
    text = "\n".join([head, *tables, *_comments(TABLES)]) + "\n"
    if not (output / NAME).exists() or (output / NAME).read_text("utf-8") != text:
        put(output / NAME, text.encode())


def _view(output: Path, table: Table) -> str:
    """Return statement that makes a table's view; one without a file yet has no rows."""
    files = f"{table_folder(Path(), table).as_posix()}/**/*{ENDING}"
    how = "union_by_name = true, hive_partitioning = false"
    rows = f"SELECT * FROM read_parquet('{files}', {how})"
    if not files_of(output, table):
        columns = ", ".join(f"NULL::{kind} AS {name}" for name, kind in _columns(table))
        rows = f"SELECT {columns} WHERE false"
    return f"CREATE OR REPLACE VIEW {table.name} AS {rows};"


def _columns(table: Table) -> Iterator[tuple[str, str]]:
    """Yield columns of a table with DuckDB's names of their types."""
    for name, kind in table.schema.items():
        yield f'"{name}"', _type(kind)


def _type(kind: object) -> str:
    if isinstance(kind, pl.List):
        return f"{_type(kind.inner)}[]"
    if isinstance(kind, pl.Struct):
        return f"STRUCT({', '.join(f'{field.name} {_type(field.dtype)}' for field in kind.fields)})"
    return next(text for known, text in TYPES.items() if kind == known)


def _comments(tables: Iterable[Table]) -> Iterator[str]:
    """Yield statements with the words of the dictionary, for views that are there."""
    for table in tables:
        yield f"COMMENT ON VIEW {table.name} IS {_text(f'One row is {table.row}')};"
        for column in table.columns:
            unit = f" [{column.unit}]" if column.unit else ""
            words = _text(f"{column.description}{unit}")
            yield f'COMMENT ON COLUMN {table.name}."{column.name}" IS {words};'


def _text(words: str) -> str:
    """Return a text of SQL."""
    return "'" + words.replace("'", "''") + "'"

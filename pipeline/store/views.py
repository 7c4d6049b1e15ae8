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
# Views of what is asked for most, with their words; each may use those above it.
JOINS = {
    "primary_fits": (
        "Fits in the configured flushing mode: one a motor and night",
        "SELECT * FROM fits WHERE is_primary",
    ),
    "primary_parameters": (
        "Parameters of these fits",
        "SELECT * FROM parameters SEMI JOIN primary_fits USING (motor_id, night, flushing_mode)",
    ),
    "leakage": (
        "The two leakages of every motor and night, at the reference conditions and at the "
        "motor's own fixed ones, with status, state, and the reason where one is missing",
        """SELECT motor_id, night, fits.status, watch.state,
       watch.reference_leakage_l_per_min, watch.reference_leakage_lower,
       watch.reference_leakage_upper,
       watch.own_leakage_l_per_min, watch.own_leakage_lower, watch.own_leakage_upper,
       coalesce(fits.reason,
                CASE WHEN watch.own_leakage_l_per_min IS NULL THEN watch.sentence END,
                CASE WHEN watch.reference_leakage_l_per_min IS NULL THEN fits.reference_reason END
       ) AS reason
FROM primary_fits AS fits LEFT JOIN watch USING (motor_id, night)""",
    ),
    "tonight": (
        "Trends of each motor in its newest night",
        "SELECT * FROM trends QUALIFY night = max(night) OVER (PARTITION BY motor_id)",
    ),
}


def write_views(output: Path) -> None:
    """Write `views.sql`, with paths relative to its folder.

    Raises StoreError if it cannot be written.
    """
    head = f"-- Views of all tables; made by each run. In this folder: duckdb -init {NAME}\n"
    tables = (_view(output, table) for table in TABLES)
    text = "\n".join([head, *tables, *_words(TABLES)]) + "\n"
    if not (output / NAME).exists() or (output / NAME).read_text("utf-8") != text:
        put(output / NAME, text.encode())


def _view(output: Path, table: Table) -> str:
    """Statement that makes a table's view; one without a file yet has no rows."""
    files = f"{table_folder(Path(), table).as_posix()}/**/*{ENDING}"
    how = "union_by_name = true, hive_partitioning = false"
    rows = f"SELECT * FROM read_parquet('{files}', {how})"
    if not files_of(output, table):
        columns = ", ".join(f"NULL::{kind} AS {name}" for name, kind in _columns(table))
        rows = f"SELECT {columns} WHERE false"
    return f"CREATE OR REPLACE VIEW {table.name} AS {rows};"


def _columns(table: Table) -> Iterator[tuple[str, str]]:
    """Columns of a table with DuckDB's names of their types."""
    for name, kind in table.schema.items():
        inner = kind.inner if isinstance(kind, pl.List) else kind
        known = next(text for one, text in TYPES.items() if inner == one)
        yield f'"{name}"', f"{known}[]" if isinstance(kind, pl.List) else known


def _words(tables: Iterable[Table]) -> Iterator[str]:
    """Statements for views that are there: the common joins, and the words of the dictionary."""
    for name, (_, query) in JOINS.items():
        yield f"CREATE OR REPLACE VIEW {name} AS {query};"
    for table in tables:
        yield f"COMMENT ON VIEW {table.name} IS {_text(f'One row is {table.row}')};"
        for column in table.columns:
            unit = f" [{column.unit}]" if column.unit else ""
            words = _text(f"{column.description}{unit}")
            yield f'COMMENT ON COLUMN {table.name}."{column.name}" IS {words};'
    for name, (words, _) in JOINS.items():
        yield f"COMMENT ON VIEW {name} IS {_text(words)};"


def _text(words: str) -> str:
    """A text of SQL."""
    return "'" + words.replace("'", "''") + "'"

"""All tables in one DuckDB file, with the views and the words of `views.sql`."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from pipeline.errors import StoreError, UsageError
from pipeline.export import Exported
from pipeline.schema import TABLES, Table
from pipeline.store.atomic_files import TEMPORARY_PREFIX, Prepared, make_folders, remove_leftovers
from pipeline.store.tables import existing_tables, files_of, read_table, while_listed
from pipeline.store.views import columns_of, statements_of

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


def export_duckdb(output: Path, path: Path) -> Iterator[Exported]:
    """Write a DuckDB file whole or not at all; it is there after the last table is told.

    Raises UsageError (``duckdb_missing``, ``no_tables``, ``duckdb_file``) without the extra or
    tables, or if the file is a folder or lies within the tables; StoreError if a table cannot be
    read, or the file not be written.
    """
    try:
        import duckdb
    except ImportError as error:
        raise UsageError(
            "duckdb_missing", f"--duckdb needs the extra `duckdb` ({error}): motor-leakage[duckdb]"
        ) from error
    tables = existing_tables(output)
    if path.is_dir() or path.resolve().is_relative_to(tables.resolve()):
        raise UsageError(
            "duckdb_file", f"{path} is a folder or lies within the tables; name another file"
        )
    new = Prepared(path, path.parent / f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}", "")
    try:
        make_folders(path.parent)
        remove_leftovers([path.parent], below=False)
        with duckdb.connect(str(new.temporary)) as connection:
            for table in TABLES:
                columns = ", ".join(f"{name} {kind}" for name, kind in columns_of(table))
                connection.execute(f"CREATE TABLE {table.name} ({columns})")
                count = while_listed(partial(_fill, connection, output, table))
                yield Exported(table.name, table.name, count)
            connection.execute("\n".join(statements_of(TABLES, "TABLE")))
        new.land()
    except (duckdb.Error, OSError) as error:
        raise StoreError("store_write", f"{path} cannot be written: {error}") from error
    finally:
        new.drop()


def _fill(connection: DuckDBPyConnection, output: Path, table: Table) -> int:
    """Fill a table, file after file: memory does not grow with the history."""
    connection.execute(f"DELETE FROM {table.name}")
    count = 0
    for path in files_of(output, table):
        rows = read_table(path, table).to_arrow(compat_level=pl.CompatLevel.oldest())
        connection.register("rows", rows)
        connection.execute(f"INSERT INTO {table.name} BY NAME SELECT * FROM rows")
        count += rows.num_rows
    return count

"""Tables as Delta Lake tables: each export is one transaction and a new version of a table."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import polars as pl
import pyarrow as pa

from pipeline.config.fleet import is_url
from pipeline.errors import StoreError, UsageError
from pipeline.schema import TABLES, Table
from pipeline.store.object_store import ObjectStore
from pipeline.store.tables import OF_ARROW, existing_tables, files_of, read_table


def export_delta(
    output: Path, place: str, tables: tuple[Table, ...] = TABLES
) -> Iterator[tuple[str, int, int]]:
    """Write tables as Delta Lake tables below a folder or URL; those there get a new version.

    A table without a file yet is left out. Yields place, version and number of rows of each.

    Raises UsageError (``delta_missing``, ``no_tables``, ``delta_folder``) without the extra or
    tables, or if the place lies within them; StoreError if a table cannot be read or written.
    """
    try:
        from deltalake import DeltaTable, write_deltalake
        from deltalake.exceptions import DeltaError
    except ImportError as error:
        raise UsageError(
            "delta_missing", f"--delta needs the extra `delta` ({error}): motor-leakage[delta]"
        ) from error
    root = existing_tables(output)
    if is_url(place):
        ObjectStore.at(place)  # for its words on credentials
    elif Path(place).resolve().is_relative_to(root.resolve()):
        raise UsageError("delta_folder", f"{place} lies within the tables; name another folder")
    for table in tables:
        target = f"{place.rstrip('/')}/{table.name}"
        paths = files_of(output, table)
        if not paths:
            continue
        try:
            write_deltalake(
                target,
                _rows(paths, table),
                mode="overwrite",
                schema_mode="overwrite",
                description=f"One row is {table.row}",
            )
            written = DeltaTable(target)
        except (DeltaError, OSError) as error:
            raise StoreError("store_write", f"{target} cannot be written: {error}") from error
        yield target, written.version(), written.count()


def _rows(paths: list[Path], table: Table) -> pa.RecordBatchReader:
    """The rows file after file: memory does not grow with the history."""
    schema = pl.DataFrame(schema=table.schema).to_arrow(compat_level=OF_ARROW).schema
    batches = (
        batch
        for path in paths
        for batch in read_table(path, table).to_arrow(compat_level=OF_ARROW).to_batches()
    )
    return pa.RecordBatchReader.from_batches(schema, batches)

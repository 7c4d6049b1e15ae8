"""Rows as Parquet files: encoded, and decoded with the checksums of their pages."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError
from pipeline.schema import SCHEMA_VERSION, Table
from pipeline.store.atomic_files import put

VERSION_KEY = "motor_leakage_schema_version"
# Rows of a row group: a reader of some motors or nights leaves the others out.
ROWS_A_GROUP = 16_384
# Sizes of packed columns tell one state of a file from another: an engine that opens a file before
# and after it is replaced finds no pages where the old footer has them. With Snappy, which is three
# times as quick, columns of as many numbers are often of one size.
OF_ARROW = pl.CompatLevel.oldest()  # its types, not those of Polars alone
COMPRESSION = "zstd"
# Raised by reading a damaged file; a damaged name gives UnicodeDecodeError, a ValueError.
DAMAGE = (OSError, ValueError, pa.ArrowException, PolarsError, PanicException)


def write_table(path: Path, rows: pl.DataFrame) -> str:
    """Write a table file whole or not at all, and return its SHA-256; raises StoreError."""
    return put(path, as_parquet(rows))


def as_parquet(rows: pl.DataFrame) -> bytes:
    """Rows as the bytes of a Parquet file."""
    stream, rows = pa.BufferOutputStream(), rows.rechunk()
    schema = rows.clear().to_arrow(compat_level=OF_ARROW).schema
    with pq.ParquetWriter(
        stream,
        schema,
        compression=COMPRESSION,
        use_dictionary=[one.name for one in schema if pa.types.is_large_string(one.type)],
        write_page_checksum=True,
        store_schema=False,
    ) as file:
        # One at a time: Arrow's strings are copies.
        for group in rows.iter_slices(ROWS_A_GROUP) if len(rows) else [rows]:
            file.write_table(group.to_arrow(compat_level=OF_ARROW), row_group_size=ROWS_A_GROUP)
        # Metadata of the schema would be left out with it.
        file.add_key_value_metadata({VERSION_KEY: str(SCHEMA_VERSION)})
    encoded: bytes = stream.getvalue().to_pybytes()
    return encoded


def from_parquet(
    path: Path,
    table: Table,
    content: bytes,
    columns: Sequence[str] = (),
    wanted: Mapping[str, Collection[Any]] | None = None,
) -> pl.DataFrame:
    """Rows of a table file's content, with some columns, and some values of others.

    Columns that an older version lacks are null.

    Raises StoreError if the file is damaged (``store_read``), or of a newer version of the program
    (``store_newer``).
    """
    chosen = {name: table.schema[name] for name in columns or table.schema}
    read = {name: table.schema[name] for name in {**chosen, **(wanted or {})}}
    try:
        with pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True) as file:
            _require_known(path, table, file)
            there = [name for name in read if name in file.schema_arrow.names]
            groups = [
                place
                for place in range(file.num_row_groups)
                if all(_may_hold(file, place, *one) for one in (wanted or {}).items())
            ]
            rows = pl.from_arrow(file.read_row_groups(groups, columns=there, use_threads=False))
        assert isinstance(rows, pl.DataFrame)
        if rows.schema != {name: read[name] for name in there}:
            raise ValueError("its columns have other types")
        rows = rows.with_columns(
            pl.lit(None, dtype=read[name]).alias(name) for name in read if name not in there
        )
        for name, values in (wanted or {}).items():
            rows = rows.filter(pl.col(name).is_in(list(values)))
        return rows.select(chosen.keys()).rechunk()
    except DAMAGE as error:
        raise damaged(path, table, error) from error


def _may_hold(file: pq.ParquetFile, place: int, name: str, values: Collection[Any]) -> bool:
    """Whether a row group may have one of some values in a column; each has one leaf."""
    if file.num_row_groups == 1:
        return True
    column = file.metadata.row_group(place).column(file.schema_arrow.get_field_index(name))
    known = column.statistics
    if known is None or not known.has_min_max:
        return True
    return any(known.min <= one <= known.max for one in values)


def _require_known(path: Path, table: Table, file: pq.ParquetFile) -> None:
    """Raise StoreError (``store_newer``) or ValueError for a file with unknown columns."""
    version = int((file.metadata.metadata or {}).get(VERSION_KEY.encode(), b"0"))
    if version > SCHEMA_VERSION:
        # This version of the program would lose its new columns.
        raise StoreError(
            "store_newer", f"{path.name} is of schema version {version}; update the program"
        )
    names = set(file.schema_arrow.names)
    strange, absent = sorted(names - table.schema.keys()), sorted(set(table.key) - names)
    if strange or absent:  # a damaged name would read as a column of nulls
        raise ValueError(
            f"it has schema version {version}, with unknown columns "
            f"({', '.join(strange) or 'none'}) or without some of the key "
            f"({', '.join(absent) or 'none'}); expected version {SCHEMA_VERSION}: "
            "`fit-fleet --force` makes it anew from the logs"
        )


def damaged(path: Path, table: Table, error: BaseException | str) -> StoreError:
    """The error of a damaged file."""
    return StoreError("store_read", f"{path.name} of {table.name} is damaged: {error}")

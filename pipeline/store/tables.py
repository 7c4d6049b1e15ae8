"""Tables on disk: Parquet files of a month, or of a night, each replaced whole or not at all.

A file that is damaged, or of a newer version of the program, raises StoreError; columns that an
older file lacks are null.
"""

from __future__ import annotations

import datetime as dt
from calendar import monthrange
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError, UsageError
from pipeline.schema import NIGHTLY_TABLES, SCHEMA_VERSION, Table

MONTH_PREFIX = "month="
ENDING = ".parquet"
VERSION_KEY = "motor_leakage_schema_version"
# Rows of a row group: a reader of some motors or nights leaves the others out.
ROWS_A_GROUP = 16_384
# Sizes of packed columns tell states of a file apart: an engine that opens a file before
# and after it is replaced finds no pages where the old footer has them. With Snappy, which is three
# times as quick, columns of as many numbers are often of the same size.
COMPRESSION = "zstd"
OF_ARROW = pl.CompatLevel.oldest()  # its types, not those of Polars alone
# Raised by reading a damaged file; a damaged name gives UnicodeDecodeError, a ValueError.
DAMAGE = (OSError, ValueError, pa.ArrowException, PolarsError, PanicException)


def existing_tables(output: Path) -> Path:
    """Return folder of all tables.

    Raises UsageError (``no_tables``) if there are none.
    """
    tables = output / "tables"
    if not tables.is_dir():
        raise UsageError("no_tables", f"there are no tables in {output}; run fit-fleet first")
    return tables


def table_folder(output: Path, table: Table) -> Path:
    """Return folder of a table."""
    return output / "tables" / table.name


def whole_file(output: Path, table: Table) -> Path:
    """Return file of a table that is a single file."""
    return table_folder(output, table) / f"{table.name}{ENDING}"


def label_of(table: Table, night: dt.date) -> str:
    """Name of the file that has a night: its own, YYYY-MM-DD, or that of its month, YYYY-MM."""
    return str(night) if table in NIGHTLY_TABLES else f"{night:%Y-%m}"


def labelled_file(output: Path, table: Table, label: str) -> Path:
    """Return file of a night, YYYY-MM-DD, or of a month, YYYY-MM."""
    return table_folder(output, table) / f"{MONTH_PREFIX}{label[:7]}" / f"{label}{ENDING}"


def name_of(output: Path, path: Path) -> str:
    """Return path of a file relative to the folder of the tables, as the state file names it."""
    return path.relative_to(output / "tables").as_posix()


def days_of(label: str) -> list[dt.date]:
    """Return nights of a file's name, 2026-02-03 or all of 2026-02; else raise ValueError."""
    if len(label) > len("2026-02"):
        return [dt.date.fromisoformat(label)]
    first = dt.date.fromisoformat(f"{label}-01")
    return [
        first.replace(day=number + 1) for number in range(monthrange(first.year, first.month)[1])
    ]


def _is_ours(output: Path, table: Table, path: Path) -> bool:
    """Return True for a file of a month or a night with the name and folder a run gives it."""
    try:
        return bool(days_of(path.stem)) and path == labelled_file(output, table, path.stem)
    except ValueError:
        return False


def files_of(output: Path, table: Table, nights: Collection[dt.date] | None = None) -> list[Path]:
    """Return files of a table in time order: all, or those that may have some nights."""
    whole = whole_file(output, table)
    if whole.exists():
        return [whole]
    if nights is None:
        months = _list_files(table_folder(output, table))
        paths = (path for month in months for path in _list_files(month))
        return sorted(path for path in paths if _is_ours(output, table, path))
    labels = {label_of(table, night) for night in nights}
    named = (labelled_file(output, table, label) for label in sorted(labels))
    return [path for path in named if path.exists()]


def _list_files(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        why = f"{folder.name} cannot be listed: {error.strerror}"
        raise StoreError("store_read", why) from error


def nights_back(output: Path, table: Table) -> Iterator[dt.date]:
    """Yield nights of a table, the newest first; a night with its own file may have no rows."""
    for path in reversed(files_of(output, table)):
        if len(path.stem) > len("2026-02"):
            yield dt.date.fromisoformat(path.stem)
        else:
            yield from _nights_in(path, table, path.stat().st_mtime_ns)


@lru_cache(maxsize=512)
def _nights_in(path: Path, table: Table, _: int) -> tuple[dt.date, ...]:
    """Return nights of a file that was last changed at a time; a process asks for each motor."""
    nights = read_table(path, table, columns=("night",))["night"]
    return tuple(nights.drop_nulls().unique().sort(descending=True))


def read_table(
    path: Path,
    table: Table,
    columns: Sequence[str] = (),
    wanted: Mapping[str, Collection[Any]] | None = None,
) -> pl.DataFrame:
    """Return rows of a table file: all or some columns, with wanted values in others."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise damaged(path, table, error) from error
    return from_parquet(path, table, content, columns, wanted)


def read_rows(
    output: Path,
    table: Table,
    motor_ids: Sequence[str],
    columns: Sequence[str] = (),
    nights: Collection[dt.date] | None = None,
) -> pl.DataFrame:
    """Return published rows of some motors in time order, of all nights or some."""
    empty = pl.DataFrame(schema=table.schema).select(columns or pl.all())
    wanted: dict[str, Collection[Any]] = {"motor_id": motor_ids}
    if nights is not None:
        wanted["night"] = nights
    paths = files_of(output, table, nights) if all(wanted.values()) else []
    return pl.concat([empty, *(read_table(path, table, columns, wanted) for path in paths)])


def as_parquet(rows: pl.DataFrame) -> bytes:
    """Return rows as the bytes of a Parquet file."""
    stream, rows = pa.BufferOutputStream(), rows.rechunk()
    schema = rows.clear().to_arrow(compat_level=OF_ARROW).schema
    with pq.ParquetWriter(
        stream,
        schema,
        compression=COMPRESSION,
        use_dictionary=[field.name for field in schema if pa.types.is_large_string(field.type)],
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
    """Return rows of a table file's content, as `read_table`."""
    schema = table.schema
    chosen = list(columns or schema)
    read = {name: schema[name] for name in dict.fromkeys((*chosen, *(wanted or ())))}
    try:
        with pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True) as file:
            names = _known_names(path, table, file)
            there = [name for name in read if name in names]
            groups = [
                place
                for place in range(file.num_row_groups)
                if all(_may_hold(file, place, *entry) for entry in (wanted or {}).items())
            ]
            rows = pl.from_arrow(file.read_row_groups(groups, columns=there, use_threads=False))
        assert isinstance(rows, pl.DataFrame)
        if rows.schema != {name: read[name] for name in there}:
            raise ValueError("its columns have other types")
        rows = rows.with_columns(
            pl.lit(None, dtype=read[name]).alias(name) for name in read if name not in there
        )
        if wanted:
            rows = rows.filter(pl.col(name).is_in(list(some)) for name, some in wanted.items())
        return rows.select(chosen).rechunk()
    except DAMAGE as error:
        raise damaged(path, table, error) from error


def _may_hold(file: pq.ParquetFile, place: int, name: str, values: Collection[Any]) -> bool:
    """Return whether a row group may have any of some values in a column; each has one leaf."""
    if file.num_row_groups == 1:
        return True
    column = file.metadata.row_group(place).column(file.schema_arrow.get_field_index(name))
    known = column.statistics
    is_known = known is not None and known.has_min_max
    return not is_known or any(known.min <= value <= known.max for value in values)


def _known_names(path: Path, table: Table, file: pq.ParquetFile) -> set[str]:
    """Return names of a file's columns; raises StoreError (``store_newer``) or ValueError."""
    version = int((file.metadata.metadata or {}).get(VERSION_KEY.encode(), b"0"))
    if version > SCHEMA_VERSION:  # whose new columns would be lost
        why = f"{path.name} is of schema version {version}; update the program"
        raise StoreError("store_newer", why)
    names = set(file.schema_arrow.names)
    strange, absent = sorted(names - table.schema.keys()), sorted(set(table.key) - names)
    if strange or absent:  # a damaged name would read as a column of nulls
        raise ValueError(
            f"it has schema version {version}, with unknown columns "
            f"({', '.join(strange) or 'none'}) or without some of the key "
            f"({', '.join(absent) or 'none'}); expected version {SCHEMA_VERSION}: "
            "`fit-fleet --redo NIGHTS` makes it anew from the logs"
        )
    return names


def damaged(path: Path, table: Table, error: BaseException | str) -> StoreError:
    """Return the error of a damaged file."""
    strerror = error.strerror if isinstance(error, OSError) else None
    how = f"cannot be read: {strerror}" if strerror else f"is damaged: {error}"
    return StoreError("store_read", f"{path.name} of {table.name} {how}")

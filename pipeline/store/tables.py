"""Tables on disk: Parquet files of a month, or of a night, each replaced whole or not at all.

Rows of a night lie together in its month's file. A reader sees a file as it was or as it is: the
checksums of its pages are compared, and the run proves files by their SHA-256.
"""

from __future__ import annotations

import datetime as dt
import os
import re
from calendar import monthrange
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow.parquet as pq

from pipeline.errors import StoreError, UsageError
from pipeline.schema import NIGHTLY_TABLES, SCHEMA_VERSION, Table
from pipeline.store.atomic_files import read
from pipeline.store.encoding import DAMAGE, VERSION_KEY, opened, row_groups

MONTH_PREFIX = "month="
# Ending of a damaged file that a run has put aside.
PUT_ASIDE = ".damaged"
ENDING = ".parquet"
MONTH_FOLDER = re.compile(r"month=\d{4}-(0[1-9]|1[0-2])")


def existing_tables(output: Path) -> Path:
    """Folder of all tables.

    Raises UsageError (``no_tables``) if there are none.
    """
    tables = output / "tables"
    if not tables.is_dir():
        raise UsageError("no_tables", f"there are no tables in {output}; run fit-fleet first")
    return tables


def table_folder(output: Path, table: Table) -> Path:
    """Folder of a table."""
    return output / "tables" / table.name


def whole_file(output: Path, table: Table) -> Path:
    """File of a table that is one file."""
    return table_folder(output, table) / f"{table.name}{ENDING}"


def month_file(output: Path, table: Table, month: str) -> Path:
    """File of a month, YYYY-MM."""
    return table_folder(output, table) / f"{MONTH_PREFIX}{month}" / f"{month}{ENDING}"


def night_file(output: Path, table: Table, night: dt.date) -> Path:
    """File that has a night: its own, or that of its month."""
    path = month_file(output, table, f"{night:%Y-%m}")
    return path.with_name(f"{night}{ENDING}") if table in NIGHTLY_TABLES else path


def name_of(output: Path, path: Path) -> str:
    """Path of a file relative to the folder of the tables, as the state file names it."""
    return path.relative_to(output / "tables").as_posix()


def days_of(label: str) -> list[dt.date]:
    """Nights that a file's name says: one, or all of a month.

    Raises
    ------
    ValueError
        If it is neither.

    Examples
    --------
    >>> days_of("2026-02-03"), len(days_of("2026-02"))
    ([datetime.date(2026, 2, 3)], 28)
    """
    if len(label) == len("2026-02"):
        first = dt.date.fromisoformat(f"{label}-01")
        return [first.replace(day=one + 1) for one in range(monthrange(first.year, first.month)[1])]
    return [dt.date.fromisoformat(label)]


def files_of(
    output: Path, table: Table, nights: Collection[dt.date] | None = None, month: str = "*"
) -> list[Path]:
    """Files of a table in time order: all, or those of a month (YYYY-MM), or of some nights.

    Files of other names are left out.
    """
    whole = whole_file(output, table)
    if whole.exists():
        return [whole]
    months = month_stamps(output, table) if month == "*" else [month]
    asked = None if nights is None else {part for one in nights for part in _labels_of(one)}
    return [
        path
        for one in sorted(months)
        if asked is None or one in asked
        for path in _files_in(month_file(output, table, one).parent, one)
        if asked is None or path.stem in asked
    ]


def _labels_of(night: dt.date) -> tuple[str, str]:
    """Names that a file with a night may have."""
    return f"{night:%Y-%m}", str(night)


def _files_in(folder: Path, month: str) -> Iterator[Path]:
    for name in sorted(entry.name for entry in _entries(folder)):
        label = name.removesuffix(ENDING)
        if name.endswith(ENDING) and _is_of(label, month):
            yield folder / name


def _is_of(label: str, month: str) -> bool:
    try:
        return label == month or _labels_of(dt.date.fromisoformat(label)) == (month, label)
    except ValueError:
        return False


def nights_back(output: Path, table: Table) -> Iterator[dt.date]:
    """Nights of a table, the newest first; one with a file of its own may have no rows.

    Raises StoreError if a file is damaged.
    """
    for path in reversed(files_of(output, table)):
        if len(path.stem) > len("2026-02"):
            yield dt.date.fromisoformat(path.stem)
        else:
            yield from _nights_in(path, table, path.stat().st_mtime_ns)


@lru_cache(maxsize=512)
def _nights_in(path: Path, table: Table, _: int) -> tuple[dt.date, ...]:
    """Nights of a file that was last changed at a time; a process asks for each motor."""
    nights = read_table(path, table, columns=("night",))["night"]
    return tuple(nights.drop_nulls().unique().sort(descending=True))


def month_stamps(output: Path, table: Table) -> dict[str, int]:
    """Time of the last change of each month's folder of a table, by YYYY-MM [ns].

    It changes whenever a file is added, replaced or removed.
    """
    return {
        entry.name.removeprefix(MONTH_PREFIX): entry.stat().st_mtime_ns
        for entry in _entries(table_folder(output, table))
        if MONTH_FOLDER.fullmatch(entry.name)
    }


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise StoreError(
            "store_read", f"{folder.name} cannot be listed: {error.strerror}"
        ) from error


def read_table(
    path: Path,
    table: Table,
    nights: Collection[dt.date] | None = None,
    columns: Sequence[str] = (),
) -> pl.DataFrame:
    """Rows of a table file, or of some nights in it; columns that an older version lacks are null.

    Raises StoreError if the file is damaged (``store_read``), or of a newer version of the program
    (``store_newer``).
    """
    wanted = {} if nights is None else {"night": nights}
    return _rows(path, table, wanted, list(columns or table.schema))


def read_rows(
    output: Path,
    table: Table,
    motor_ids: Sequence[str],
    columns: Sequence[str] = (),
    month: str = "*",
    nights: Collection[dt.date] | None = None,
) -> pl.DataFrame:
    """The published rows of some motors in all files of a table, or in some of them.

    Parameters
    ----------
    output, table
        Output folder and table.
    motor_ids
        Motors.
    columns
        Columns; all if none. Those that an older file lacks are null.
    month
        YYYY-MM; all by default.
    nights
        Labels; None: all.

    Returns
    -------
    polars.DataFrame
        In no particular order.

    Raises
    ------
    StoreError
        If a file is damaged.
    """
    chosen = list(columns or table.schema)
    wanted: dict[str, Collection[Any]] = {"motor_id": motor_ids}
    if nights is not None:
        wanted["night"] = nights
    found = [pl.DataFrame(schema={name: table.schema[name] for name in chosen})]
    if all(wanted.values()):
        paths = files_of(output, table, nights, month)
        found += [_rows(path, table, wanted, chosen) for path in paths]
    return pl.concat(found)


def _rows(
    path: Path, table: Table, wanted: Mapping[str, Collection[Any]], columns: Sequence[str]
) -> pl.DataFrame:
    """Rows of a file with wanted values, some columns of them; raises as `read_table`."""
    try:
        content = read(path)
    except OSError as error:
        raise damaged(path, table, error) from error
    names = [*columns, *(name for name in wanted if name not in columns)]
    found = [pl.DataFrame(schema={name: table.schema[name] for name in columns})]
    chosen = [pl.col(name).is_in(list(values)) for name, values in wanted.items()]
    groups = groups_of(path, table, content, names, wanted)
    found += [rows.filter(chosen).select(columns) if chosen else rows for rows in groups]
    return pl.concat(found, rechunk=True)


def groups_of(
    path: Path,
    table: Table,
    content: bytes,
    columns: Sequence[str] = (),
    wanted: Mapping[str, Collection[Any]] | None = None,
) -> Iterator[pl.DataFrame]:
    """Row groups of a table file's content, as `row_groups`; raises as `read_table`."""
    schema = {name: table.schema[name] for name in columns or table.schema}
    try:
        with opened(content) as file:
            require_known(path, table, file)
            there = [name for name in schema if name in file.schema_arrow.names]
            absent = [
                pl.lit(None, dtype=kind).alias(name)
                for name, kind in schema.items()
                if name not in there
            ]
            for rows in row_groups(file, there, wanted):
                yield rows.with_columns(absent).select(schema.keys()).cast(pl.Schema(schema))
    except DAMAGE as error:
        raise damaged(path, table, error) from error


def require_known(path: Path, table: Table, file: pq.ParquetFile) -> int:
    """Schema version of a table file, whose columns are known.

    Raises StoreError (``store_newer``) or ValueError.
    """
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
    return version


def damaged(path: Path, table: Table, error: BaseException) -> StoreError:
    """The error of a damaged file."""
    return StoreError("store_read", f"{path.name} of {table.name} is damaged: {error}")

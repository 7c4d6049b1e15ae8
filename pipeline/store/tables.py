"""Tables on disk: one Parquet file for each table and night, replaced whole or not at all.

Nights of a month that is long over are joined in one file (`pipeline/store/months.py`).
"""

from __future__ import annotations

import datetime as dt
import hashlib
import logging
import os
import re
from calendar import monthrange
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import polars as pl

from pipeline.errors import StoreError, UsageError
from pipeline.schema import SCHEMA_VERSION, Table
from pipeline.store.atomic_files import read
from pipeline.store.encoding import DAMAGE, VERSION_KEY, from_parquet, parts_of
from pipeline.store.manifest import MONTH_PREFIX, Manifest, manifest_key, read_manifest

log = logging.getLogger(__name__)

Made = TypeVar("Made")

# Most tries to read files that were listed and are gone.
TIMES_LISTED = 3
# Ending of a damaged file that a run has put aside.
PUT_ASIDE = ".damaged"
UNREADABLE = "unreadable"
ENDING = ".parquet"
# Files that are decoded together; more would take memory and save no time.
FILES_AT_ONCE = 32
MONTH_FOLDER = re.compile(r"month=\d{4}-(0[1-9]|1[0-2])")


def files_of(output: Path, table: Table) -> list[Path]:
    """All files of a table, in time order."""
    return sorted(table_folder(output, table).rglob(f"*{ENDING}"))


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


def night_file(output: Path, table: Table, night: dt.date) -> Path:
    """File of a table's night."""
    return table_folder(output, table) / f"month={night:%Y-%m}" / f"{night}.parquet"


def month_file(output: Path, table: Table, month: str) -> Path:
    """File of a table's joined month, YYYY-MM."""
    return table_folder(output, table) / f"{MONTH_PREFIX}{month}" / f"{month}{ENDING}"


def place_of(output: Path, table: Table, night: dt.date) -> Path | None:
    """File with a table's night, its own or that of its joined month; None without one."""
    places = (night_file(output, table, night), month_file(output, table, f"{night:%Y-%m}"))
    return next((path for path in places if path.exists()), None)


def nights_back(output: Path, table: Table) -> Iterator[dt.date]:
    """Nights of a table's files, the newest first; a night may have no rows."""
    months = (entry.name for entry in _entries(table_folder(output, table)))
    for month in sorted(months, reverse=True):
        yield from sorted(
            night_paths(output, table, month.removeprefix(MONTH_PREFIX)), reverse=True
        )


def night_paths(output: Path, table: Table, month: str = "*") -> dict[dt.date, Path]:
    """Files of a table by night, in time order; files of other names are left out."""
    folder = table_folder(output, table)
    months = [f"{MONTH_PREFIX}{month}"]
    if month == "*":
        months = [entry.name for entry in _entries(folder)]
    found = [
        (night, folder / name / entry.name)
        for name in months
        for entry in _entries(folder / name)
        if entry.name.endswith(ENDING)
        for label in _labels(folder / name / entry.name)
        if (night := night_named(f"{label}{ENDING}")) and name == f"{MONTH_PREFIX}{night:%Y-%m}"
    ]
    return dict(sorted(found))


def _labels(path: Path) -> Iterable[str]:
    """Nights of a file by its name, or by its footer if it is that of a month."""
    return parts_of(path) if path.parent.name == f"{MONTH_PREFIX}{path.stem}" else (path.stem,)


def night_named(name: str) -> dt.date | None:
    """The night in the name of a table's file; None without one."""
    try:
        night = dt.date.fromisoformat(name.removesuffix(ENDING))
    except ValueError:
        return None
    return night if name == f"{night}{ENDING}" else None


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


def month_stamps(output: Path, table: Table) -> dict[str, int]:
    """Time of the last change of each month's folder of a table, by YYYY-MM [ns].

    It changes whenever a file is added, replaced or removed.
    """
    return {
        entry.name.removeprefix(MONTH_PREFIX): entry.stat().st_mtime_ns
        for entry in _entries(table_folder(output, table))
        if MONTH_FOLDER.fullmatch(entry.name)
    }


def night_stamps(output: Path, table: Table, month: str) -> dict[str, str]:
    """Size, time and inode of each night's file of a month, as text: another file differs."""
    found: dict[str, str] = {}
    folder = table_folder(output, table) / f"{MONTH_PREFIX}{month}"
    for entry in _entries(folder):
        night = night_named(entry.name)
        if entry.name == f"{month}{ENDING}" or (night and f"{night:%Y-%m}" == month):
            state = entry.stat()
            stamp = f"{state.st_size:x}.{state.st_mtime_ns:x}.{state.st_ino:x}"
            found |= dict.fromkeys(_labels(folder / entry.name), stamp)
    return found


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


def read_table(path: Path, table: Table, nights: Collection[dt.date] | None = None) -> pl.DataFrame:
    """Rows of a table file; columns that an older version lacks are null.

    Of a joined file those of some nights alone, if they are named.

    Raises StoreError if the file is damaged (``store_read``), or of a newer version of the program
    (``store_newer``).
    """
    try:
        content = read(path)
    except OSError as error:
        raise damaged(path, table, error) from error
    return decode(path, table, content, None if nights is None else {str(one) for one in nights})


def decode(
    path: Path, table: Table, encoded: bytes, names: Collection[str] | None = None
) -> pl.DataFrame:
    """Rows of a table file's content; raises as `read_table`."""
    try:
        rows, _ = rows_and_version(path, table, encoded, names)
        absent = [
            pl.lit(None, dtype=kind).alias(name)
            for name, kind in table.schema.items()
            if name not in rows.columns
        ]
        return rows.with_columns(absent).select(table.schema.keys()).cast(pl.Schema(table.schema))
    except DAMAGE as error:
        raise damaged(path, table, error) from error


def rows_and_version(
    path: Path, table: Table, encoded: bytes, names: Collection[str] | None = None
) -> tuple[pl.DataFrame, int]:
    """Rows of a table file, and its schema version."""
    content = from_parquet(encoded, names)
    version = int((content.schema.metadata or {}).get(VERSION_KEY.encode(), b"0"))
    if version > SCHEMA_VERSION:
        # This version of the program would lose its new columns.
        raise StoreError(
            "store_newer", f"{path.name} is of schema version {version}; update the program"
        )
    strange = sorted(set(content.column_names) - table.schema.keys())
    absent = sorted(set(table.key) - set(content.column_names))
    if strange or absent:  # a damaged name would read as a column of nulls
        raise ValueError(
            f"it has schema version {version}, with unknown columns "
            f"({', '.join(strange) or 'none'}) or without some of the key "
            f"({', '.join(absent) or 'none'}); expected version {SCHEMA_VERSION}: "
            "`fit-fleet --force` makes it anew from the logs"
        )
    rows = pl.from_arrow(content)
    assert isinstance(rows, pl.DataFrame)
    return rows, version


def damaged(path: Path, table: Table, error: BaseException) -> StoreError:
    """The error of a damaged file."""
    return StoreError("store_read", f"{path.name} of {table.name} is damaged: {error}")


def read_rows(
    output: Path,
    table: Table,
    motor_ids: Sequence[str],
    columns: Sequence[str] = (),
    month: str = "*",
    nights: Collection[dt.date] | None = None,
) -> pl.DataFrame:
    """The published rows of some motors in all night files of a table, or in some of them.

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
        If a file is damaged, or is not what its manifest says.
    """
    chosen = list(columns or table.schema)
    none = pl.DataFrame(schema={name: table.schema[name] for name in chosen})
    asked: dict[str, Collection[str] | Collection[dt.date]] = {"motor_id": motor_ids}
    if nights is not None:
        asked["night"] = nights
    if not all(asked.values()):
        return none

    def read_all() -> list[pl.DataFrame]:
        found = (
            night_paths(output, table, month).values()
            if nights is None
            else by_file(output, table, nights)
        )
        paths = list(dict.fromkeys(found))
        return [
            _read_some(output, paths[at : at + FILES_AT_ONCE], table, asked, chosen)
            for at in range(0, len(paths), FILES_AT_ONCE)
        ]

    found = while_listed(read_all)
    return pl.concat(found) if found else none


def by_file(output: Path, table: Table, nights: Iterable[dt.date]) -> dict[Path, list[str]]:
    """Names of nights by the file that holds them, as far as there is one."""
    found: dict[Path, list[str]] = {}
    for night in sorted(nights):
        path = place_of(output, table, night)
        if path is not None:
            found.setdefault(path, []).append(str(night))
    return found


def while_listed(read: Callable[[], Made]) -> Made:
    """Result of a function that lists files of tables and then reads them.

    A run that joins a month meanwhile, or parts it, takes listed files away: it is called again.
    """
    for _ in range(TIMES_LISTED):
        try:
            return read()
        except StoreError as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise
    return read()


def _read_some(
    output: Path,
    paths: Sequence[Path],
    table: Table,
    asked: Mapping[str, Collection[str] | Collection[dt.date]],
    chosen: list[str],
) -> pl.DataFrame:
    """Rows of some files, in one scan: one for each takes five times as long."""
    # The scan skips row groups by the extremes of what is asked for: by a list of a hundred motors
    # it would take 30 ms more.
    near = [
        pl.col(name).is_between(pl.lit(min(some)), pl.lit(max(some)))
        for name, some in asked.items()
    ]
    wanted = [pl.col(name).is_in(list(some)) for name, some in asked.items()]
    try:
        contents = [_published_content(output, path, table) for path in paths]
        rows = pl.scan_parquet(
            contents, schema=table.schema, missing_columns="insert", extra_columns="ignore"
        )
        found = rows.filter(near).select({*chosen, *asked}).collect()
        return found.filter(wanted).select(chosen)
    except DAMAGE as error:
        if len(paths) == 1:
            raise damaged(paths[0], table, error) from error
    for path in paths:  # to name the damaged one
        _read_some(output, [path], table, asked, chosen)
    raise damaged(paths[0].parent, table, ValueError("its files do not fit together"))


def published_rows(
    output: Path, path: Path, table: Table, names: Collection[str] | None = None
) -> pl.DataFrame:
    """Rows of a file that is what its manifest says, or of some nights; raises as `read_table`."""
    try:
        content = _published_content(output, path, table)
    except OSError as error:
        raise damaged(path, table, error) from error
    return decode(path, table, content, names)


def _published_content(output: Path, path: Path, table: Table) -> bytes:
    """Content of a file, compared with its manifest if there is one."""
    name = path.relative_to(output / "tables").as_posix()
    for _ in range(2):  # a run may publish it in between
        manifest = read_manifest(output, *manifest_key(name)) or Manifest()
        content, accepted = read(path), manifest.accepted(name)
        if not accepted:
            rows_and_version(path, table, content)  # which checks its pages and names
        if not accepted or hashlib.sha256(content).hexdigest() in accepted:
            return content
    raise damaged(path, table, ValueError("it is not what its manifest says"))


def run_file(output: Path, table: Table, started: dt.datetime) -> Path:
    """File of a run, in tables that have one for each run."""
    name = f"{started:%Y%m%dT%H%M%S%fZ}.parquet"
    return table_folder(output, table) / f"month={started:%Y-%m}" / name


def day_of_run(path: Path) -> dt.date | None:
    """The day on which a run began, by its file's name; None without one."""
    try:
        return dt.date.fromisoformat(path.name[:8])
    except ValueError:
        return None

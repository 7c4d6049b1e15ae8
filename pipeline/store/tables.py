"""Tables on disk: one Parquet file for each table and night, replaced whole or not at all.

Nights of a month that is long over are joined in
one file (`pipeline/store/months.py`), night after night; its footer says which, with their rows.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
import os
import re
from bisect import bisect_right
from calendar import monthrange
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from itertools import accumulate, chain
from pathlib import Path
from typing import Any, TypeVar

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError, UsageError
from pipeline.schema import SCHEMA_VERSION, Table
from pipeline.store.atomic_files import put, read
from pipeline.store.manifest import MONTH_PREFIX, Manifest, manifest_key, read_manifest

log = logging.getLogger(__name__)

Made = TypeVar("Made")

VERSION_KEY = "motor_leakage_schema_version"
# Nights (or runs) of a joined file and their numbers of rows, in the order of its rows.
PARTS_KEY = "motor_leakage_parts"
# Joined nights share a row group up to about so many rows.
ROWS_A_GROUP = 122_880
# Zstandard takes three times as long to write and to read files of a night, and saves nothing where
# only texts have a dictionary.
COMPRESSION = "snappy"
# Most tries to read files that were listed and are gone.
TIMES_LISTED = 3
# Ending of a damaged file that a run has put aside.
PUT_ASIDE = ".damaged"
UNREADABLE = "unreadable"
ENDING = ".parquet"
# Files that are decoded together; more would take memory and save no time.
FILES_AT_ONCE = 32
MONTH_FOLDER = re.compile(r"month=\d{4}-(0[1-9]|1[0-2])")
# Raised by reading a damaged file; a damaged name gives UnicodeDecodeError, a ValueError.
DAMAGE = (OSError, ValueError, pa.ArrowException, PolarsError, PanicException)


def files_of(output: Path, table: Table) -> list[Path]:
    """All files of a table, in time order."""
    return sorted(table_folder(output, table).rglob(f"*{ENDING}"))


def existing_tables(output: Path) -> Path:
    """Folder of all tables.

    Raises
    ------
    UsageError
        ``no_tables``: there are none.
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


def parts_of(path: Path) -> dict[str, int]:
    """Numbers of rows of a file by night (or start of a run), in the order of its rows.

    Raises
    ------
    StoreError
        If its footer is damaged.
    """
    try:
        return _parts(pq.read_metadata(path)) or {path.stem: 0}
    except DAMAGE as error:
        raise StoreError("store_read", f"{path.name} is damaged: {error}") from error


def _parts(footer: pq.FileMetaData) -> dict[str, int]:
    """The same of a joined file; empty for another."""
    told = (footer.metadata or {}).get(PARTS_KEY.encode())
    return {} if told is None else {str(name): int(rows) for name, rows in json.loads(told)}


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


def write_table(path: Path, rows: pl.DataFrame) -> str:
    """Write a table file whole or not at all, and return its SHA-256.

    Raises
    ------
    StoreError
        If it cannot be written; the old file then stays.
    """
    return put(path, encode_table(path.name, rows))


def encode_table(name: str, rows: pl.DataFrame) -> bytes:
    """Rows as the bytes of a Parquet file, decoded again and compared.

    Raises
    ------
    StoreError
        If they cannot be encoded, or are decoded otherwise.
    """
    try:
        encoded = _as_parquet(rows, SCHEMA_VERSION)
        decoded = pl.from_arrow(_from_parquet(encoded))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError("store_write", f"{name} cannot be written: {error}") from error
    assert isinstance(decoded, pl.DataFrame)
    if not decoded.equals(rows, null_equal=True):
        raise StoreError("store_write", f"{name}: what is read back is not what was written")
    return encoded


def _as_parquet(rows: pl.DataFrame, version: int, parts: Mapping[str, int] | None = None) -> bytes:
    begins = accumulate((parts or {}).values(), initial=0)
    named = [
        (name, rows.slice(begin, count))
        for begin, (name, count) in zip(begins, (parts or {}).items(), strict=False)
    ]
    stream = pa.BufferOutputStream()
    write_parts(stream, named or [("", rows)], version)
    return bytes(stream.getvalue())


def write_parts(
    stream: Any, parts: Iterable[tuple[str, pl.DataFrame]], version: int = SCHEMA_VERSION
) -> None:
    """Write a file of the rows of named nights to a stream; an empty name is not noted."""
    counts: list[tuple[str, int]] = []

    def counted() -> Iterator[pl.DataFrame]:
        for name, rows in parts:
            counts.append((name, rows.height))
            yield rows

    groups = (one.to_arrow(compat_level=pl.CompatLevel.oldest()) for one in row_groups(counted()))
    first = next(groups)
    texts = [column.name for column in first.schema if pa.types.is_large_string(column.type)]
    with pq.ParquetWriter(
        stream,
        first.schema,
        compression=COMPRESSION,
        use_dictionary=texts,
        write_page_checksum=True,
        store_schema=False,
    ) as table:
        for group in chain([first], groups):
            table.write_table(group, row_group_size=max(group.num_rows, 1))
        # Metadata of the schema would be left out with it.
        told = {VERSION_KEY: str(version)}
        if any(name for name, _ in counts):
            told[PARTS_KEY] = json.dumps(counts, separators=(",", ":"))
        table.add_key_value_metadata(told)


def row_groups(parts: Iterable[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Nights put together up to the rows of a row group; each lies whole in one."""
    waiting: list[pl.DataFrame] = []
    for rows in parts:
        waiting.append(rows)
        if sum(one.height for one in waiting) >= ROWS_A_GROUP:
            yield pl.concat(waiting, rechunk=True)
            waiting = []
    if waiting:
        yield pl.concat(waiting, rechunk=True)


def _from_parquet(
    encoded: bytes, names: Collection[str] | None = None, columns: Sequence[str] | None = None
) -> pa.Table:
    """Rows of a file's content; of a joined file those of some nights alone, if they are named."""
    file = pq.ParquetFile(pa.BufferReader(encoded), page_checksum_verification=True)
    parts = _parts(file.metadata)
    if names is None or not parts:
        return file.read(columns=columns, use_threads=False)
    sizes = (file.metadata.row_group(place).num_rows for place in range(file.num_row_groups))
    begins = list(accumulate(sizes, initial=0))
    groups: dict[int, pa.Table] = {}
    found, begin = [], 0
    for name, count in parts.items():
        if name in names:
            # A night lies in one row group; one without rows may lie behind the last.
            place = min(bisect_right(begins, begin), file.num_row_groups) - 1
            if place not in groups:
                groups[place] = file.read_row_group(place, columns=columns, use_threads=False)
            found.append(groups[place].slice(begin - begins[place], count))
        begin += count
    return pa.concat_tables(found or [file.read_row_group(0, columns=columns).slice(0, 0)])


def read_table(path: Path, table: Table, nights: Collection[dt.date] | None = None) -> pl.DataFrame:
    """Rows of a table file; columns that an older version lacks are null.

    Of a joined file those of some nights alone, if they are named.

    Raises
    ------
    StoreError
        If the file is damaged (``store_read``), or of a newer version of the program
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
        rows, _ = _rows_of(path, table, encoded, names)
        absent = [
            pl.lit(None, dtype=kind).alias(name)
            for name, kind in table.schema.items()
            if name not in rows.columns
        ]
        return rows.with_columns(absent).select(table.schema.keys()).cast(pl.Schema(table.schema))
    except DAMAGE as error:
        raise damaged(path, table, error) from error


def _rows_of(
    path: Path, table: Table, encoded: bytes, names: Collection[str] | None = None
) -> tuple[pl.DataFrame, int]:
    """Rows of a table file, and its schema version."""
    content = _from_parquet(encoded, names)
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
    wanted = pl.col("motor_id").is_in(list(motor_ids))
    if nights is not None:
        wanted &= pl.col("night").is_in(list(nights))

    def read_all() -> list[pl.DataFrame]:
        found = (
            night_paths(output, table, month).values()
            if nights is None
            else by_file(output, table, nights)
        )
        paths = list(dict.fromkeys(found))
        return [
            _read_some(output, paths[at : at + FILES_AT_ONCE], table, wanted, chosen)
            for at in range(0, len(paths), FILES_AT_ONCE)
        ]

    empty = pl.DataFrame(schema={name: table.schema[name] for name in chosen})
    return pl.concat([empty, *while_listed(read_all)])


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
    output: Path, paths: Sequence[Path], table: Table, wanted: pl.Expr, chosen: list[str]
) -> pl.DataFrame:
    """Wanted rows of some files, in one scan: one for each takes five times as long."""
    try:
        contents = [_published_content(output, path, table) for path in paths]
        rows = pl.scan_parquet(
            contents, schema=table.schema, missing_columns="insert", extra_columns="ignore"
        )
        return rows.filter(wanted).select(chosen).collect()
    except DAMAGE as error:
        if len(paths) == 1:
            raise damaged(paths[0], table, error) from error
    for path in paths:  # to name the damaged one
        _read_some(output, [path], table, wanted, chosen)
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
            _rows_of(path, table, content)  # which checks its pages and names
        if not accepted or hashlib.sha256(content).hexdigest() in accepted:
            return content
    raise damaged(path, table, ValueError("it is not what its manifest says"))


class Proof(Enum):
    """Evidence for a file that no manifest lists.

    `WHOLE`: encoding its rows again gives the same bytes, the footer too. `PAGES`: only the
    checksums of its pages hold, as another version of PyArrow or Polars wrote it.
    """

    WHOLE = "whole"
    PAGES = "pages"


def prove(path: Path, table: Table) -> tuple[str, Proof]:
    """SHA-256 of a table file that no manifest lists, and its proof.

    Raises
    ------
    StoreError
        If it is damaged, of a newer version of the program, or has rows of other nights.
    """
    try:
        content = read(path)
        rows, version = _rows_of(path, table, content)
        parts = _parts(pq.read_metadata(pa.BufferReader(content)))
        of_night = path.parent.name.startswith(MONTH_PREFIX) and "night" in rows.columns
        nights = (
            {str(night) for night in rows["night"].unique().drop_nulls()} if of_night else set()
        )
        if nights - (parts.keys() or {path.stem}):
            raise ValueError("it has rows of other nights")
        same = _as_parquet(rows, version, parts) == content
    except DAMAGE as error:
        raise damaged(path, table, error) from error
    return hashlib.sha256(content).hexdigest(), Proof.WHOLE if same else Proof.PAGES


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

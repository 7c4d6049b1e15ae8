"""Tables on disk: one Parquet file for each table and night, replaced whole or not at all.

A motor's task stages its rows in a file of its own; the run then publishes night by night, so that
its memory does not grow with the fleet's history. Nights of a month that is long over are joined in
one file (`pipeline/store/months.py`), night after night; its footer says which, with their rows.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import json
import logging
import os
import re
from bisect import bisect_right
from calendar import monthrange
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, chain
from pathlib import Path
from typing import Any, TypeVar

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError, UsageError
from pipeline.schema import SCHEMA_VERSION, Table, frame
from pipeline.store.atomic_files import Prepared, move, prepare, put, read, scratch
from pipeline.store.manifest import MONTH_PREFIX, Manifest, manifest_key, read_manifest

log = logging.getLogger(__name__)

Made = TypeVar("Made")

VERSION_KEY = "motor_leakage_schema_version"
# Nights (or runs) of a joined file and their numbers of rows, in the order of its rows.
PARTS_KEY = "motor_leakage_parts"
# Joined nights share a row group up to about so many rows.
ROWS_A_GROUP = 122_880
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
    with pq.ParquetWriter(
        stream, first.schema, compression="zstd", write_page_checksum=True, store_schema=False
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
        raise _damaged(path, table, error) from error
    return _decode(path, table, content, None if nights is None else {str(one) for one in nights})


def _decode(
    path: Path, table: Table, encoded: bytes, names: Collection[str] | None = None
) -> pl.DataFrame:
    try:
        rows, _ = _rows_of(path, table, encoded, names)
        absent = [
            pl.lit(None, dtype=kind).alias(name)
            for name, kind in table.schema.items()
            if name not in rows.columns
        ]
        return rows.with_columns(absent).select(table.schema.keys()).cast(pl.Schema(table.schema))
    except DAMAGE as error:
        raise _damaged(path, table, error) from error


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


def _damaged(path: Path, table: Table, error: BaseException) -> StoreError:
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
            raise _damaged(paths[0], table, error) from error
    for path in paths:  # to name the damaged one
        _read_some(output, [path], table, wanted, chosen)
    raise _damaged(paths[0].parent, table, ValueError("its files do not fit together"))


def published_rows(
    output: Path, path: Path, table: Table, names: Collection[str] | None = None
) -> pl.DataFrame:
    """Rows of a file that is what its manifest says, or of some nights; raises as `read_table`."""
    try:
        content = _published_content(output, path, table)
    except OSError as error:
        raise _damaged(path, table, error) from error
    return _decode(path, table, content, names)


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
    raise _damaged(path, table, ValueError("it is not what its manifest says"))


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
        raise _damaged(path, table, error) from error
    return hashlib.sha256(content).hexdigest(), Proof.WHOLE if same else Proof.PAGES


class StagedRows:
    """Staged rows of one motor and table, a record batch for each night.

    The file is open only while it is read: a fleet has more of them than a process may open.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._opened() as file:
            nights = file.schema.metadata[b"nights"].decode()
        self.nights = [dt.date.fromisoformat(text) for text in nights.split()]

    @contextmanager
    def _opened(self) -> Iterator[pa.ipc.RecordBatchFileReader]:
        with pa.memory_map(str(self._path)) as content, pa.ipc.open_file(content) as file:
            yield file

    def batches(self, nights: Collection[dt.date]) -> dict[dt.date, pa.RecordBatch]:
        """Rows of those of some nights that were staged."""
        places = {night: place for place, night in enumerate(self.nights) if night in nights}
        if not places:
            return {}
        with self._opened() as file:
            return {night: file.get_batch(place) for night, place in places.items()}


@dataclass(frozen=True, slots=True)
class NewRows:
    """Rows that a run has made of a night, and the motors that they are of; some have none."""

    motor_ids: tuple[str, ...]
    rows: pl.DataFrame


def new_rows(
    staged: Mapping[str, StagedRows], nights: Collection[dt.date]
) -> dict[dt.date, NewRows]:
    """Staged rows of some nights, by night; those that no motor has done are left out."""
    found: defaultdict[dt.date, dict[str, pa.RecordBatch]] = defaultdict(dict)
    for motor_id, own in staged.items():
        for night, batch in own.batches(nights).items():
            found[night][motor_id] = batch
    made = {}
    for night, batches in found.items():
        rows = pl.from_arrow(pa.Table.from_batches(batches.values()))
        assert isinstance(rows, pl.DataFrame)
        made[night] = NewRows(tuple(batches), rows)
    return made


def stage(
    path: Path, table: Table, nights: Mapping[dt.date, Iterable[Mapping[str, object]]]
) -> None:
    """Write a motor's rows of one table for the run to publish, nights without rows included.

    Raises
    ------
    StoreError
        If they cannot be written.
    """
    of_nights = {night: list(rows) for night, rows in sorted(nights.items())}
    every = frame(table, chain.from_iterable(of_nights.values()), without="run_id").to_arrow()
    label = " ".join(map(str, of_nights))
    schema = every.schema.with_metadata({b"nights": label.encode()})
    # A night without rows needs a batch, too.
    (whole,) = every.combine_chunks().to_batches() or [pa.RecordBatch.from_pylist([], every.schema)]
    begins = accumulate(map(len, of_nights.values()), initial=0)
    try:
        with scratch(path) as stream, pa.ipc.new_file(stream, schema) as staged:
            for begin, rows in zip(begins, of_nights.values(), strict=False):
                staged.write_batch(whole.slice(begin, len(rows)))
    except OSError as error:
        raise StoreError("store_write", f"rows cannot be staged: {error}") from error


@dataclass(frozen=True, slots=True)
class NightFile:
    """A table file that is prepared, and not in its place yet.

    Attributes
    ----------
    path
        Its place.
    before
        SHA-256 of the present file; None without one.
    after
        SHA-256 of the new file; None if there is neither a file nor a row.
    lost_rows
        True if the present file is damaged or gone: rows of motors that are not published with it
        have to be made anew.
    prepared
        The new file; None if the present one stays.
    """

    path: Path
    before: str | None
    after: str | None
    lost_rows: bool = False
    prepared: Prepared | None = None

    def land(self) -> None:
        """Put it into its place, and a damaged file there aside; raises as `Prepared.land`.

        That survives a power cut once its folder is flushed.
        """
        if self.lost_rows and self.before is not None:
            move(self.path, self.path.with_suffix(PUT_ASIDE))
        if self.prepared is not None:
            self.prepared.land(flush=False)

    def drop(self) -> None:
        """Remove the new file; the present one stays."""
        if self.prepared is not None:
            self.prepared.drop()


def prepare_night(
    output: Path,
    table: Table,
    night: dt.date,
    new: NewRows,
    run_id: str,
    finish: Callable[[pl.DataFrame], pl.DataFrame] = lambda rows: rows,
    accepted: Collection[str | None] = (),
) -> NightFile:
    """Prepare a night's file with the new rows of some motors; those of the others stay.

    Raises
    ------
    StoreError
        If the new file cannot be written, or the present one not be read.
    """
    path = night_file(output, table, night)
    before, rows_before = _present(path, table, accepted)
    gone = before is None and bool(accepted) and None not in accepted
    lost_rows = gone or (before is not None and rows_before is None)
    rows = new.rows.with_columns(run_id=pl.lit(run_id)).select(table.schema.keys())
    if rows_before is not None:
        kept = rows_before.filter(~pl.col("motor_id").is_in(new.motor_ids))
        rows = pl.concat([kept, rows])
    rows = finish(rows.sort(table.key))
    if before is None and not rows.height:
        return NightFile(path, None, None, lost_rows)
    content = encode_table(path.name, rows)
    return _replacing(path, before, content, lost_rows)


def prepare_file(path: Path, content: bytes) -> NightFile:
    """Prepare a file that replaces the present one as a whole; raises as `prepare`."""
    try:
        before = hashlib.sha256(read(path)).hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        before = None
    except OSError:
        before = UNREADABLE
    return _replacing(path, before, content)


def _replacing(
    path: Path, before: str | None, content: bytes, lost_rows: bool = False
) -> NightFile:
    after = hashlib.sha256(content).hexdigest()
    if after == before:
        return NightFile(path, before, after)
    return NightFile(path, before, after, lost_rows, prepare(path, content))


def _present(
    path: Path, table: Table, accepted: Collection[str | None]
) -> tuple[str | None, pl.DataFrame | None]:
    """Hash and rows of a night's file; no hash if there is no file, no rows if it is damaged.

    A file is damaged if it reads as such twice: an error on the way from the disk is none.
    """
    for attempt in range(2):
        digest = UNREADABLE
        try:
            content = read(path)
            digest = hashlib.sha256(content).hexdigest()
            if accepted and digest not in accepted:
                raise _damaged(path, table, ValueError("it is not what its manifest says"))
            return digest, _decode(path, table, content)
        except (FileNotFoundError, NotADirectoryError):
            return None, None
        except OSError as error:
            if error.errno != errno.EIO:
                raise StoreError(
                    "store_read", f"{path.name} of {table.name} cannot be read: {error.strerror}"
                ) from error
            fault = _damaged(path, table, error)
        except StoreError as error:
            if error.code != "store_read":
                raise
            fault = error
        if attempt:
            log.warning("%s; it is put aside, and the next run makes that night anew", fault)
    return digest, None


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

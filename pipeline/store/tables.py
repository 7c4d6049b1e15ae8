"""Tables on disk: one Parquet file for each table and night, replaced whole or not at all.

A motor's task stages its rows in a file of its own; the run then publishes night by night, so that
its memory does not grow with the fleet's history.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import logging
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError, UsageError
from pipeline.schema import SCHEMA_VERSION, Table, frame
from pipeline.store.atomic_files import Prepared, move, prepare, put, read, scratch
from pipeline.store.manifest import MONTH_PREFIX, Manifest, manifest_key, read_manifest

log = logging.getLogger(__name__)

VERSION_KEY = "motor_leakage_schema_version"
# Ending of a damaged file that a run has put aside.
PUT_ASIDE = ".damaged"
UNREADABLE = "unreadable"
ENDING = ".parquet"
# Files that are decoded together; more would take memory and save no time.
FILES_AT_ONCE = 32
MONTH_FOLDER = re.compile(r"month=\d{4}-(0[1-9]|1[0-2])")
# Raised by reading a damaged file; a damaged name gives UnicodeDecodeError, a ValueError.
DAMAGE = (OSError, ValueError, pa.ArrowException, PolarsError, PanicException)


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


def night_file(output: Path, table: Table, night: dt.date) -> Path:
    """File of a table's night."""
    return table_folder(output, table) / f"month={night:%Y-%m}" / f"{night}.parquet"


def nights_back(output: Path, table: Table) -> Iterator[dt.date]:
    """Nights of a table's files, the newest first; a file may have no rows."""
    folder = table_folder(output, table)
    for month in sorted((entry.name for entry in _entries(folder)), reverse=True):
        for name in sorted((entry.name for entry in _entries(folder / month)), reverse=True):
            night = night_named(name)
            if night is not None and month == f"{MONTH_PREFIX}{night:%Y-%m}":
                yield night


def night_paths(output: Path, table: Table, month: str = "*") -> dict[dt.date, Path]:
    """Files of a table by night, in time order; files of other names are left out."""
    paths = sorted(table_folder(output, table).glob(f"{MONTH_PREFIX}{month}/*{ENDING}"))
    found = ((night_named(path.name), path) for path in paths)
    return {
        night: path
        for night, path in found
        if night is not None and path == night_file(output, table, night)
    }


def night_named(name: str) -> dt.date | None:
    """The night in the name of a table's file; None without one."""
    try:
        night = dt.date.fromisoformat(name.removesuffix(ENDING))
    except ValueError:
        return None
    return night if name == f"{night}{ENDING}" else None


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
    """Size, time and inode of each file of a month, as text by night: another file differs."""
    found = {}
    for entry in _entries(table_folder(output, table) / f"{MONTH_PREFIX}{month}"):
        night = night_named(entry.name)
        if night is not None and f"{night:%Y-%m}" == month:
            state = entry.stat()
            stamp = f"{state.st_size:x}.{state.st_mtime_ns:x}.{state.st_ino:x}"
            found[entry.name.removesuffix(ENDING)] = stamp
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


def _as_parquet(rows: pl.DataFrame, version: int) -> bytes:
    content = rows.to_arrow(compat_level=pl.CompatLevel.oldest())
    stream = pa.BufferOutputStream()
    with pq.ParquetWriter(
        stream,
        content.schema,
        compression="zstd",
        write_page_checksum=True,
        store_schema=False,
    ) as table:
        table.write_table(content)
        # Metadata of the schema would be left out with it.
        table.add_key_value_metadata({VERSION_KEY: str(version)})
    return bytes(stream.getvalue())


def _from_parquet(encoded: bytes) -> pa.Table:
    return pq.read_table(
        pa.BufferReader(encoded), page_checksum_verification=True, partitioning=None
    )


def read_table(path: Path, table: Table) -> pl.DataFrame:
    """Rows of a table file; columns that an older version lacks are null.

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
    return _decode(path, table, content)


def _decode(path: Path, table: Table, encoded: bytes) -> pl.DataFrame:
    try:
        rows, _ = _rows_of(path, table, encoded)
        absent = [
            pl.lit(None, dtype=kind).alias(name)
            for name, kind in table.schema.items()
            if name not in rows.columns
        ]
        return rows.with_columns(absent).select(table.schema.keys()).cast(pl.Schema(table.schema))
    except DAMAGE as error:
        raise _damaged(path, table, error) from error


def _rows_of(path: Path, table: Table, encoded: bytes) -> tuple[pl.DataFrame, int]:
    """Rows of a table file, and its schema version."""
    content = _from_parquet(encoded)
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
    if nights is None:
        paths = list(night_paths(output, table, month).values())
    else:
        files = (night_file(output, table, night) for night in sorted(nights))
        paths = [path for path in files if path.exists()]
    if not paths:
        return pl.DataFrame(schema={name: table.schema[name] for name in chosen})
    parts = [
        _read_motors(output, paths[at : at + FILES_AT_ONCE], table, motor_ids, chosen)
        for at in range(0, len(paths), FILES_AT_ONCE)
    ]
    return pl.concat(parts)


def _read_motors(
    output: Path, paths: Sequence[Path], table: Table, motor_ids: Sequence[str], chosen: list[str]
) -> pl.DataFrame:
    """Some motors' rows of some files, in one scan: one for each takes five times as long."""
    try:
        contents = [_published_content(output, path, table) for path in paths]
        rows = pl.scan_parquet(
            contents, schema=table.schema, missing_columns="insert", extra_columns="ignore"
        )
        return rows.filter(pl.col("motor_id").is_in(list(motor_ids))).select(chosen).collect()
    except DAMAGE as error:
        if len(paths) == 1:
            raise _damaged(paths[0], table, error) from error
    for path in paths:  # to name the damaged one
        _read_motors(output, [path], table, motor_ids, chosen)
    raise _damaged(paths[0].parent, table, ValueError("its files do not fit together"))


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
        of_night = path.parent.name.startswith(MONTH_PREFIX) and "night" in rows.columns
        if of_night and {str(night) for night in rows["night"].unique().drop_nulls()} - {path.stem}:
            raise ValueError("it has rows of other nights")
        same = _as_parquet(rows, version) == content
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

    def rows(self, night: dt.date) -> pl.DataFrame | None:
        """Rows of a night; None if it was not staged."""
        if night not in self.nights:
            return None
        with self._opened() as file:
            batch = file.get_batch(self.nights.index(night))
            rows = pl.from_arrow(pa.Table.from_batches([batch]))
        assert isinstance(rows, pl.DataFrame)
        return rows


def stage(
    path: Path, table: Table, nights: Mapping[dt.date, Iterable[Mapping[str, object]]]
) -> None:
    """Write a motor's rows of one table for the run to publish, nights without rows included.

    Raises
    ------
    StoreError
        If they cannot be written.
    """
    frames = [frame(table, rows, without="run_id").to_arrow() for _, rows in sorted(nights.items())]
    label = " ".join(night.isoformat() for night in sorted(nights))
    schema = frames[0].schema.with_metadata({b"nights": label.encode()})
    try:
        with scratch(path) as stream, pa.ipc.new_file(stream, schema) as staged:
            for rows in frames:
                # A night without rows needs a batch, too.
                whole = rows.combine_chunks().to_batches() or [
                    pa.RecordBatch.from_pylist([], schema=rows.schema)
                ]
                staged.write_batch(whole[0])
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
        """Put it into its place, and a damaged file there aside; raises as `Prepared.land`."""
        if self.lost_rows and self.before is not None:
            move(self.path, self.path.with_suffix(PUT_ASIDE))
        if self.prepared is not None:
            self.prepared.land()

    def drop(self) -> None:
        """Remove the new file; the present one stays."""
        if self.prepared is not None:
            self.prepared.drop()


def prepare_night(
    output: Path,
    table: Table,
    night: dt.date,
    staged: Mapping[str, pl.DataFrame],
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
    parts = [frame(table, [])]
    if rows_before is not None:
        parts.append(rows_before.filter(~pl.col("motor_id").is_in(list(staged))))
    parts += [
        rows.with_columns(pl.lit(run_id).alias("run_id")).select(table.schema.keys())
        for rows in staged.values()
    ]
    rows = finish(pl.concat(parts).sort(table.key))
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

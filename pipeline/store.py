"""The tables on disk: one Parquet file a night and table, replaced whole or not at all.

A motor's task stages its rows in a file of its own; the run then publishes night by night, so its
memory does not grow with the fleet's history. Data files hold no clock time of ours.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import StoreError
from pipeline.schema import SCHEMA_VERSION, Table, frame

log = logging.getLogger(__name__)

VERSION_KEY = "motor_leakage_schema_version"
TEMPORARY_PREFIX = ".writing-"


def table_folder(output: Path, table: Table) -> Path:
    """Folder of a table."""
    return output / "tables" / table.name


def night_file(output: Path, table: Table, night: dt.date) -> Path:
    """File of a table's night."""
    return table_folder(output, table) / f"month={night:%Y-%m}" / f"{night}.parquet"


def last_night(output: Path, table: Table) -> dt.date | None:
    """The last night that a table has a file of; None where it has none."""
    for month in sorted(table_folder(output, table).glob("month=*"), reverse=True):
        labels = [path.stem for path in month.glob("*.parquet")]
        if labels:
            return dt.date.fromisoformat(max(labels))
    return None


def write_table(path: Path, rows: pl.DataFrame) -> str:
    """Write a table file whole or not at all.

    Parameters
    ----------
    path
        The file; folders above it are made.
    rows
        Its rows, in their final order.

    Returns
    -------
    str
        SHA-256 of the file, as it was read back from the disk.

    Raises
    ------
    StoreError
        If it cannot be written; what was there before is then untouched.
    """

    def write(name: str) -> None:
        content = rows.to_arrow(compat_level=pl.CompatLevel.oldest())
        with pq.ParquetWriter(
            name,
            content.schema,
            compression="zstd",
            write_page_checksum=True,
            store_schema=False,
        ) as table:
            table.write_table(content)
            # Metadata of the schema would be left out with it.
            table.add_key_value_metadata({VERSION_KEY: str(SCHEMA_VERSION)})

    def compare(name: str) -> None:
        written = pl.from_arrow(
            pq.read_table(name, page_checksum_verification=True, partitioning=None)
        )
        assert isinstance(written, pl.DataFrame)
        if not written.equals(rows, null_equal=True):
            raise OSError(errno.EIO, "what was read back is not what was written")

    return replace_whole(path, write, compare)


def replace_whole(
    path: Path,
    write: Callable[[str], None],
    compare: Callable[[str], None] = lambda _: None,
    *,
    durable: bool = True,
) -> str:
    """Write a file beside its final name, flush it, read it back, then rename it.

    Parameters
    ----------
    path
        The file; folders above it are made.
    write
        Writes the content to the name that it is given.
    compare
        Reads it again, and raises OSError where it is not what was to be written.
    durable
        Whether the file must outlive a power cut; one that can be made again need not.

    Returns
    -------
    str
        SHA-256 of the file, as it was read back.

    Raises
    ------
    StoreError
        If it cannot be written; what was there before is then untouched.
    """
    try:
        name = _temporary_beside(path)
        try:
            write(name)
            with Path(name).open("rb") as written:
                if durable:
                    os.fsync(written.fileno())
                digest = hashlib.file_digest(written, "sha256").hexdigest()
            compare(name)
            Path(name).chmod(0o644)
            Path(name).replace(path)
        except BaseException:
            with suppress(OSError):
                Path(name).unlink()
            raise
        if durable:
            _flush_folder(path.parent)
    except (OSError, pa.ArrowException) as error:
        raise StoreError("store_write", f"{path.name} cannot be written: {error}") from error
    return digest


def _temporary_beside(path: Path) -> str:
    """Name of an empty file in the folder of a file that is to come."""
    try:
        handle, name = tempfile.mkstemp(prefix=TEMPORARY_PREFIX, dir=path.parent)
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=TEMPORARY_PREFIX, dir=path.parent)
    os.close(handle)
    return name


def _flush_folder(folder: Path) -> None:
    """Make a rename outlive a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_table(path: Path, table: Table) -> pl.DataFrame:
    """Rows of a table file; columns that an older version had not are null.

    Raises
    ------
    StoreError
        If the file is damaged (``store_read``), or of a newer version of the program
        (``store_newer``).
    """
    try:
        content = pq.read_table(path, page_checksum_verification=True, partitioning=None)
        _require_known_version(path, content)
        rows = pl.from_arrow(content)
        assert isinstance(rows, pl.DataFrame)
        _require_columns(rows.columns, table)
        absent = [
            pl.lit(None, dtype=kind).alias(name)
            for name, kind in table.schema.items()
            if name not in rows.columns
        ]
        return rows.with_columns(absent).select(table.schema.keys()).cast(pl.Schema(table.schema))
    # A damaged name is a UnicodeDecodeError, a ValueError.
    except (OSError, ValueError, pa.ArrowException, pl.exceptions.PolarsError) as error:
        raise StoreError(
            "store_read", f"{path.name} of {table.name} is damaged: {error}"
        ) from error


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
        Which table.
    motor_ids
        Whose rows.
    columns
        Which columns; all if none. Those that an older file had not are null.
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
    empty = pl.DataFrame(schema={name: table.schema[name] for name in table.schema})
    if nights is None:
        paths = sorted(map(str, table_folder(output, table).glob(f"month={month}/*.parquet")))
    else:
        files = (night_file(output, table, night) for night in sorted(nights))
        paths = [str(path) for path in files if path.exists()]
    if not paths:
        return empty.select(chosen)
    empty = empty.select(["motor_id", *(name for name in chosen if name != "motor_id")])
    try:
        parts = [_read_motors(path, motor_ids, empty.columns) for path in paths]
        rows = pl.concat([empty, *parts], how="diagonal_relaxed")
    except (OSError, ValueError, pa.ArrowException, pl.exceptions.PolarsError) as error:
        raise StoreError("store_read", f"a file of {table.name} is damaged: {error}") from error
    return rows.select(chosen).cast(pl.Schema({name: table.schema[name] for name in chosen}))


def _read_motors(path: str, motor_ids: Sequence[str], columns: Sequence[str]) -> pl.DataFrame:
    """Some motors' rows of a file, in those columns that it has.

    File by file, as a scanner of many takes longer for small ones; with checksums, as a flipped bit
    would otherwise be a step in a trend.
    """
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        rows = pl.from_arrow(file.read(columns=list(columns), use_threads=False))
    assert isinstance(rows, pl.DataFrame)
    return rows.filter(pl.col("motor_id").is_in(list(motor_ids)))


def _require_known_version(path: Path, content: pa.Table) -> None:
    """Refuse a file of a newer version of the program: it may hold what this one would lose."""
    version = int((content.schema.metadata or {}).get(VERSION_KEY.encode(), b"0"))
    if version > SCHEMA_VERSION:
        raise StoreError(
            "store_newer", f"{path.name} is of schema version {version}; update the program"
        )


def _require_columns(names: Sequence[str], table: Table) -> None:
    """Refuse columns that are not the table's: a damaged name would read as a column of nulls."""
    strange = sorted(set(names) - table.schema.keys())
    absent = sorted(set(table.key) - set(names))
    if strange or absent:
        raise ValueError(
            f"column {', '.join(strange) or 'none'} is not known to this version, and of the key "
            f"{', '.join(absent) or 'none'} is absent"
        )


class StagedRows:
    """The rows of one motor and table, a record batch a night, as its task left them."""

    def __init__(self, path: Path) -> None:
        self._file = pa.ipc.open_file(pa.memory_map(str(path)))
        nights = self._file.schema.metadata[b"nights"].decode()
        self.nights = [dt.date.fromisoformat(text) for text in nights.split()]

    def rows(self, night: dt.date) -> pl.DataFrame | None:
        """Rows of a night, or None where this motor did not do it."""
        if night not in self.nights:
            return None
        batch = self._file.get_batch(self.nights.index(night))
        rows = pl.from_arrow(pa.Table.from_batches([batch]))
        assert isinstance(rows, pl.DataFrame)
        return rows


def stage(
    path: Path, table: Table, nights: Mapping[dt.date, Iterable[Mapping[str, object]]]
) -> None:
    """Leave a motor's rows of one table for the run to publish; a night without rows too.

    Raises
    ------
    StoreError
        If they cannot be written, for want of space say.
    """
    frames = [frame(table, rows, without="run_id").to_arrow() for _, rows in sorted(nights.items())]
    label = " ".join(night.isoformat() for night in sorted(nights))
    schema = frames[0].schema.with_metadata({b"nights": label.encode()})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with pa.ipc.new_file(str(path), schema) as staged:
            for rows in frames:
                # An empty table has no batch of its own, yet its night must keep its place.
                whole = rows.combine_chunks().to_batches() or [
                    pa.RecordBatch.from_pylist([], schema=rows.schema)
                ]
                staged.write_batch(whole[0])
    except OSError as error:
        raise StoreError("store_write", f"rows cannot be staged: {error}") from error


@dataclass(frozen=True, slots=True)
class Published:
    """A night's file after it was published.

    Attributes
    ----------
    path
        The file.
    sha256
        Of its content; None where the night has no rows, and no file.
    lost_rows
        Whether the file that was there was damaged and put aside as ``.damaged``: the rows of the
        motors that were not published with it have to be made anew.
    """

    path: Path
    sha256: str | None
    lost_rows: bool


def publish_night(
    output: Path,
    table: Table,
    night: dt.date,
    staged: Mapping[str, pl.DataFrame],
    run_id: str,
    finish: Callable[[pl.DataFrame], pl.DataFrame] = lambda rows: rows,
) -> Published:
    """Put the rows of some motors into a night's file; those of the others stay.

    Parameters
    ----------
    output
        Output folder.
    table, night
        Which file.
    staged
        New rows by motor id; a motor without rows loses those it had.
    run_id
        The run that writes them.
    finish
        What is still to be done with all rows of the night together.

    Returns
    -------
    Published
        What is there now, and whether rows of other motors were lost.

    Raises
    ------
    StoreError
        If the new file cannot be written.
    """
    path = night_file(output, table, night)
    parts = [frame(table, [])]
    existed = path.exists()
    before = _present_rows(path, table)
    if before is not None:
        parts.append(before.filter(~pl.col("motor_id").is_in(list(staged))))
    parts += [
        rows.with_columns(pl.lit(run_id).alias("run_id")).select(table.schema.keys())
        for rows in staged.values()
    ]
    rows = finish(pl.concat(parts).sort(table.key))
    digest = None
    if rows.height:
        digest = write_table(path, rows)
    elif path.exists():
        path.unlink()
        _flush_folder(path.parent)
    return Published(path, digest, lost_rows=existed and before is None)


def _present_rows(path: Path, table: Table) -> pl.DataFrame | None:
    """Rows of a night's file as it is; None where there is none, or none that can be trusted."""
    if not path.exists():
        return None
    try:
        return read_table(path, table)
    except StoreError as error:
        if error.code != "store_read":
            raise
        log.warning("%s; it is put aside, and the next run makes that night anew", error)
        path.replace(path.with_suffix(".damaged"))
        return None


def publish_run_table(
    output: Path, table: Table, started: dt.datetime, rows: pl.DataFrame
) -> Published:
    """Write one of the tables that have a file a run."""
    name = f"{started:%Y%m%dT%H%M%S%fZ}.parquet"
    path = table_folder(output, table) / f"month={started:%Y-%m}" / name
    return Published(path, write_table(path, rows), lost_rows=False)


def remove_leftovers(folders: Sequence[Path]) -> None:
    """Delete temporary files that a killed run left behind."""
    for folder in folders:
        for path in folder.glob(f"**/{TEMPORARY_PREFIX}*"):
            with suppress(OSError):
                path.unlink()

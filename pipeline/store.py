"""The tables on disk: one Parquet file a night and table, replaced whole or not at all.

A motor's task stages its rows in a file of its own; the run then publishes night by night, so its
memory does not grow with the fleet's history. Data files hold no clock time of ours.
"""

from __future__ import annotations

import datetime as dt
import logging
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
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


def write_table(path: Path, rows: pl.DataFrame) -> None:
    """Write a table file whole or not at all.

    Parameters
    ----------
    path
        The file; folders above it are made.
    rows
        Its rows, in their final order.

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

    replace_whole(path, write)


def replace_whole(path: Path, write: Callable[[str], None], *, durable: bool = True) -> None:
    """Write a file beside its final name, flush it to the disk, then rename it.

    Parameters
    ----------
    path
        The file; folders above it are made.
    write
        Writes the content to the name that it is given.
    durable
        Whether the file must outlive a power cut; one that can be made again need not.

    Raises
    ------
    StoreError
        If it cannot be written; what was there before is then untouched.
    """
    try:
        name = _temporary_beside(path)
        try:
            write(name)
            if durable:
                with Path(name).open("rb") as written:
                    os.fsync(written.fileno())
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


def publish_night(
    output: Path,
    table: Table,
    night: dt.date,
    staged: Mapping[str, pl.DataFrame],
    run_id: str,
) -> bool:
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

    Returns
    -------
    bool
        Whether the present file was damaged and put aside as ``.damaged``: the rows of the other
        motors are then lost, and have to be made anew.

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
    rows = pl.concat(parts).sort(table.key)
    if rows.height:
        write_table(path, rows)
    elif path.exists():
        path.unlink()
        _flush_folder(path.parent)
    return existed and before is None


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


def publish_run_table(output: Path, table: Table, started: dt.datetime, rows: pl.DataFrame) -> None:
    """Write one of the tables that have a file a run."""
    name = f"{started:%Y%m%dT%H%M%S%fZ}.parquet"
    write_table(table_folder(output, table) / f"month={started:%Y-%m}" / name, rows)


def remove_leftovers(folders: Sequence[Path]) -> None:
    """Delete temporary files that a killed run left behind."""
    for folder in folders:
        for path in folder.glob(f"**/{TEMPORARY_PREFIX}*"):
            with suppress(OSError):
                path.unlink()

"""Logs as Parquet, written by others.

They are read with PyArrow and validated in full before any figure is used: a footer that reads
proves nothing, and other readers were seen to abort on malformed files or to read them without a
word. Checksums of pages are verified where the writer left them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings, require_time, span, time_name, wide_log
from pipeline.ingest.contract import LogSource, RawLog
from pipeline.ingest.time_stamps import (
    EPOCH_UNITS,
    TimeStampError,
    TimeStamps,
    from_arrow_timestamps,
    from_epoch,
    from_text,
)

MOST_ROWS = 2**27
"""Two weeks at 100 Hz. A file of a few kilobytes may claim, and decode to, any number of rows."""

_MAGIC = b"PAR1"
_BATCH_ROWS = 2**20


def read_parquet_log(path: Path, source: LogSource) -> RawLog:
    """Read the wanted columns of a Parquet file.

    Parameters
    ----------
    path
        An existing file.
    source
        Its channels and time column.

    Raises
    ------
    LogError
        As listed in `pipeline.ingest.contract`.
    """
    with _opened(path) as file:
        _require_numeric(path, file.schema_arrow, source)
        wanted = dict.fromkeys([source.time_source, *(c.source for c in source.channels)])
        table = _read(path, file, tuple(wanted))
        stamps = _stamps(path, source, table.column(source.time_source))
        columns = {c.channel: _readings(table.column(c.source)) for c in source.channels}
    return wide_log(path, source, stamps, columns, {})


def parquet_time_span(path: Path, source: LogSource) -> tuple[int, int]:
    """First and last time stamp, from the time column alone.

    Raises
    ------
    LogError
        As `read_parquet_log`; ``log_empty`` where there is no row.
    """
    # Not from the statistics of row groups: to ask PyArrow 26 for those of a column whose metadata
    # are damaged ends the process, where reading the column raises.
    with _opened(path) as file:
        _require_columns(path, file.schema_arrow, [source.time_source])
        table = _read(path, file, (source.time_source,))
        stamps = _stamps(path, source, table.column(source.time_source))
    require_time(path, stamps, time_name(source))
    return span(path, [stamps.time_us[stamps.readable]])


@contextmanager
def _opened(path: Path) -> Iterator[pq.ParquetFile]:
    """An open file; what PyArrow raises on it, now or while it is read, becomes a `LogError`."""
    _require_magic(path)
    try:
        # Not memory mapped: a file cut by another process would end this one.
        with pq.ParquetFile(path, memory_map=False, page_checksum_verification=True) as file:
            yield file
    except pa.ArrowMemoryError as error:
        raise LogError(
            "log_too_large", path, f"it asks for more memory than there is: {error}"
        ) from error
    except (OSError, ValueError, TypeError, LookupError, OverflowError, pa.ArrowException) as error:
        # Also of kinds that PyArrow does not document, as for a wrong byte in a name.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError("log_damaged", path, f"the Parquet file cannot be read: {reason}") from error


def _require_magic(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(len(_MAGIC))
        size = file.seek(0, 2)
        file.seek(max(size - len(_MAGIC), 0))
        tail = file.read()
    if head != _MAGIC:
        raise LogError("log_not_parquet", path, "the file does not begin as Parquet does")
    if tail != _MAGIC or size < 12:
        raise LogError(
            "log_truncated", path, "the end of the Parquet file is missing: copy it again"
        )


def _require_columns(path: Path, schema: pa.Schema, wanted: Sequence[str]) -> None:
    for name in wanted:
        count = schema.names.count(name)
        if count > 1:
            raise LogError(
                "log_column_twice", path, f"{count} columns are called {name!r}: rename one"
            )
        if not count:
            raise LogError(
                "log_column_missing",
                path,
                f"no column {name!r}; there are " + ", ".join(map(repr, schema.names[:40])),
            )


def _require_numeric(path: Path, schema: pa.Schema, source: LogSource) -> None:
    _require_columns(path, schema, [source.time_source, *(c.source for c in source.channels)])
    for channel in source.channels:
        kind = schema.field(channel.source).type
        if not (
            pa.types.is_integer(kind)
            or pa.types.is_floating(kind)
            or pa.types.is_decimal(kind)
            or pa.types.is_null(kind)
        ):
            raise LogError(
                "log_type",
                path,
                f"column {channel.source!r} (channel {channel.channel}) is of type {kind}, which "
                "is no number",
                channel.source,
            )


def _read(path: Path, file: pq.ParquetFile, wanted: Sequence[str]) -> pa.Table:
    """The wanted columns, piece by piece: how many rows there are shows while they unfold."""
    batches: list[pa.RecordBatch] = []
    rows = 0
    for batch in file.iter_batches(batch_size=_BATCH_ROWS, columns=list(wanted)):
        rows += batch.num_rows
        if rows > MOST_ROWS:
            raise LogError("log_too_large", path, f"there are more than {MOST_ROWS} rows: split it")
        batches.append(batch)
    if rows != file.metadata.num_rows:
        claimed = file.metadata.num_rows
        raise LogError("log_damaged", path, f"it claims {claimed} rows and holds {rows}")
    empty = pa.schema([file.schema_arrow.field(name) for name in wanted])
    table = pa.Table.from_batches(batches, batches[0].schema if batches else empty)
    table.validate(full=True)
    # A part b of a nested column a comes along with a column of the name "a.b".
    if sorted(table.column_names) != sorted(wanted):
        there = ", ".join(table.column_names)
        raise LogError("log_column_twice", path, f"columns {there} go by the names asked for")
    return table


def _stamps(path: Path, source: LogSource, column: pa.ChunkedArray) -> TimeStamps:
    kind = column.type
    try:
        if pa.types.is_timestamp(kind):
            return from_arrow_timestamps(column, source.time_zone)
        if pa.types.is_string(kind) or pa.types.is_large_string(kind):
            return from_text(column.cast(pa.string()), source.time_format, source.time_zone)
    except TimeStampError as error:
        raise LogError("log_time", path, str(error), source.time_source) from error
    numeric = pa.types.is_integer(kind) or pa.types.is_float64(kind)
    if not numeric or source.time_format not in EPOCH_UNITS:
        # A float32 of seconds since 1970 moves in steps of 128 s.
        raise LogError(
            "log_time",
            path,
            f"a time column of type {kind} cannot be read as {source.time_format!r}: wanted are "
            "timestamps, text, or integers or float64 with time_format one of "
            + ", ".join(EPOCH_UNITS),
            source.time_source,
        )
    blank = np.nan if pa.types.is_floating(kind) else 0
    return from_epoch(pc.fill_null(column, blank).to_numpy(), source.time_format)


def _readings(column: pa.ChunkedArray) -> Readings:
    missing = column.is_null().to_numpy()
    # Not safe: an integer beyond 2**53 may lose its last digits, it is a measurement all the same.
    numbers = pc.fill_null(column.cast(pa.float64(), safe=False), np.nan)
    raw: NDArray[np.float64] = numbers.to_numpy()
    return Readings(raw, missing, np.zeros(missing.size, dtype=np.bool_))

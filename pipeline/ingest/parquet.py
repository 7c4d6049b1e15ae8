"""Logs as Parquet, written by others, read with PyArrow and validated before any figure is used.

Other readers were seen to abort on malformed files or to read them without a word. Text may be
repeated any number of times by a few bytes: its columns are read as dictionaries, and written out
only where that is of a size that a log can have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.config.logs import EPOCH_UNITS, EXCEL_DAYS
from pipeline.errors import LogError
from pipeline.ingest.assembly import readings_of
from pipeline.ingest.cells import is_number, is_text
from pipeline.ingest.contract import LogFile, RawLog, Reader
from pipeline.ingest.table import Columns, RawTable, require_columns, wanted_columns
from pipeline.ingest.time_stamps import WrittenStamps, parse_written

MOST_ROWS = 2**27
"""Two weeks at 100 Hz. A file of a few kilobytes may claim, and decode to, any number of rows."""

MOST_ROWS_A_BYTE = 10_000
"""Beyond a day at 100 Hz. A day of a motor that stands still, packed as tightly as can be, has
4900; a file made for the purpose had 48 000 in 2.5 kB."""

_BATCH_ROWS = 2**18
# A day at 10 Hz: its columns are kept as they come, where those of several batches are copied.
_ROWS_AT_ONCE = 2**20
_ROWS_OF_A_DAY = 24 * 3600 * 100

MOST_TEXT_A_ROW = 256
"""Bytes of a stamp, a name or a quality, on average over some rows."""

_SLACK = 2**22
_MAGIC = b"PAR1"


def _read(file: LogFile) -> RawLog:
    """Read the wanted columns of a Parquet file."""
    return _gather(file, wanted_columns(file)).log({})


def _span(file: LogFile) -> tuple[int, int]:
    """Return first and last time stamp, from the time column alone."""
    # Not from the statistics of row groups: to ask PyArrow 26 for those of a column whose metadata
    # are damaged ends the process, where reading the column raises.
    return _gather(file, Columns(wanted_columns(file).time)).span()


def _gather(file: LogFile, columns: Columns) -> RawTable:
    """Read the wanted columns, some rows at a time, so that memory holds the readings alone."""
    path, logs = file.path, file.logs
    table = RawTable(file, columns, partial(_stamps, file), lambda _, cells: readings_of(cells))
    with open_parquet(path) as opened_file:
        kinds = kinds_of(opened_file)
        require_columns(path, kinds.names, columns.all)
        for name in columns.numbers:
            kind = kinds.field(name).type
            if not (is_number(kind) or pa.types.is_null(kind)):
                channels = ", ".join(
                    known
                    for known, channel in file.channels.items()
                    if logs.layout != "wide" or channel.source == name
                )
                how = f"column {name!r} (channel {channels}) is of type {kind}, which is no number"
                raise LogError("log_type", path, how, name)
        if columns.name is not None and not is_text(kinds.field(columns.name).type):
            how = f"column {columns.name!r} holds no names of channels"
            raise LogError("log_type", path, how, columns.name)
        texts = [name for name in text_paths(kinds) if name in columns.all]
        if not texts:
            _add_rows(table, path, opened_file, columns.all)
            return table
    with open_parquet(path, texts) as opened_file:
        _add_rows(table, path, opened_file, columns.all)
    return table


def _add_rows(table: RawTable, path: Path, file: pq.ParquetFile, columns: Sequence[str]) -> None:
    """Add the rows of a file to a table of its columns."""
    for batch in _batches(path, file, list(columns)):
        cells = flat(pa.Table.from_batches([batch]))
        parts = {name: decode(path, name, cells[name].chunk(0)) for name in columns}
        table.add({name: pa.chunked_array([part]) for name, part in parts.items()})


def _batches(path: Path, file: pq.ParquetFile, wanted: list[str]) -> Iterator[pa.RecordBatch]:
    """Yield the wanted columns, piece by piece: how many rows there are shows while they unfold."""
    rows = 0
    _require_fewer(path, file.metadata.num_rows)
    size = _ROWS_AT_ONCE if file.metadata.num_rows <= _ROWS_AT_ONCE else _BATCH_ROWS
    for batch in file.iter_batches(batch_size=size, columns=wanted, use_threads=False):
        rows += batch.num_rows
        _require_fewer(path, rows)
        batch.validate(full=True)
        yield batch
    if rows != file.metadata.num_rows:
        claimed = file.metadata.num_rows
        raise LogError("log_damaged", path, f"it claims {claimed} rows and holds {rows}")


def _require_fewer(path: Path, rows: int) -> None:
    """Refuse more rows than fit into memory, or than so few bytes can be a log of."""
    if rows > MOST_ROWS:
        raise LogError("log_too_large", path, f"there are more than {MOST_ROWS} rows: split it")
    size = path.stat().st_size
    if rows > max(_ROWS_OF_A_DAY, MOST_ROWS_A_BYTE * size):
        raise LogError(
            "log_too_large",
            path,
            f"its {size} bytes expand to {rows} rows or more, too many for a log: check its "
            "content",
        )


def _stamps(file: LogFile, columns: Sequence[pa.ChunkedArray]) -> WrittenStamps:
    path, logs = file.path, file.logs
    if len(columns) > 1 and not all(is_text(part.type) for part in columns):
        raise LogError("log_time", path, "date and time in columns of their own are to be text")
    kind = columns[-1].type
    numeric = pa.types.is_integer(kind) or pa.types.is_float64(kind)
    if not (
        pa.types.is_timestamp(kind)
        or is_text(kind)
        or (numeric and logs.time_format in (*EPOCH_UNITS, EXCEL_DAYS))
    ):
        # A float32 of seconds since 1970 moves in steps of 128 s.
        raise LogError(
            "log_time",
            path,
            f"a time column of type {kind} cannot be read as {logs.time_format!r}: wanted are "
            "timestamps, text, or integers or float64 with time_format one of "
            + ", ".join((*EPOCH_UNITS, EXCEL_DAYS)),
            logs.time,
        )
    return parse_written(columns, logs.time_format)


@contextmanager
def open_parquet(path: Path, dictionaries: Sequence[str] = ()) -> Iterator[pq.ParquetFile]:
    """Open a file, some columns of which are read as dictionaries.

    PyArrow's errors, now or while it is read, become a `LogError`.
    """
    _require_magic(path)
    try:
        # Not memory mapped: a file cut by another process would end this.
        # Opened here: PyArrow takes no name that is not UTF-8.
        with (
            path.open("rb") as opened_file,
            pq.ParquetFile(
                opened_file,
                memory_map=False,
                page_checksum_verification=True,
                read_dictionary=list(dictionaries),
            ) as file,
        ):
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


def flat(table: pa.Table) -> pa.Table:
    """Return a table with the columns within columns by their paths."""
    while any(map(pa.types.is_struct, table.schema.types)):
        table = table.flatten()
    return table


def kinds_of(file: pq.ParquetFile) -> pa.Schema:
    """Return all columns by their paths, with the types of their cells."""
    return pa.schema(
        field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field
        for field in flat(file.schema_arrow.empty_table()).schema
    )


def text_paths(schema: pa.Schema) -> list[str]:
    """Return the columns of text."""
    return [field.name for field in schema if is_text(field.type)]


def decode(path: Path, name: str, column: pa.Array) -> pa.Array:
    """Return a column without a dictionary.

    Raises LogError: ``log_too_large``: its text is longer than any of a log.
    """
    if not pa.types.is_dictionary(column.type):
        return column
    if is_text(column.type.value_type):
        lengths = pc.binary_length(column.dictionary)
        size, rows = pc.sum(lengths.take(column.indices)).as_py() or 0, len(column)
        if size > MOST_TEXT_A_ROW * rows + _SLACK:
            how = f"column {name!r} expands to {size} bytes in {rows} rows, too many for a log: "
            raise LogError("log_too_large", path, how + "check its content", name)
    return column.dictionary_decode()


READER = Reader(_read, _span)

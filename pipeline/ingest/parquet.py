"""Logs as Parquet, written by others.

They are read with PyArrow and validated in full before any figure is used: a footer that reads
proves nothing, and other readers were seen to abort on malformed files or to read them without a
word. Checksums of pages are verified where the writer left them. Text may be repeated any number of
times by a few bytes: its columns are read as dictionaries, each text once, and written out only
where that is of a size that a log can have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.config.logs import Logs
from pipeline.config.time_formats import EPOCH_UNITS, EXCEL_DAYS
from pipeline.errors import LogError
from pipeline.ingest.arrow_types import is_number, is_text
from pipeline.ingest.assembly import readings_of
from pipeline.ingest.contract import LogFile, RawLog, Reader
from pipeline.ingest.table import Columns, RawTable, wanted_columns
from pipeline.ingest.time_stamps import WrittenStamps, written

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

Place = tuple[str, ...]
"""Names of a column and of the fields within it."""

_SLACK = 2**22
_MAGIC = b"PAR1"


def read_parquet_log(log: LogFile) -> RawLog:
    """Read the wanted columns of a Parquet file."""
    table = RawTable(log)
    _gather(log.path, wanted_columns(log), table)
    return table.log({})


def parquet_units(log: LogFile) -> dict[str, str]:
    """Units in the metadata of columns."""
    with opened(log.path) as file:
        told = {one.name: (one.metadata or {}).get(b"unit", b"") for one in file.schema_arrow}
    return {name: unit.decode(errors="replace") for name, unit in told.items()}


def parquet_time_span(log: LogFile) -> tuple[int, int]:
    """First and last time stamp, from the time column alone."""
    # Not from the statistics of row groups: to ask PyArrow 26 for those of a column whose metadata
    # are damaged ends the process, where reading the column raises.
    table = RawTable(log)
    times = wanted_columns(log).time
    _gather(log.path, Columns(times, None, ()), table)
    return table.span()


def _gather(path: Path, columns: Columns, table: RawTable) -> None:
    """Read the wanted columns, some rows at a time, so that memory holds the readings alone."""
    with opened(path) as file:
        places = {name: place_of(path, file.schema_arrow, name) for name in columns.all}
        _require_types(table, columns, file.schema_arrow, places)
        wanted = [".".join(place) for place in places.values()]
        texts = [name for name in text_paths(file.schema_arrow) if name in wanted]
    with opened(path, texts) as file:
        for batch in _batches(path, file, places):
            found: Mapping[str, pa.ChunkedArray] = {
                name: pa.chunked_array([within(path, batch, place)])
                for name, place in places.items()
            }
            found = table.of_motor(columns, found)
            table.add(
                _stamps(path, table.logs, [found[name] for name in columns.time]),
                {name: readings_of(found[name]) for name in columns.numbers},
                columns.channel_names(found),
                {name: found[name] for name in columns.qualities},
            )


def _kind(schema: pa.Schema, place: Place) -> pa.DataType:
    """Type of a column, that of its values where it is a dictionary."""
    kind = schema.field(place[0]).type
    for name in place[1:]:
        kind = kind.field(name).type
    return kind.value_type if pa.types.is_dictionary(kind) else kind


def _require_types(
    table: RawTable, columns: Columns, schema: pa.Schema, places: Mapping[str, Place]
) -> None:
    path = table.path
    for name in columns.numbers:
        kind = _kind(schema, places[name])
        if not (is_number(kind) or pa.types.is_null(kind)):
            channels = ", ".join(
                known
                for known, channel in table.channels.items()
                if table.logs.layout != "wide" or channel.source == name
            )
            raise LogError(
                "log_type",
                path,
                f"column {name!r} (channel {channels}) is of type {kind}, which is no number",
                name,
            )
    if columns.name is not None and not is_text(_kind(schema, places[columns.name])):
        raise LogError(
            "log_type", path, f"column {columns.name!r} holds no names of channels", columns.name
        )


def _batches(
    path: Path, file: pq.ParquetFile, places: Mapping[str, Place]
) -> Iterator[pa.RecordBatch]:
    """The wanted columns, piece by piece: how many rows there are shows while they unfold."""
    rows = 0
    tops = sorted({place[0] for place in places.values()})
    wanted = list(dict.fromkeys(".".join(place) for place in places.values()))
    _require_fewer(path, file.metadata.num_rows)
    size = _ROWS_AT_ONCE if file.metadata.num_rows <= _ROWS_AT_ONCE else _BATCH_ROWS
    for batch in file.iter_batches(batch_size=size, columns=wanted, use_threads=False):
        rows += batch.num_rows
        _require_fewer(path, rows)
        batch.validate(full=True)
        # A part b of a nested column a comes along with a column of the name "a.b".
        if sorted(batch.schema.names) != tops:
            there = ", ".join(batch.schema.names)
            raise LogError("log_column_twice", path, f"columns {there} go by the names asked for")
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


def _stamps(path: Path, logs: Logs, columns: Sequence[pa.ChunkedArray]) -> WrittenStamps:
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
    return written(columns, logs.time_format)


@contextmanager
def opened(path: Path, dictionaries: Sequence[str] = ()) -> Iterator[pq.ParquetFile]:
    """An open file, some columns of which are read as dictionaries.

    PyArrow's errors, now or while it is read, become a `LogError`.
    """
    _require_magic(path)
    try:
        # Not memory mapped: a file cut by another process would end this one.
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


def place_of(path: Path, schema: pa.Schema, name: str) -> Place:
    """Place of a column: at the top by its very name, or within others by its path."""
    count = schema.names.count(name)
    if count > 1:
        raise LogError("log_column_twice", path, f"{count} columns are called {name!r}: rename one")
    if count:
        return (name,)
    for top in schema.names:
        if name.startswith(top + ".") and schema.names.count(top) == 1:
            within = _place_within(schema.field(top).type, name[len(top) + 1 :])
            if within is not None:
                return (top, *within)
    raise LogError(
        "log_column_missing",
        path,
        f"no column {name!r}; there are " + ", ".join(map(repr, _paths(schema)[:40])),
    )


def _place_within(kind: pa.DataType, rest: str) -> Place | None:
    if not pa.types.is_struct(kind):
        return None
    for field in kind:
        if rest == field.name:
            return (field.name,)
        if rest.startswith(field.name + "."):
            within = _place_within(field.type, rest[len(field.name) + 1 :])
            if within is not None:
                return (field.name, *within)
    return None


def _paths(fields: Iterable[pa.Field], above: str = "") -> list[str]:
    """All columns by their paths, for a message."""
    found: list[str] = []
    for field in fields:
        nested = pa.types.is_struct(field.type)
        found += _paths(field.type, f"{above}{field.name}.") if nested else [above + field.name]
    return found


def text_paths(fields: Iterable[pa.Field], above: str = "") -> list[str]:
    """Paths of all columns of text, those within others too."""
    found: list[str] = []
    for field in fields:
        path = above + field.name
        if pa.types.is_struct(field.type):
            found += text_paths(field.type, f"{path}.")
        elif is_text(field.type):
            found.append(path)
    return found


def decoded(path: Path, name: str, column: pa.Array) -> pa.Array:
    """A column without a dictionary.

    Raises
    ------
    LogError
        ``log_too_large``: its text is longer than any of a log.
    """
    if not pa.types.is_dictionary(column.type):
        return column
    if is_text(column.type.value_type):
        lengths = pc.binary_length(column.dictionary)
        _require_short(path, name, pc.sum(lengths.take(column.indices)).as_py() or 0, len(column))
    return column.dictionary_decode()


def _require_short(path: Path, name: str, size: int, rows: int) -> None:
    if size > MOST_TEXT_A_ROW * rows + _SLACK:
        raise LogError(
            "log_too_large",
            path,
            f"column {name!r} expands to {size} bytes in {rows} rows, too many for a log: check "
            "its content",
            name,
        )


def within(path: Path, batch: pa.RecordBatch, place: Place) -> pa.Array:
    """The column at a place, of its names from the top inwards; null where one around it is."""
    column = batch.column(place[0])
    if len(place) > 1:
        column = pc.struct_field(column, list(place[1:]))
    return decoded(path, ".".join(place), column)


READER = Reader(read_parquet_log, parquet_time_span, units=parquet_units)

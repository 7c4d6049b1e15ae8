"""Parquet files of others, opened with PyArrow, and their columns by paths.

Checksums of pages are verified where the writer left them. Text may be repeated any number of times
by a few bytes: its columns are read as dictionaries, each text once, and written out only where
that is of a size that a log can have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.errors import LogError
from pipeline.ingest.arrow_types import is_text

MOST_TEXT_A_ROW = 256
"""Bytes of a stamp, a name or a quality, on average over some rows."""

Place = tuple[str, ...]
"""Names of a column and of the fields within it."""

_SLACK = 2**22
_MAGIC = b"PAR1"


@contextmanager
def opened(path: Path, dictionaries: Sequence[str] = ()) -> Iterator[pq.ParquetFile]:
    """An open file, some columns of which are read as dictionaries.

    PyArrow's errors, now or while it is read, become a `LogError`.
    """
    _require_magic(path)
    try:
        # Not memory mapped: a file cut by another process would end this one.
        with pq.ParquetFile(
            path,
            memory_map=False,
            page_checksum_verification=True,
            read_dictionary=list(dictionaries),
        ) as file:
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

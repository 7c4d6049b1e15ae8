"""The columns of a Parquet file, by their paths, with the first cells of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.errors import LogError
from pipeline.ingest.guess_layout import SAMPLES, Column, Kind, kind_of
from pipeline.ingest.parquet_text import decoded, text_paths

_HEAD_ROWS = 400
_BATCH_ROWS = 2**17


@contextmanager
def _opened(path: Path) -> Iterator[pq.ParquetFile]:
    """An open file, all text of which is read as dictionaries."""
    try:
        texts = text_paths(pq.read_schema(path, memory_map=False))
        with pq.ParquetFile(path, memory_map=False, read_dictionary=texts) as file:
            yield file
    except pa.ArrowMemoryError as error:
        raise MemoryError from error
    except (OSError, ValueError, TypeError, LookupError, OverflowError, pa.ArrowException) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError("log_damaged", path, f"the Parquet file cannot be read: {reason}") from error


def parquet_columns(path: Path) -> list[Column]:
    """Columns that can be read, those within others by their path, with their first cells.

    Raises
    ------
    LogError
        ``log_damaged``; ``log_empty`` for a file without columns.
    """
    with _opened(path) as file:
        head = next(file.iter_batches(batch_size=_HEAD_ROWS), None)
        schema = file.schema_arrow
        if head is None:
            head = pa.RecordBatch.from_pylist([], schema=schema)
        head.validate(full=True)
        columns = [
            column
            for field, values in zip(schema, head.columns, strict=True)
            if schema.names.count(field.name) == 1
            for column in _columns(path, field.name, field, values)
        ]
    if not columns:
        raise LogError("log_empty", path, "the file has no columns that can be read")
    return columns


def _columns(path: Path, name: str, field: pa.Field, values: pa.Array) -> Iterator[Column]:
    if pa.types.is_struct(field.type):
        for inner in field.type:
            below = pc.struct_field(values, inner.name)
            yield from _columns(path, f"{name}.{inner.name}", inner, below)
        return
    values = decoded(path, name, values)
    unit = (field.metadata or {}).get(b"unit", b"").decode(errors="replace")
    if pa.types.is_timestamp(values.type):
        # In the place of a unit: what the type says of the zone.
        yield Column(name, values.type.tz or "", "timestamp", ())
        return
    kind = _kind(values)
    if kind is not None:
        cells = tuple("" if cell is None else str(cell) for cell in values.to_pylist())
        yield Column(name, unit, kind_of(cells) if kind == "text" else kind, cells)


def _kind(values: pa.Array) -> Kind | None:
    kind = values.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return "nothing" if values.null_count == len(values) else "number"
    if pa.types.is_null(kind):
        return "nothing"
    return "text" if pa.types.is_string(kind) or pa.types.is_large_string(kind) else None


def parquet_scan(path: Path, names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """The first rows of each value of the first of some columns, piece by piece of the file.

    Parameters
    ----------
    path
        The file.
    names
        Columns by their paths, the first one of text.
    """
    with _opened(path) as file:
        for batch in file.iter_batches(batch_size=_BATCH_ROWS, columns=list(names)):
            batch.validate(full=True)
            columns = [_within(batch, name) for name in names]
            first = columns[0]
            encoded = first if pa.types.is_dictionary(first.type) else first.dictionary_encode()
            codes = pc.fill_null(encoded.indices, -1).to_numpy()
            for code in np.unique(codes[codes >= 0]).tolist():
                rows = pa.array(np.flatnonzero(codes == code)[:SAMPLES])
                picked = [column.take(rows).to_pylist() for column in columns]
                for row in zip(*picked, strict=True):
                    yield tuple("" if cell is None else str(cell) for cell in row)


def _within(batch: pa.RecordBatch, name: str) -> pa.Array:
    top = name if name in batch.schema.names else name.split(".")[0]
    column = batch.column(top)
    if top != name:
        column = pc.struct_field(column, name.split(".")[1:])
    return column

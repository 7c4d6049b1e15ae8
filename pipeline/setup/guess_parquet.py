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
from pipeline.ingest.arrow_types import is_number, is_text
from pipeline.ingest.parquet import decoded, opened, place_of, text_paths, within
from pipeline.setup.guess_layout import SAMPLES, GuessedColumn, Kind, kind_of

_HEAD_ROWS = 400
_BATCH_ROWS = 2**17


@contextmanager
def _opened(path: Path) -> Iterator[pq.ParquetFile]:
    """An open file, all text of which is read as dictionaries."""
    with opened(path) as file:
        texts = text_paths(file.schema_arrow)
    with opened(path, texts) as file:
        yield file


def parquet_columns(path: Path) -> list[GuessedColumn]:
    """Columns that can be read, those within others by their path, with their first cells."""
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


def _columns(path: Path, name: str, field: pa.Field, values: pa.Array) -> Iterator[GuessedColumn]:
    if pa.types.is_struct(field.type):
        for inner in field.type:
            below = pc.struct_field(values, inner.name)
            yield from _columns(path, f"{name}.{inner.name}", inner, below)
        return
    values = decoded(path, name, values)
    unit = (field.metadata or {}).get(b"unit", b"").decode(errors="replace")
    if pa.types.is_timestamp(values.type):
        # In the place of a unit: what the type says of the zone.
        yield GuessedColumn(name, values.type.tz or "", "timestamp", ())
        return
    kind = _kind(values)
    if kind is not None:
        cells = tuple("" if cell is None else str(cell) for cell in values.to_pylist())
        yield GuessedColumn(name, unit, kind_of(cells) if kind == "text" else kind, cells)


def _kind(values: pa.Array) -> Kind | None:
    kind = values.type
    if is_number(kind):
        return "nothing" if values.null_count == len(values) else "number"
    if pa.types.is_null(kind):
        return "nothing"
    return "text" if is_text(kind) else None


def parquet_scan(path: Path, names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """The first rows of each value of the first of some columns, which is of text, by pieces."""
    with _opened(path) as file:
        places = [place_of(path, file.schema_arrow, name) for name in names]
        for batch in file.iter_batches(batch_size=_BATCH_ROWS, columns=list(names)):
            batch.validate(full=True)
            columns = [within(path, batch, place) for place in places]
            encoded = columns[0].dictionary_encode()
            codes = pc.fill_null(encoded.indices, -1).to_numpy()
            for code in np.unique(codes[codes >= 0]).tolist():
                rows = pa.array(np.flatnonzero(codes == code)[:SAMPLES])
                picked = [column.take(rows).to_pylist() for column in columns]
                for row in zip(*picked, strict=True):
                    yield tuple("" if cell is None else str(cell) for cell in row)

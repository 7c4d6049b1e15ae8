"""Rows as Parquet files: encoded, and decoded with the checksums of their pages."""

from __future__ import annotations

import hashlib
import json
import zlib
from bisect import bisect_left
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError
from pipeline.schema import SCHEMA_VERSION
from pipeline.store.atomic_files import Prepared, prepare

VERSION_KEY = "motor_leakage_schema_version"
# What the footer says of types and row groups, once more and with a checksum: of the footer's own
# words a flipped bit gives other rows, or ends the process.
INDEX_KEY = "motor_leakage_row_groups"
INDEXED = ("motor_id", "night")
# Rows of a row group: the writer needs memory for one of them, and a reader of some motors or
# nights leaves the others out.
ROWS_A_GROUP = 16_384
# Sizes of packed columns tell one state of a file from another: an engine that opens a file before
# and after it is replaced finds no pages where the old footer has them. With Snappy, which is three
# times as quick, columns of as many numbers are often of one size.
COMPRESSION = "zstd"
# Raised by reading a damaged file; a damaged name gives UnicodeDecodeError, a ValueError.
DAMAGE = (OSError, ValueError, pa.ArrowException, PolarsError, PanicException)


def write_table(path: Path, rows: pl.DataFrame) -> str:
    """Write a table file whole or not at all, and return its SHA-256; raises as `prepare_table`."""
    prepared = prepare_table(path, [rows])
    prepared.land()
    return prepared.sha256


def prepare_table(path: Path, pieces: Iterable[pl.DataFrame]) -> Prepared:
    """Prepare a file whose rows come in pieces; a row group at a time is in memory.

    Raises StoreError if they cannot be written, or are decoded otherwise; nothing is left then.
    """
    digests: list[bytes] = []
    try:
        prepared = prepare(path, lambda stream: digests.extend(_write(stream, pieces)))
        try:
            _require_same(prepared.temporary, digests)
        except BaseException:
            prepared.drop()
            raise
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError("store_write", f"{path.name} cannot be written: {error}") from error
    return prepared


def _require_same(path: Path, digests: Sequence[bytes]) -> None:
    """Raise ValueError where row groups are not decoded as they were encoded."""
    with opened(path) as file:
        if [_digest(rows) for rows in row_groups(file)] != digests:
            raise ValueError("what is read back is not what was written")


def _digest(rows: pl.DataFrame) -> bytes:
    """Digest of all cells of some rows, and of their types."""
    cells = rows.hash_rows().to_numpy().tobytes()
    return hashlib.sha256(repr(rows.schema).encode() + cells).digest()


def as_parquet(rows: pl.DataFrame, version: int) -> bytes:
    """Rows as the bytes of a Parquet file of a schema version."""
    stream = pa.BufferOutputStream()
    _write(stream, [rows], version)
    encoded: bytes = stream.getvalue().to_pybytes()
    return encoded


def _write(
    stream: Any, pieces: Iterable[pl.DataFrame], version: int = SCHEMA_VERSION
) -> list[bytes]:
    """Write rows to a stream; returns a digest of each row group."""
    groups = _slices(pieces)
    first = next(groups)
    schema = _arrow(first).schema
    texts = [column.name for column in schema if pa.types.is_large_string(column.type)]
    digests: list[bytes] = []
    index: list[tuple[int, dict[str, tuple[str, str]]]] = []
    with pq.ParquetWriter(
        stream,
        schema,
        compression=COMPRESSION,
        use_dictionary=texts,
        write_page_checksum=True,
        store_schema=False,
    ) as file:
        for rows in chain([first], groups):
            digests.append(_digest(rows))
            index.append((rows.height, _extremes(rows)))
            file.write_table(_arrow(rows), row_group_size=max(rows.height, 1))
        told = json.dumps([_types(first), index], separators=(",", ":"))
        # Metadata of the schema would be left out with it.
        file.add_key_value_metadata({VERSION_KEY: str(version), INDEX_KEY: _checksum(told) + told})
    return digests


def _types(rows: pl.DataFrame) -> dict[str, str]:
    return {name: str(kind) for name, kind in rows.schema.items()}


def _extremes(rows: pl.DataFrame) -> dict[str, tuple[str, str]]:
    """Smallest and largest value of the columns by which row groups are found."""
    found = {name: rows[name].drop_nulls().cast(pl.String) for name in INDEXED if name in rows}
    return {name: (str(some.min()), str(some.max())) for name, some in found.items() if len(some)}


def _checksum(text: str) -> str:
    return f"{zlib.crc32(text.encode()):08x}"


def _arrow(rows: pl.DataFrame) -> pa.Table:
    return rows.to_arrow(compat_level=pl.CompatLevel.oldest())


def _slices(pieces: Iterable[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Row groups, the same however the rows come in pieces."""
    waiting: list[pl.DataFrame] = []
    for rows in pieces:
        waiting.append(rows)
        if sum(one.height for one in waiting) > ROWS_A_GROUP:
            every = pl.concat(waiting)
            whole = (every.height - 1) // ROWS_A_GROUP * ROWS_A_GROUP
            for begin in range(0, whole, ROWS_A_GROUP):
                yield every.slice(begin, ROWS_A_GROUP).rechunk()
            waiting = [every.slice(whole)]
    yield pl.concat(waiting, rechunk=True)


@contextmanager
def opened(place: bytes | Path) -> Iterator[pq.ParquetFile]:
    """A Parquet file, by its content or its path."""
    source = place if isinstance(place, Path) else pa.BufferReader(place)
    with pq.ParquetFile(source, page_checksum_verification=True) as file:
        yield file


def row_groups(
    file: pq.ParquetFile,
    columns: Sequence[str] | None = None,
    wanted: Mapping[str, Collection[Any]] | None = None,
) -> Iterator[pl.DataFrame]:
    """Row groups of a file in turn; only those that may hold some wanted values of columns.

    Raises ValueError where the footer is damaged.
    """
    told = (file.metadata.metadata or {}).get(INDEX_KEY.encode(), b"").decode()
    if told and _checksum(told[8:]) != told[:8]:
        raise ValueError("the index of its row groups is damaged")
    types, index = json.loads(told[8:]) if told else ({}, [])
    if told and len(index) != file.num_row_groups:
        raise ValueError(f"it has {file.num_row_groups} row groups; expected {len(index)}")
    asked = {name: sorted(map(str, some)) for name, some in (wanted or {}).items()}
    for place in range(file.num_row_groups):
        height, extremes = index[place] if told else (None, {})
        if not all(_may_hold(extremes[name], asked[name]) for name in asked.keys() & extremes):
            continue
        table = file.read_row_group(place, columns=columns, use_threads=False)
        rows = pl.from_arrow(table)
        assert isinstance(rows, pl.DataFrame)
        if told and (height != rows.height or not _types(rows).items() <= types.items()):
            raise ValueError("its footer is damaged: it tells other types or numbers of rows")
        yield rows


def _may_hold(extremes: Sequence[str], values: Sequence[str]) -> bool:
    """True if one of some values, in order, lies between two."""
    place = bisect_left(values, extremes[0])
    return place < len(values) and values[place] <= extremes[1]

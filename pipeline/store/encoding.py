"""Rows as Parquet files: encoded, and decoded with the checksums of their pages.

A joined file holds several nights (or runs), one after the other; its footer says which, with their
numbers of rows.
"""

from __future__ import annotations

import hashlib
import json
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate, chain
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from polars.exceptions import PanicException, PolarsError

from pipeline.errors import StoreError
from pipeline.schema import SCHEMA_VERSION
from pipeline.store.atomic_files import Prepared, prepare, put

VERSION_KEY = "motor_leakage_schema_version"
# Nights (or runs) of a joined file and their numbers of rows, in the order of its rows.
PARTS_KEY = "motor_leakage_parts"
# Joined nights share a row group up to about so many rows.
ROWS_A_GROUP = 122_880
# Rows of a row group of a night: the writer needs memory for one of them, not for all motors.
ROWS_A_SLICE = 4_096
# Sizes of packed columns tell one state of a file from another: an engine that opens a file before
# and after it is replaced finds no pages where the old footer has them. With Snappy, which is three
# times as quick, columns of as many numbers are often of one size.
COMPRESSION = "zstd"
# Raised by reading a damaged file; a damaged name gives UnicodeDecodeError, a ValueError.
DAMAGE = (OSError, ValueError, pa.ArrowException, PolarsError, PanicException)


def write_table(path: Path, rows: pl.DataFrame) -> str:
    """Write a table file whole or not at all, and return its SHA-256.

    Raises StoreError if it cannot be written; the old file then stays.
    """
    return put(path, encode_table(path.name, rows))


def encode_table(name: str, rows: pl.DataFrame) -> bytes:
    """Rows as the bytes of a Parquet file; raises as `prepare_table`."""
    stream = pa.BufferOutputStream()
    with _told_of(name):
        digests = _write_slices(stream, [rows])
        encoded = stream.getvalue()
        _require_same(_opened(encoded), digests)
    return bytes(encoded)


def prepare_table(path: Path, pieces: Iterable[pl.DataFrame]) -> Prepared:
    """Prepare the file of a night, whose rows come in pieces; a row group at a time is in memory.

    Raises StoreError if they cannot be written, or are decoded otherwise; nothing is left then.
    """
    digests: list[bytes] = []
    with _told_of(path.name):
        prepared = prepare(path, lambda stream: digests.extend(_write_slices(stream, pieces)))
        try:
            _require_same(_opened(prepared.temporary), digests)
        except BaseException:
            prepared.drop()
            raise
    return prepared


@contextmanager
def _told_of(name: str) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError("store_write", f"{name} cannot be written: {error}") from error


def _require_same(file: pq.ParquetFile, digests: Sequence[bytes]) -> None:
    """Raise ValueError where row groups are not decoded as they were encoded."""
    places = range(file.num_row_groups)
    decoded = (_frame(file.read_row_group(place, use_threads=False)) for place in places)
    with file:
        if [_digest(rows) for rows in decoded] != digests:
            raise ValueError("what is read back is not what was written")


def _digest(rows: pl.DataFrame) -> bytes:
    """Digest of all cells of some rows, and of their types."""
    cells = rows.hash_rows().to_numpy().tobytes()
    return hashlib.sha256(repr(rows.schema).encode() + cells).digest()


def as_parquet(rows: pl.DataFrame, version: int, parts: Mapping[str, int] | None = None) -> bytes:
    """Rows as the bytes of a Parquet file of a schema version; of a joined one, given its parts."""
    stream = pa.BufferOutputStream()
    if parts:
        begins = accumulate(parts.values(), initial=0)
        named = zip(parts.items(), begins, strict=False)
        nights = ((name, rows.slice(begin, count)) for (name, count), begin in named)
        write_parts(stream, nights, version)
    else:
        _write_slices(stream, [rows], version)
    encoded: bytes = stream.getvalue().to_pybytes()
    return encoded


def write_parts(
    stream: Any, parts: Iterable[tuple[str, pl.DataFrame]], version: int = SCHEMA_VERSION
) -> None:
    """Write a joined file of the rows of named nights to a stream."""
    counts: list[tuple[str, int]] = []

    def counted() -> Iterator[pl.DataFrame]:
        for name, rows in parts:
            counts.append((name, rows.height))
            yield rows

    def told() -> dict[str, str]:
        return {VERSION_KEY: str(version), PARTS_KEY: json.dumps(counts, separators=(",", ":"))}

    _write(stream, row_groups(counted()), told)


def _write_slices(
    stream: Any, pieces: Iterable[pl.DataFrame], version: int = SCHEMA_VERSION
) -> list[bytes]:
    """Write a night's rows to a stream; returns a digest of each row group."""
    digests: list[bytes] = []

    def groups() -> Iterator[pl.DataFrame]:
        for rows in slices(pieces):
            digests.append(_digest(rows))
            yield rows

    _write(stream, groups(), lambda: {VERSION_KEY: str(version)})
    return digests


def _write(stream: Any, groups: Iterator[pl.DataFrame], told: Callable[[], dict[str, str]]) -> None:
    """Write row groups, then the metadata of the file."""
    tables = (one.to_arrow(compat_level=pl.CompatLevel.oldest()) for one in groups)
    first = next(tables)
    texts = [column.name for column in first.schema if pa.types.is_large_string(column.type)]
    with pq.ParquetWriter(
        stream,
        first.schema,
        compression=COMPRESSION,
        use_dictionary=texts,
        write_page_checksum=True,
        store_schema=False,
    ) as file:
        for table in chain([first], tables):
            file.write_table(table, row_group_size=max(table.num_rows, 1))
        # Metadata of the schema would be left out with it.
        file.add_key_value_metadata(told())


def slices(pieces: Iterable[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Row groups of a night, the same however its rows come in pieces."""
    rest: list[pl.DataFrame] = []
    for rows in pieces:
        rest.append(rows)
        while sum(one.height for one in rest) > ROWS_A_SLICE:
            every = pl.concat(rest)
            yield every.head(ROWS_A_SLICE).rechunk()
            rest = [every.slice(ROWS_A_SLICE)]
    yield pl.concat(rest, rechunk=True)


def _frame(table: pa.Table) -> pl.DataFrame:
    rows = pl.from_arrow(table)
    assert isinstance(rows, pl.DataFrame)
    return rows


def _opened(place: bytes | pa.Buffer | Path) -> pq.ParquetFile:
    source = place if isinstance(place, Path) else pa.BufferReader(place)
    return pq.ParquetFile(source, page_checksum_verification=True)


def row_groups(parts: Iterable[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Nights put together up to the rows of a row group; each lies whole in one."""
    waiting: list[pl.DataFrame] = []
    for rows in parts:
        waiting.append(rows)
        if sum(one.height for one in waiting) >= ROWS_A_GROUP:
            yield pl.concat(waiting, rechunk=True)
            waiting = []
    if waiting:
        yield pl.concat(waiting, rechunk=True)


def from_parquet(
    encoded: bytes, names: Collection[str] | None = None, columns: Sequence[str] | None = None
) -> pa.Table:
    """Rows of a file's content; of a joined file those of some nights alone, if they are named."""
    file = _opened(encoded)
    parts = parts_told(file.metadata)
    if names is None or not parts:
        return file.read(columns=columns, use_threads=False)
    sizes = (file.metadata.row_group(place).num_rows for place in range(file.num_row_groups))
    begins = list(accumulate(sizes, initial=0))
    groups: dict[int, pa.Table] = {}
    found, begin = [], 0
    for name, count in parts.items():
        if name in names:
            # A night lies in one row group; one without rows may lie behind the last.
            place = min(bisect_right(begins, begin), file.num_row_groups) - 1
            if place not in groups:
                groups[place] = file.read_row_group(place, columns=columns, use_threads=False)
            found.append(groups[place].slice(begin - begins[place], count))
        begin += count
    return pa.concat_tables(found or [file.read_row_group(0, columns=columns).slice(0, 0)])


def parts_of(path: Path) -> dict[str, int]:
    """Numbers of rows of a file by night (or start of a run), in the order of its rows.

    Raises StoreError if its footer is damaged.
    """
    try:
        return parts_told(pq.read_metadata(path)) or {path.stem: 0}
    except DAMAGE as error:
        raise StoreError("store_read", f"{path.name} is damaged: {error}") from error


def parts_told(footer: pq.FileMetaData) -> dict[str, int]:
    """The same of a joined file; empty for another."""
    told = (footer.metadata or {}).get(PARTS_KEY.encode())
    return {} if told is None else {str(name): int(rows) for name, rows in json.loads(told)}

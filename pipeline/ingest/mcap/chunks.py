"""Chunks of an MCAP file: records that are packed together, with a checksum of their own."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.ingest.mcap.layout import LARGEST_CHUNK, PREFIX, column, fields_at, record_offsets

_CHUNK_HEAD = struct.Struct("<QQQII")
_COMPRESSIONS = {"": None, "lz4": "lz4", "zstd": "zstd"}
_INDEX_HEAD = 6
_MOST_GAPS = 64


def unpacked_chunk(path: Path, content: memoryview, where: str) -> memoryview:
    """The records of a chunk record's content; `where` it lies is for messages."""
    try:
        _, _, size, checksum, name_length = _CHUNK_HEAD.unpack_from(content)
        data_start = _CHUNK_HEAD.size + name_length + 8
        name = bytes(content[_CHUNK_HEAD.size : data_start - 8]).decode()
        (packed_size,) = struct.unpack_from("<Q", content, data_start - 8)
    except (struct.error, UnicodeDecodeError) as error:
        raise LogError("log_damaged", path, f"its head cannot be read: {error}", where) from error
    packed = content[data_start:][:packed_size]
    if len(packed) != packed_size:
        raise LogError("log_damaged", path, f"it claims {packed_size} bytes, not there", where)
    if size > LARGEST_CHUNK:
        raise LogError("log_too_large", path, f"it claims to decompress to {size} bytes", where)
    records = _decompress(path, name, packed, size, where)
    if checksum and zlib.crc32(records) != checksum:
        raise LogError("log_damaged", path, "its checksum is wrong", where)
    return records


def _decompress(path: Path, name: str, packed: memoryview, size: int, where: str) -> memoryview:
    if name not in _COMPRESSIONS:
        raise LogError(
            "log_compression", path, f"compression {name!r} is none of lz4, zstd, none", where
        )
    codec = _COMPRESSIONS[name]
    try:
        records = packed if codec is None else _unfolded(packed, codec, size)
    except (OSError, pa.ArrowException) as error:
        raise LogError("log_damaged", path, f"it does not decompress: {error}", where) from error
    if len(records) != size:
        raise LogError("log_damaged", path, f"it does not decompress to {size} bytes", where)
    return records


def _unfolded(packed: memoryview, codec: str, size: int) -> memoryview:
    """The bytes, as far as they go, but one more than `size` at most."""
    if codec == "zstd":
        with suppress(OSError):  # exactly so many bytes, or an error
            return memoryview(pa.decompress(packed, size, codec))
    with pa.CompressedInputStream(pa.BufferReader(pa.py_buffer(packed)), codec) as stream:
        return memoryview(stream.read_buffer(size + 1))


def record_size(records: memoryview) -> int:
    """Size of each record of a chunk; 0 unless all are of one kind and one size."""
    if len(records) < PREFIX.size:
        return 0
    size = PREFIX.size + PREFIX.unpack_from(records)[1]
    if len(records) % size:
        return 0
    heads = column(records, 0, f"V{PREFIX.size}", size).tobytes()
    return size if heads == heads[: PREFIX.size] * (len(records) // size) else 0


def indexed_positions(indexes: Sequence[memoryview]) -> NDArray[np.int64]:
    """Begins of messages in a chunk, in ascending order, as its message index records say."""
    parts = [np.empty(0, "<u8")]
    for index in indexes:
        numbers = max(len(index) - _INDEX_HEAD, 0) // 16 * 2
        times_and_positions = np.frombuffer(index[_INDEX_HEAD:], "<u8", numbers)
        parts.append(times_and_positions[1::2])
    # Too large ones become negative, and are then of no use.
    return np.sort(np.concatenate(parts).astype(np.int64), kind="stable")


def offsets_in_chunk(
    records: memoryview, positions: NDArray[np.int64]
) -> tuple[NDArray[np.int64], int]:
    """Begins of the records of a chunk, and the end of the last of them.

    Some of them may begin at the positions, which are in ascending order and believed only where
    each step, taken from the chunk's begin, leads from one to the next.
    """
    found = _steps(records, positions)
    if found is not None:
        return found, len(records)
    offsets, end = record_offsets(records)
    return np.array(offsets, np.int64), end


def _steps(records: memoryview, positions: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """All offsets; None where the positions are not among them."""
    if not positions.size or positions[0] < 0 or positions[-1] > len(records) - PREFIX.size:
        return None
    lengths = fields_at(records, positions + 1, "<u8")
    if lengths.max() > len(records):
        return None
    ends = np.append(0, positions + (PREFIX.size + lengths.astype(np.int64)))
    starts = np.append(positions, len(records))
    gaps = np.flatnonzero(ends != starts).tolist()
    if len(gaps) > _MOST_GAPS:
        return None
    parts = [positions]
    for gap in gaps:
        # Schemas and channels have no index.
        between, end = record_offsets(records[ends[gap] : starts[gap]])
        if ends[gap] + end != starts[gap]:
            return None
        parts.append(ends[gap] + np.array(between, np.int64))
    return np.sort(np.concatenate(parts), kind="stable")

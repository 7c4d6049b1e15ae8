"""Chunks of an MCAP file: records that are packed together, with a checksum of their own."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pyarrow as pa

from pipeline.errors import LogError
from pipeline.ingest.mcap_layout import LARGEST_CHUNK

_CHUNK_HEAD = struct.Struct("<QQQII")
_COMPRESSIONS = {"": None, "lz4": "lz4", "zstd": "zstd"}


def unpacked_chunk(path: Path, content: memoryview, where: str) -> memoryview:
    """The records of a chunk.

    Parameters
    ----------
    path, where
        File and place, for messages of errors.
    content
        The chunk record's.

    Raises
    ------
    LogError
        ``log_damaged``, ``log_compression``, ``log_too_large``.
    """
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
        raise LogError("log_too_large", path, f"it claims to unfold to {size} bytes", where)
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
        # As a stream: it unfolds no further than is asked for, and says how far it came.
        records = packed if codec is None else _first_bytes(packed, codec, size + 1)
    except (OSError, pa.ArrowException) as error:
        raise LogError("log_damaged", path, f"it does not unfold: {error}", where) from error
    if len(records) != size:
        raise LogError("log_damaged", path, f"it does not unfold to {size} bytes", where)
    return records


def _first_bytes(packed: memoryview, codec: str, count: int) -> memoryview:
    with pa.CompressedInputStream(pa.BufferReader(pa.py_buffer(packed)), codec) as stream:
        return memoryview(stream.read_buffer(count))

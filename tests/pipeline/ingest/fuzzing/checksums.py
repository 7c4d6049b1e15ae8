"""Bytes of a file that a checksum covers, found without the readers.

Parquet: `PageHeader` in ``parquet.thrift`` of apache/parquet-format, in Thrift's compact protocol.
MCAP: the records of https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq

_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _, _STRUCT = range(1, 13)
_COMPRESSED_SIZE, _CRC = 3, 4
_FOOTER, _CHUNK = 0x02, 0x06


def parquet_ranges(path: Path) -> list[tuple[int, int]]:
    """Begin and end of the body of each page that has a checksum.

    Parameters
    ----------
    path
        A valid file.
    """
    data = path.read_bytes()
    metadata = pq.read_metadata(path)
    ranges: list[tuple[int, int]] = []
    for group in range(metadata.num_row_groups):
        for number in range(metadata.num_columns):
            column = metadata.row_group(group).column(number)
            at = column.dictionary_page_offset or column.data_page_offset
            end = at + column.total_compressed_size
            while at < end:
                header, body = _struct(data, at)
                stop = body + header[_COMPRESSED_SIZE]
                if _CRC in header:
                    if zlib.crc32(data[body:stop]) != header[_CRC] % 2**32:
                        raise ValueError(f"no page at byte {at}")
                    ranges.append((body, stop))
                at = stop
    return ranges


def _struct(data: bytes, at: int) -> tuple[dict[int, int], int]:
    """Whole numbers of a struct by field, and where it ends."""
    found: dict[int, int] = {}
    number = 0
    while data[at]:
        step, kind = divmod(data[at], 16)
        at += 1
        if not step:
            raise ValueError("a long field header, which page headers do not have")
        number += step
        value, at = _value(data, at, kind)
        if value is not None:
            found[number] = value
    return found, at + 1


def _value(data: bytes, at: int, kind: int) -> tuple[int | None, int]:
    if kind in (_TRUE, _FALSE):
        return None, at
    if kind == _STRUCT:
        return None, _struct(data, at)[1]
    if kind == _DOUBLE:
        return None, at + 8
    if kind == _BYTE:
        return None, at + 1
    raw, at = _varint(data, at)
    if kind == _BINARY:
        return None, at + raw
    if kind in (_I16, _I32, _I64):
        return (raw >> 1) ^ -(raw & 1), at
    raise ValueError(f"type {kind}, which page headers do not have")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 128:
            return value, at


def has_blank_checksum(data: bytes) -> bool:
    """True if a chunk or the summary of an MCAP states that it has no checksum."""
    return any(
        not checksum
        for opcode, content in _records(data)
        for checksum in _checksum(opcode, content)
    )


def _checksum(opcode: int, content: bytes) -> Iterator[int]:
    if opcode == _CHUNK and len(content) >= 28:
        yield struct.unpack_from("<I", content, 24)[0]
    if opcode == _FOOTER and len(content) == 20:
        yield struct.unpack_from("<I", content, 16)[0]


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Records from the begin, as far as they go, and the footer."""
    at = 8
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        yield opcode, data[at + 9 : at + 9 + length]
        at += 9 + length
    if len(data) >= 37:
        yield data[-37], data[-28:-8]

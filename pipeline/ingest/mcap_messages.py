"""The messages of an MCAP file, as arrays of what their heads say and where their payloads lie.

Messages stand bare in the data section, or in compressed chunks, which hold records again. Only
stepping from length to length is done record by record; all fields are then taken at once.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.ingest.mcap_layout import (
    CHANNEL,
    CHUNK,
    DATA_END,
    LARGEST_CHUNK,
    LONGEST_RECORD,
    MAGIC,
    MESSAGE,
    PREFIX,
    Channel,
    Statistics,
    read_channel,
    read_summary,
    record_offsets,
)

_MESSAGE_HEAD = 31
"""Bytes before a payload: opcode, length, channel id, sequence, log time, publish time."""

_CHUNK_HEAD = struct.Struct("<QQQII")
_COMPRESSIONS = {"": None, "lz4": "lz4", "zstd": "zstd"}
_BLOCK = 8 * 2**20


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages that lie in one buffer, in the order of the file.

    Attributes
    ----------
    buffer
        Records, of which these messages are some.
    channels
        Channels declared so far, by id.
    channel_id : (n,) uint16
    log_time, publish_time : (n,) uint64
        [ns]
    payload_start, payload_end : (n,) int64
        Positions in the buffer.
    """

    buffer: memoryview
    channels: Mapping[int, Channel]
    channel_id: NDArray[np.uint16]
    log_time: NDArray[np.uint64]
    publish_time: NDArray[np.uint64]
    payload_start: NDArray[np.int64]
    payload_end: NDArray[np.int64]


def read_messages(path: Path) -> Iterator[Messages]:
    """All messages of a file, piece by piece in the order of the file.

    The last piece is empty and knows all channels, also those without a message. Checksums of
    chunks, data section and summary are checked where they are not zero, and the number of messages
    against what the summary says.

    Raises
    ------
    LogError
        ``log_not_mcap``, ``log_truncated``, ``log_damaged``, ``log_compression``,
        ``log_too_large``.
    """
    counts: NDArray[np.int64] = np.zeros(2**16, dtype=np.int64)
    channels: Mapping[int, Channel] = {}
    with path.open("rb") as file:
        summary = read_summary(path, file)
        for messages in _data_section(path, file, summary.start):
            channels = messages.channels
            present, times = np.unique(messages.channel_id, return_counts=True)
            counts[present] += times
            yield messages
    if summary.statistics is not None:
        _require_counts(path, summary.statistics, counts)
    nothing = np.empty(0, np.int64)
    yield _messages(path, memoryview(b""), nothing, {**summary.channels, **channels})


def _require_counts(path: Path, statistics: Statistics, counts: NDArray[np.int64]) -> None:
    wrong = [i for i, count in statistics.counts_by_channel.items() if counts[i] != count]
    if wrong or counts.sum() != statistics.message_count:
        raise LogError(
            "log_damaged",
            path,
            f"the file holds {counts.sum()} messages and its summary says "
            f"{statistics.message_count}, or they differ for some channel",
        )


def _data_section(path: Path, file: BinaryIO, end: int) -> Iterator[Messages]:
    """Messages of the data section, the last record of which has to be its end record."""
    channels: dict[int, Channel] = {}
    checksum = zlib.crc32(MAGIC)
    place, last_opcode = len(MAGIC), 0
    for block, offsets in _blocks(path, file, end):
        last = offsets[-1]
        last_opcode = block[last]
        if last_opcode == DATA_END:
            _require_checksum(path, block[last:], zlib.crc32(block[:last], checksum))
        checksum = zlib.crc32(block, checksum)
        yield from _messages_of_block(path, block, np.array(offsets, np.int64), channels, place)
        place += len(block)
    if last_opcode != DATA_END:
        raise LogError("log_damaged", path, "the data section does not end in its end record")


def _require_checksum(path: Path, end_record: memoryview, checksum: int) -> None:
    stated = int.from_bytes(end_record[PREFIX.size : PREFIX.size + 4], "little")
    if stated not in (0, checksum):
        raise LogError("log_damaged", path, "the checksum of the data section is wrong")


def _blocks(path: Path, file: BinaryIO, end: int) -> Iterator[tuple[memoryview, list[int]]]:
    """Stretches of whole records, a few megabytes or one record long, and where records begin."""
    file.seek(len(MAGIC))
    rest, left = b"", end - len(MAGIC)
    while left or rest:
        wanted = min(max(_BLOCK, _missing_bytes(path, rest, left)), left)
        block = rest + file.read(wanted)
        left -= wanted
        offsets, whole = record_offsets(memoryview(block))
        if not whole and not left:
            raise LogError("log_damaged", path, f"the record at byte {end - len(block)} is cut")
        if whole:
            yield memoryview(block)[:whole], offsets
        rest = block[whole:]


def _missing_bytes(path: Path, rest: bytes, left: int) -> int:
    """Bytes that the record begun in `rest` still lacks."""
    if len(rest) < PREFIX.size:
        return 0
    _, length = PREFIX.unpack_from(rest)
    missing: int = PREFIX.size + length - len(rest)
    if missing > left:
        raise LogError("log_damaged", path, f"a record claims {length} bytes, more than there are")
    if length > LONGEST_RECORD:
        raise LogError("log_too_large", path, f"a record has {length} bytes: split the log")
    return missing


def _messages_of_block(
    path: Path,
    block: memoryview,
    offsets: NDArray[np.int64],
    channels: dict[int, Channel],
    place: int,
) -> Iterator[Messages]:
    """Messages that stand bare, and those of chunks, in the order of the file."""
    chunks = np.flatnonzero(np.frombuffer(block, np.uint8)[offsets] == CHUNK)
    stops = [*offsets[1:].tolist(), len(block)]
    for before, chunk in pairwise([-1, *chunks.tolist(), len(offsets)]):
        yield _messages(path, block, offsets[before + 1 : chunk], channels)
        if chunk == len(offsets):
            return
        where = f"chunk at byte {place + offsets[chunk]}"
        records = _unpack_chunk(path, block[offsets[chunk] + PREFIX.size : stops[chunk]], where)
        inside, end = record_offsets(records)
        if end != len(records):
            raise LogError("log_damaged", path, "its records do not fill it", where)
        yield _messages(path, records, np.array(inside, np.int64), channels)


def _unpack_chunk(path: Path, content: memoryview, where: str) -> memoryview:
    """The records of a chunk."""
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


def _messages(
    path: Path, buffer: memoryview, offsets: NDArray[np.int64], channels: dict[int, Channel]
) -> Messages:
    """The messages among records, whose channels are added to those known so far."""
    opcodes = np.frombuffer(buffer, np.uint8)[offsets]
    for start in offsets[opcodes == CHANNEL].tolist():
        _, length = PREFIX.unpack_from(buffer, start)
        content = bytes(buffer[start + PREFIX.size :][:length])
        channel_id, channel = read_channel(path, content)
        if channels.setdefault(channel_id, channel) != channel:
            raise LogError("log_damaged", path, f"channel {channel_id} is declared twice over")
    starts = offsets[opcodes == MESSAGE]
    ends = starts + PREFIX.size + _fields(buffer, starts + 1, "<u8").astype(np.int64)
    if (ends - starts < _MESSAGE_HEAD).any():
        raise LogError("log_damaged", path, "a message is shorter than its own head")
    channel_id_of_each = _fields(buffer, starts + 9, "<u2")
    unknown = set(np.unique(channel_id_of_each).tolist()) - channels.keys()
    if unknown:
        raise LogError("log_damaged", path, f"messages of channel {min(unknown)}, never declared")
    return Messages(
        buffer=buffer,
        channels=channels,
        channel_id=channel_id_of_each,
        log_time=_fields(buffer, starts + 15, "<u8"),
        publish_time=_fields(buffer, starts + 23, "<u8"),
        payload_start=starts + _MESSAGE_HEAD,
        payload_end=ends,
    )


def _fields(buffer: memoryview, at: NDArray[np.int64], dtype: str) -> NDArray[Any]:
    """Numbers of one type at any positions, aligned or not."""
    kind = np.dtype(dtype)
    if not at.size:
        return np.empty(0, kind)
    everywhere: NDArray[Any] = np.ndarray(
        (len(buffer) - kind.itemsize + 1,), kind, buffer, strides=(1,)
    )
    return everywhere[at]

"""The records of an MCAP file: its messages as arrays of positions, not as objects.

Layout and field order are those of the MCAP specification, https://mcap.dev/spec. A record is an opcode, a length and a
content; messages stand bare in the data section or in compressed chunks, which hold records again. Only stepping from
length to length is done record by record; all fields are then taken from the buffer at once.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 256 * 2**20
"""Bytes that a chunk may claim to be, compressed or not: 16 kB were seen to unfold to 480 MB."""

CHANNEL, MESSAGE, CHUNK, STATISTICS, DATA_END, FOOTER = 0x04, 0x05, 0x06, 0x0B, 0x0F, 0x02
MESSAGE_HEADER = 31
"""Bytes of a message record before its payload: opcode, length, channel id, sequence, log and publish time."""

_PREFIX = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_STATISTICS = struct.Struct("<QHIIIIQQI")
_COUNT = struct.Struct("<HQ")
_FOOTER = struct.Struct("<BQQQI")
_LONGEST_RECORD = LARGEST_CHUNK + 2**20
_BLOCK = 8 * 2**20
_COMPRESSIONS = {"": None, "lz4": "lz4", "zstd": "zstd"}


class Channel(NamedTuple):
    """A channel record: what the messages of an id are."""

    topic: str
    encoding: str


class Statistics(NamedTuple):
    """The summary's statistics: what the writer says it has written."""

    message_count: int
    first_log_time_ns: int
    last_log_time_ns: int
    counts_by_channel: Mapping[int, int]


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
    log_time_ns, publish_time_ns : (n,) uint64
    payload_start, payload_end : (n,) int64
        Positions in the buffer.
    """

    buffer: memoryview
    channels: Mapping[int, Channel]
    channel_id: NDArray[np.uint16]
    log_time_ns: NDArray[np.uint64]
    publish_time_ns: NDArray[np.uint64]
    payload_start: NDArray[np.int64]
    payload_end: NDArray[np.int64]


class _Summary(NamedTuple):
    data_end: int
    channels: Mapping[int, Channel]
    statistics: Statistics | None


def read_statistics(path: Path) -> Statistics | None:
    """Statistics of the summary section; None where the file has none.

    Raises
    ------
    LogError
        ``log_not_mcap``, ``log_truncated`` or ``log_damaged``.
    """
    with path.open("rb") as file:
        return _summary(path, file).statistics


def read_messages(path: Path) -> Iterator[Messages]:
    """All messages of a file, piece by piece in the order of the file.

    The last piece is empty and knows all channels, also those without a message.

    The checksums of chunks, data section and summary are checked where they are not zero, and the number of messages
    against the summary's.

    Raises
    ------
    LogError
        ``log_not_mcap``, ``log_truncated``, ``log_damaged``, ``log_compression`` or ``log_too_large``.
    """
    counts: NDArray[np.int64] = np.zeros(2**16, dtype=np.int64)
    with path.open("rb") as file:
        summary = _summary(path, file)
        channels = summary.channels
        for messages in _data_section(path, file, summary.data_end):
            counts += np.bincount(messages.channel_id, minlength=2**16)
            channels = {**messages.channels, **channels}
            yield messages
    if summary.statistics is not None:
        _require_counts(path, summary.statistics, counts)
    none = np.empty(0, np.int64)
    yield Messages(
        memoryview(b""),
        channels,
        none.astype(np.uint16),
        none.astype(np.uint64),
        none.astype(np.uint64),
        none,
        none,
    )


def _require_counts(path: Path, statistics: Statistics, counts: NDArray[np.int64]) -> None:
    wrong = [i for i, count in statistics.counts_by_channel.items() if counts[i] != count]
    if wrong or counts.sum() != statistics.message_count:
        raise LogError(
            "log_damaged",
            path,
            f"the file holds {counts.sum()} messages, its summary says {statistics.message_count}",
        )


def _summary(path: Path, file: BinaryIO) -> _Summary:
    """Read the file from its end: footer, then summary section."""
    if file.read(len(MAGIC)) != MAGIC:
        raise LogError("log_not_mcap", path, "the file does not begin as MCAP does")
    size = file.seek(0, 2)
    footer_start = size - len(MAGIC) - _FOOTER.size
    file.seek(max(footer_start, len(MAGIC)))
    tail = file.read()
    if footer_start < len(MAGIC) or not tail.endswith(MAGIC):
        raise LogError(
            "log_truncated", path, "the end of the MCAP file is missing: copy or recover it"
        )
    opcode, length, summary_start, _, checksum = _FOOTER.unpack_from(tail)
    if opcode != FOOTER or length != _FOOTER.size - _PREFIX.size:
        raise LogError("log_damaged", path, "the footer is not where it has to be")
    start = summary_start or footer_start
    if not len(MAGIC) <= start <= footer_start or footer_start - start > _LONGEST_RECORD:
        raise LogError("log_damaged", path, f"a summary at byte {start} is not in the file")
    file.seek(start)
    section = file.read(footer_start - start)
    if checksum and zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(section)) != checksum:
        raise LogError("log_damaged", path, "the checksum of the summary is wrong")
    return _Summary(start, *_channels_and_statistics(path, section))


def _channels_and_statistics(
    path: Path, section: bytes
) -> tuple[Mapping[int, Channel], Statistics | None]:
    offsets, end = _offsets(memoryview(section))
    if end != len(section):
        raise LogError("log_damaged", path, "the records of the summary do not fill it")
    channels: dict[int, Channel] = {}
    statistics = None
    for start, stop in pairwise([*offsets, end]):
        if section[start] == CHANNEL:
            channel_id, channels[channel_id] = _channel(path, memoryview(section)[start:stop])
        elif section[start] == STATISTICS:
            statistics = _statistics(path, section[start + _PREFIX.size : stop])
    return channels, statistics


def _statistics(path: Path, content: bytes) -> Statistics:
    try:
        messages, *_, first, last, size = _STATISTICS.unpack_from(content)
        counts = _COUNT.iter_unpack(content[_STATISTICS.size : _STATISTICS.size + size])
    except struct.error as error:
        raise LogError("log_damaged", path, f"the summary's statistics: {error}") from error
    return Statistics(messages, first, last, dict(counts))


def _offsets(buffer: memoryview) -> tuple[list[int], int]:
    """Where the records begin that lie whole in the buffer, and where the last of them ends."""
    offsets: list[int] = []
    append, prefix, size = offsets.append, _PREFIX.unpack_from, len(buffer)
    start, last_start = 0, size - _PREFIX.size
    while start <= last_start:
        _, length = prefix(buffer, start)
        end = start + 9 + length
        if end > size:
            break
        append(start)
        start = end
    return offsets, start


def _data_section(path: Path, file: BinaryIO, end: int) -> Iterator[Messages]:
    """Messages between the file's head and its summary, which must follow the end of data."""
    channels: dict[int, Channel] = {}
    checksum = zlib.crc32(MAGIC)
    place = len(MAGIC)
    last = -1
    for block, offsets in _blocks(path, file, end):
        last = block[offsets[-1]]
        if last == DATA_END:
            _require_data_end(
                path, block[offsets[-1] :], zlib.crc32(block[: offsets[-1]], checksum)
            )
        checksum = zlib.crc32(block, checksum)
        yield from _messages_of_block(path, block, np.array(offsets, np.int64), channels, place)
        place += len(block)
    if last != DATA_END:
        raise LogError("log_damaged", path, "the data section does not end in its end record")


def _require_data_end(path: Path, record: memoryview, checksum: int) -> None:
    stated = int.from_bytes(record[_PREFIX.size : _PREFIX.size + 4], "little")
    if stated and stated != checksum:
        raise LogError("log_damaged", path, "the checksum of the data section is wrong")


def _blocks(path: Path, file: BinaryIO, end: int) -> Iterator[tuple[memoryview, list[int]]]:
    """Stretches of whole records, each a few megabytes or one record long, and where the records begin."""
    file.seek(len(MAGIC))
    rest, left = b"", end - len(MAGIC)
    while left or rest:
        wanted = max(_BLOCK, _missing_bytes(path, rest, left))
        block = rest + file.read(min(wanted, left))
        left = max(left - wanted, 0)
        offsets, whole = _offsets(memoryview(block))
        if not whole and not left:
            raise LogError("log_damaged", path, f"the record at byte {end - len(block)} is cut")
        if whole:
            yield memoryview(block)[:whole], offsets
        rest = block[whole:]


def _missing_bytes(path: Path, rest: bytes, left: int) -> int:
    """Bytes that the record begun in `rest` still lacks."""
    if len(rest) < _PREFIX.size:
        return 0
    _, length = _PREFIX.unpack_from(rest)
    missing: int = _PREFIX.size + length - len(rest)
    if missing > left:
        raise LogError("log_damaged", path, f"a record claims {length} bytes, more than there are")
    if length > _LONGEST_RECORD:
        raise LogError(
            "log_too_large", path, f"a record of {length} bytes is not read: split the log"
        )
    return missing


def _messages_of_block(
    path: Path,
    block: memoryview,
    offsets: NDArray[np.int64],
    channels: dict[int, Channel],
    place: int,
) -> Iterator[Messages]:
    """Messages that stand bare, and those of chunks, in the order of the file."""
    opcodes = np.frombuffer(block, np.uint8)[offsets]
    chunks = np.flatnonzero(opcodes == CHUNK)
    stops = [*offsets[1:].tolist(), len(block)]
    for before, chunk in pairwise([-1, *chunks.tolist(), len(offsets)]):
        yield from _messages(path, block, offsets[before + 1 : chunk], channels)
        if chunk < len(offsets):
            where = f"chunk at byte {place + offsets[chunk]}"
            content = block[offsets[chunk] + _PREFIX.size : stops[chunk]]
            records = _unpack_chunk(path, content, where)
            inside, end = _offsets(records)
            if end != len(records):
                raise LogError("log_damaged", path, "its records do not fill it", where)
            yield from _messages(path, records, np.array(inside, np.int64), channels)


def _unpack_chunk(path: Path, content: memoryview, where: str) -> memoryview:
    """Records of a chunk, from the content of its record."""
    try:
        _, _, size, checksum, name_length = _CHUNK_HEAD.unpack_from(content)
        data_start = _CHUNK_HEAD.size + name_length + 8
        name = bytes(content[_CHUNK_HEAD.size : data_start - 8]).decode()
        (packed_size,) = struct.unpack_from("<Q", content, data_start - 8)
    except (struct.error, UnicodeDecodeError) as error:
        raise LogError("log_damaged", path, f"its head cannot be read: {error}", where) from error
    packed = content[data_start : data_start + packed_size]
    if len(packed) != packed_size:
        raise LogError("log_damaged", path, f"it claims {packed_size} bytes that it has not", where)
    if size > LARGEST_CHUNK:
        raise LogError("log_too_large", path, f"it claims to unfold to {size} bytes", where)
    records = _decompress(path, name, packed, size, where)
    if checksum and zlib.crc32(records) != checksum:
        raise LogError("log_damaged", path, "its checksum is wrong", where)
    return records


def _decompress(path: Path, name: str, packed: memoryview, size: int, where: str) -> memoryview:
    if name not in _COMPRESSIONS:
        raise LogError(
            "log_compression", path, f"compression {name!r} is none of none, lz4, zstd", where
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
) -> Iterator[Messages]:
    """Message records among those at `offsets`; channels declared there are added to `channels`."""
    opcodes = np.frombuffer(buffer, np.uint8)[offsets]
    for start in offsets[opcodes == CHANNEL].tolist():
        channel_id, channel = _channel(path, buffer[start:])
        if channels.setdefault(channel_id, channel) != channel:
            raise LogError("log_damaged", path, f"channel {channel_id} is declared twice over")
    starts = offsets[opcodes == MESSAGE]
    if not starts.size:
        return
    ends = starts + _PREFIX.size + _fields(buffer, starts + 1, "<u8").astype(np.int64)
    if (ends - starts < MESSAGE_HEADER).any():
        raise LogError("log_damaged", path, "a message is shorter than its own head")
    channel_id = _fields(buffer, starts + 9, "<u2")
    unknown = set(np.unique(channel_id).tolist()) - channels.keys()
    if unknown:
        raise LogError("log_damaged", path, f"messages of channel {min(unknown)}, never declared")
    yield Messages(
        buffer=buffer,
        channels=channels,
        channel_id=channel_id,
        log_time_ns=_fields(buffer, starts + 15, "<u8"),
        publish_time_ns=_fields(buffer, starts + 23, "<u8"),
        payload_start=starts + MESSAGE_HEADER,
        payload_end=ends,
    )


def _fields(buffer: memoryview, at: NDArray[np.int64], dtype: DTypeLike) -> NDArray[np.generic]:
    """Numbers of one type at any positions, aligned or not."""
    kind = np.dtype(dtype)
    everywhere = np.ndarray((len(buffer) - kind.itemsize + 1,), kind, buffer, strides=(1,))
    return everywhere[at]


def _channel(path: Path, record: memoryview) -> tuple[int, Channel]:
    try:
        length, channel_id, _ = struct.unpack_from("<xQHH", record)
        texts, at = [], _PREFIX.size + 4
        for _ in range(2):
            (size,) = struct.unpack_from("<I", record, at)
            texts.append(bytes(record[at + 4 : at + 4 + size]).decode())
            at += 4 + size
        if at > _PREFIX.size + length:
            raise struct.error("a text goes beyond its record")
    except (struct.error, UnicodeDecodeError) as error:
        raise LogError("log_damaged", path, f"a channel record cannot be read: {error}") from error
    return channel_id, Channel(*texts)

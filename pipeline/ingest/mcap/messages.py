"""Records of an MCAP file, its summary, and its messages: arrays of their times and places.

Opcodes and the order of fields are those of the MCAP specification, https://mcap.dev/spec. A record
is an opcode, a length and a content. Messages stand bare in the data section, or in compressed
chunks, which hold records again. Only stepping from length to length is done record by record, and
that only where no index has the steps; all fields are then taken at once.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Schema, Statistics
from numpy.typing import NDArray

from pipeline.arrays import Rows
from pipeline.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, STATISTICS, DATA_END = 0x07, 0x0B, 0x0F

PREFIX = struct.Struct("<BQ")
"""Opcode and length of the content."""

LARGEST_CHUNK = 256 * 2**20
"""Bytes that a chunk may claim to be, packed or not: 16 kB were seen to unfold to 480 MB."""

LONGEST_RECORD = LARGEST_CHUNK + 2**20
NO_SCHEMA = Schema(0, b"", "", "")

_FOOTER = struct.Struct("<BQQQI")
_CHECKSUM_BYTES = 4
_Record = TypeVar("_Record", Channel, Schema, Statistics)
_MESSAGE_HEAD = 31
"""Bytes before a payload: opcode, length, channel id, sequence, log time, publish time."""

_TIMES = {"log_time": 15, "publish_time": 23}
"""Places of the times in it."""

_CHUNK_HEAD = struct.Struct("<QQQII")
_COMPRESSIONS = {"": None, "lz4": "lz4", "zstd": "zstd"}
_INDEX_PREFIX = 6
_BLOCK = 8 * 2**20


# Records and the summary


@dataclass(frozen=True, slots=True)
class Declared:
    """Channels and schemas by id; they may be repeated but not changed."""

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)

    def add(self, path: Path, opcode: int, content: bytes) -> None:
        """Add the content of a channel or schema record."""
        known: Channel | Schema
        declared: Channel | Schema
        if opcode == CHANNEL:
            declared = _record(path, Channel, content)
            known = self.channels.setdefault(declared.id, declared)
        else:
            declared = _record(path, Schema, content)
            known = self.schemas.setdefault(declared.id, declared)
        if known != declared:
            what = "channel" if opcode == CHANNEL else "schema"
            raise LogError("log_damaged", path, f"{what} {declared.id} is declared twice over")


class _Whole(ReadDataStream):
    """A stream of which nothing may be missing."""

    def read(self, length: int) -> bytes:
        content = super().read(length)
        if len(content) < length:
            raise EndOfFile
        return content


def _record(path: Path, kind: type[_Record], content: bytes) -> _Record:
    """Return a record by its content."""
    try:
        record: _Record = kind.read(_Whole(io.BytesIO(content)))
    except (EndOfFile, UnicodeDecodeError) as error:
        how = f"a record of kind {kind.__name__} cannot be read: {error!r}"
        raise LogError("log_damaged", path, how) from error
    return record


class Summary(NamedTuple):
    """The part behind the data section."""

    start: int  # where the data section ends, in bytes
    declared: Declared  # a writer may leave them out
    statistics: Statistics | None  # None where the writer left them out


def record_offsets(buffer: memoryview) -> tuple[list[int], int]:
    """Return where records that lie whole in a buffer begin, and the end of the last of them."""
    offsets: list[int] = []
    # The only loop over single messages: what it needs is looked up once.
    append, unpack, size = offsets.append, PREFIX.unpack_from, len(buffer)
    start, last_start = 0, size - PREFIX.size
    while start <= last_start:
        _, length = unpack(buffer, start)
        end = start + 9 + length
        if end > size:
            break
        append(start)
        start = end
    return offsets, start


def fields_at(buffer: memoryview, at: NDArray[np.int64], dtype: str) -> NDArray[Any]:
    """Return numbers of a type at any positions, aligned or not."""
    kind = np.dtype(dtype)
    if not at.size:
        return np.empty(0, kind)
    everywhere: NDArray[Any] = np.ndarray(
        (len(buffer) - kind.itemsize + 1,), kind, buffer, strides=(1,)
    )
    # Messages of the same length lie in equal steps.
    step = int(at[1] - at[0]) if at.size > 1 else 1
    if step > 0 and (np.diff(at) == step).all():
        return everywhere[at[0] : at[-1] + 1 : step].copy()
    return everywhere[at]


def column(buffer: memoryview, at: int, dtype: str, size: int) -> NDArray[Any]:
    """Return numbers of a type at a place in each row of `size` bytes in a buffer."""
    rows = (len(buffer) // size,)
    return np.ndarray(rows, dtype, buffer, at, strides=(size,)).copy()


def read_summary(path: Path) -> Summary:
    """Return footer and summary section of a file."""
    with path.open("rb") as file:
        return _summary(path, file)


def _summary(path: Path, file: BinaryIO) -> Summary:
    if file.read(len(MAGIC)) != MAGIC:
        raise LogError("log_not_mcap", path, "the file does not begin as MCAP does")
    footer_start = file.seek(0, 2) - len(MAGIC) - _FOOTER.size
    file.seek(max(footer_start, len(MAGIC)))
    tail = file.read()
    if footer_start < len(MAGIC) or not tail.endswith(MAGIC):
        raise LogError(
            "log_truncated", path, "the end of the MCAP file is missing: copy or recover it"
        )
    opcode, length, summary_start, _, checksum = _FOOTER.unpack_from(tail)
    if opcode != FOOTER or length != _FOOTER.size - PREFIX.size:
        raise LogError("log_damaged", path, "the footer is not where it has to be")
    start = summary_start or footer_start
    if not len(MAGIC) <= start <= footer_start or footer_start - start > LONGEST_RECORD:
        raise LogError("log_damaged", path, f"byte {start} of the file cannot begin its summary")
    file.seek(start)
    section = file.read(footer_start - start)
    checked = zlib.crc32(tail[: _FOOTER.size - _CHECKSUM_BYTES], zlib.crc32(section))
    if checksum not in (0, checked):
        raise LogError("log_damaged", path, "the checksum of the summary is wrong")
    return Summary(start, *_summary_records(path, section))


def _summary_records(path: Path, section: bytes) -> tuple[Declared, Statistics | None]:
    offsets, end = record_offsets(memoryview(section))
    if end != len(section):
        raise LogError("log_damaged", path, "the records of the summary do not fill it")
    declared = Declared()
    statistics = None
    for start, stop in pairwise([*offsets, end]):
        content = section[start + PREFIX.size : stop]
        if section[start] in (CHANNEL, SCHEMA):
            declared.add(path, section[start], content)
        elif section[start] == STATISTICS:
            statistics = _record(path, Statistics, content)
    return declared, statistics


# Messages


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages that lie in the same buffer, in the order of the file."""

    buffer: memoryview  # records, of which these messages are some
    channels: Mapping[int, Channel]  # declared so far, by id
    schemas: Mapping[int, Schema]
    channel_id: NDArray[np.uint16]
    start: NDArray[np.int64]  # of their records in the buffer
    payload_end: NDArray[np.int64]
    read_to: int  # position in the file up to which it has been read

    def rows_of(self, topic: str) -> NDArray[np.intp]:
        """Return rows of the messages of a topic, which several channels may have."""
        own = [
            self.channel_id == i for i, channel in self.channels.items() if channel.topic == topic
        ]
        return np.flatnonzero(reduce(np.logical_or, own)) if own else np.empty(0, np.intp)

    def payload_start(self, chosen: Rows) -> NDArray[np.int64]:
        """Return where some payloads begin in the buffer."""
        return np.asarray(self.start[chosen] + _MESSAGE_HEAD)

    def payload(self, i: int) -> bytes:
        """Return the payload at a place."""
        return bytes(self.buffer[self.start[i] + _MESSAGE_HEAD : self.payload_end[i]])

    def times(self, name: str) -> NDArray[np.uint64]:
        """Return their ``log_time`` or ``publish_time`` [ns]."""
        return fields_at(self.buffer, self.start + _TIMES[name], "<u8")


def read_messages(path: Path) -> Iterator[Messages]:
    """Yield all messages of a file, piece by piece in the order of the file.

    The last piece is empty and knows all channels, also those without a message. Checksums of
    chunks, data section and summary are checked where they are not zero, and the number of messages
    against what the summary says.

    Raises LogError: ``log_not_mcap``, ``log_truncated``, ``log_damaged``, ``log_compression``,
    ``log_too_large``.
    """
    counts: NDArray[np.int64] = np.zeros(2**16, dtype=np.int64)
    declared, summary = Declared(), read_summary(path)
    with path.open("rb") as file:
        for messages in _data_section(path, file, summary.start, declared):
            of_channels = np.bincount(messages.channel_id)
            _require_declared(path, declared, of_channels)
            counts[: of_channels.size] += of_channels
            yield messages
    if summary.statistics is not None:
        _require_counts(path, summary.statistics, counts)
    yield replace(
        _messages(path, memoryview(b""), np.empty(0, np.int64), 0, declared, summary.start),
        channels={**summary.declared.channels, **declared.channels},
        schemas={**summary.declared.schemas, **declared.schemas},
    )


def _require_declared(path: Path, declared: Declared, counts: NDArray[np.intp]) -> None:
    unknown = set(np.flatnonzero(counts).tolist()) - declared.channels.keys()
    if unknown:
        raise LogError("log_damaged", path, f"messages of channel {min(unknown)}, never declared")


def _require_counts(path: Path, statistics: Statistics, counts: NDArray[np.int64]) -> None:
    wrong = [i for i, count in statistics.channel_message_counts.items() if counts[i] != count]
    if wrong or counts.sum() != statistics.message_count:
        raise LogError(
            "log_damaged",
            path,
            f"the file holds {counts.sum()} messages and its summary says "
            f"{statistics.message_count}, or they differ for some channel",
        )


def _data_section(path: Path, file: BinaryIO, end: int, declared: Declared) -> Iterator[Messages]:
    """Yield messages of the data section, the last record of which has to be its end record."""
    checksum, place, is_whole = zlib.crc32(MAGIC), len(MAGIC), False
    for block, offsets in _blocks(path, file, end):
        opcodes = np.frombuffer(block, np.uint8)[offsets]
        end_records = np.flatnonzero(opcodes == DATA_END)[:1].tolist()
        for last in end_records:
            stop = offsets[last + 1] if last + 1 < len(offsets) else len(block)
            _require_checksum(
                path, block[offsets[last] : stop], zlib.crc32(block[: offsets[last]], checksum)
            )
            block, offsets, is_whole = block[:stop], offsets[: last + 1], True
        checksum = zlib.crc32(block, checksum)
        yield from _messages_of_block(path, block, np.array(offsets), declared, place)
        place += len(block)
        if is_whole:
            break
    if not is_whole or place != end:
        raise LogError("log_damaged", path, "the data section does not end in its end record")


def _require_checksum(path: Path, end_record: memoryview, checksum: int) -> None:
    stated = int.from_bytes(end_record[PREFIX.size : PREFIX.size + 4], "little")
    if stated not in (0, checksum):
        raise LogError("log_damaged", path, "its checksum is wrong", "data section")


def _blocks(path: Path, file: BinaryIO, end: int) -> Iterator[tuple[memoryview, list[int]]]:
    """Yield stretches of whole records, some megabytes or a record long and where records begin."""
    place, size = len(MAGIC), _BLOCK
    while place < end:
        file.seek(place)
        block = memoryview(file.read(min(size, end - place)))
        offsets, whole = record_offsets(block)
        is_last = len(block) < size or place + size == end
        if not whole and is_last:
            raise LogError("log_damaged", path, f"the record at byte {place} is cut")
        chunks = np.flatnonzero(np.frombuffer(block, np.uint8)[offsets] == CHUNK)
        if not is_last and chunks.size and chunks[-1]:
            # The index of its messages stands behind a chunk: both stay together.
            whole = offsets[chunks[-1]]
            offsets = offsets[: chunks[-1]]
        if whole:
            yield block[:whole], offsets
        place += whole
        size = max(_BLOCK, _record_size(path, block[whole:], end - place))


def _record_size(path: Path, begin: memoryview, left: int) -> int:
    """Return size of a record by its begin, or of its head where that is cut."""
    if len(begin) < PREFIX.size:
        return PREFIX.size
    _, length = PREFIX.unpack_from(begin)
    if PREFIX.size + length > left:
        raise LogError("log_damaged", path, f"a record claims {length} bytes, more than there are")
    if length > LONGEST_RECORD:
        raise LogError("log_too_large", path, f"a record has {length} bytes: split the log")
    return int(PREFIX.size + length)


def _messages_of_block(
    path: Path,
    block: memoryview,
    offsets: NDArray[np.int64],
    declared: Declared,
    place: int,
) -> Iterator[Messages]:
    """Yield messages that stand bare, and those of chunks, in the order of the file."""
    opcodes = np.frombuffer(block, np.uint8)[offsets]
    chunks = np.flatnonzero(opcodes == CHUNK).tolist()
    stops = [*offsets[1:].tolist(), len(block)]

    def content(i: int) -> memoryview:
        return block[offsets[i] + PREFIX.size : stops[i]]

    for before, chunk in pairwise([-1, *chunks, len(offsets)]):
        stop = len(block) if chunk == len(offsets) else int(offsets[chunk])
        bare = offsets[before + 1 : chunk]
        yield _messages(path, block, bare, stop, declared, place + stop)
        if chunk == len(offsets):
            return
        where = f"chunk at byte {place + offsets[chunk]}"
        records = _unpacked_chunk(path, content(chunk), where)
        indexes = takewhile(lambda i: opcodes[i] == MESSAGE_INDEX, range(chunk + 1, len(offsets)))
        inside, end = offsets_in_chunk(records, _indexed_positions(list(map(content, indexes))))
        if end != len(records):
            raise LogError("log_damaged", path, "its records do not fill it", where)
        yield _messages(path, records, inside, end, declared, place + stops[chunk])


def _messages(
    path: Path,
    buffer: memoryview,
    starts: NDArray[np.int64],
    end: int,
    declared: Declared,
    read_to: int,
) -> Messages:
    """Return the messages among records, whose channels are added to those known so far."""
    opcodes = np.frombuffer(buffer, np.uint8)[starts]
    ends = np.append(starts[1:], end)[: starts.size]
    for i in np.flatnonzero((opcodes == CHANNEL) | (opcodes == SCHEMA)).tolist():
        declared.add(path, int(opcodes[i]), bytes(buffer[starts[i] + PREFIX.size : ends[i]]))
    is_message = opcodes == MESSAGE
    if not is_message.all():
        starts, ends = starts[is_message], ends[is_message]
    if (ends - starts < _MESSAGE_HEAD).any():
        raise LogError("log_damaged", path, "a message is shorter than its own head")
    return Messages(
        buffer=buffer,
        channels=declared.channels,
        schemas=declared.schemas,
        channel_id=fields_at(buffer, starts + PREFIX.size, "<u2"),
        start=starts,
        payload_end=ends,
        read_to=read_to,
    )


def _unpacked_chunk(path: Path, content: memoryview, where: str) -> memoryview:
    """Return the records of a chunk record's content; `where` it lies is for messages."""
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
    codec, records = _COMPRESSIONS[name], packed
    try:
        if codec is not None:
            stream = pa.CompressedInputStream(pa.BufferReader(pa.py_buffer(packed)), codec)
            with stream:
                # As far as it goes, but one byte more than it claims at most.
                records = memoryview(stream.read_buffer(size + 1))
    except (OSError, pa.ArrowException) as error:
        raise LogError("log_damaged", path, f"it does not decompress: {error}", where) from error
    if len(records) != size:
        raise LogError("log_damaged", path, f"it does not decompress to {size} bytes", where)
    return records


def _indexed_positions(indexes: Sequence[memoryview]) -> NDArray[np.int64]:
    """Return where messages in a chunk begin, in ascending order, as its index records say."""
    parts = [np.empty(0, "<u8")]
    for index in indexes:
        numbers = max(len(index) - _INDEX_PREFIX, 0) // 16 * 2
        times_and_positions = np.frombuffer(index[_INDEX_PREFIX:], "<u8", numbers)
        parts.append(times_and_positions[1::2])
    # Too large ones become negative, and are then of no use.
    return np.sort(np.concatenate(parts).astype(np.int64), kind="stable")


def offsets_in_chunk(
    records: memoryview, positions: NDArray[np.int64]
) -> tuple[NDArray[np.int64], int]:
    """Return where the records of a chunk begin, and the end of the last of them.

    All but the first records may begin at the positions, which are in ascending order and believed
    only where each step, taken from the chunk's begin, leads from a record to the next.
    """
    if positions.size and positions[0] >= 0 and positions[-1] <= len(records) - PREFIX.size:
        # Schemas and channels have no index, and mostly stand before all messages.
        first, end = record_offsets(records[: positions[0]])
        lengths = fields_at(records, positions + 1, "<u8")
        if end == positions[0] and lengths.max() <= len(records):
            ends = positions + (PREFIX.size + lengths.astype(np.int64))
            if (ends == np.append(positions[1:], len(records))).all():
                return np.concatenate([np.array(first, np.int64), positions]), len(records)
    offsets, end = record_offsets(records)
    return np.array(offsets, np.int64), end

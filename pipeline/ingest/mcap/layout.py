"""Layout of an MCAP file, and its summary, which is read from the end.

Opcodes and the order of fields are those of the MCAP specification, https://mcap.dev/spec. A record
is an opcode, a length and a content.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, STATISTICS, DATA_END = 0x07, 0x0B, 0x0F

PREFIX = struct.Struct("<BQ")
"""Opcode and length of the content."""

LARGEST_CHUNK = 256 * 2**20
"""Bytes that a chunk may claim to be, packed or not: 16 kB were seen to unfold to 480 MB."""

LONGEST_RECORD = LARGEST_CHUNK + 2**20

_CHANNEL_HEAD = struct.Struct("<HH")
_SCHEMA_HEAD = struct.Struct("<H")
_STATISTICS = struct.Struct("<QHIIIIQQI")
_CHANNEL_COUNT = struct.Struct("<HQ")
_FOOTER = struct.Struct("<BQQQI")
_CHECKSUM_BYTES = 4


class ChannelRecord(NamedTuple):
    """A channel record: what the messages of an id are; schema 0 is none."""

    topic: str
    encoding: str
    schema_id: int
    metadata: tuple[tuple[str, str], ...] = ()


class Schema(NamedTuple):
    """A schema record: how messages are laid out."""

    name: str
    encoding: str
    data: bytes


NO_SCHEMA = Schema("", "", b"")


@dataclass(frozen=True, slots=True)
class Declared:
    """Channels and schemas by id; they may be repeated but not changed."""

    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)

    def add(self, path: Path, opcode: int, content: bytes) -> None:
        """Add the content of a channel or schema record."""
        known: ChannelRecord | Schema
        declared: ChannelRecord | Schema
        try:
            if opcode == CHANNEL:
                number, schema_id = _CHANNEL_HEAD.unpack_from(content)
                topic, at = _text(content, _CHANNEL_HEAD.size)
                encoding, at = _text(content, at)
                declared = ChannelRecord(topic, encoding, schema_id, _pairs(content, at))
                known = self.channels.setdefault(number, declared)
            else:
                (number,) = _SCHEMA_HEAD.unpack_from(content)
                name, at = _text(content, _SCHEMA_HEAD.size)
                encoding, at = _text(content, at)
                declared = Schema(name, encoding, _bytes(content, at)[0])
                known = self.schemas.setdefault(number, declared)
        except (struct.error, UnicodeDecodeError) as error:
            raise LogError(
                "log_damaged", path, f"a channel or schema record cannot be read: {error}"
            ) from error
        if known != declared:
            what = "channel" if opcode == CHANNEL else "schema"
            raise LogError("log_damaged", path, f"{what} {number} is declared twice over")


def _pairs(content: bytes, at: int) -> tuple[tuple[str, str], ...]:
    """Return the texts of a map, or none where a writer left it out."""
    packed = _bytes(content, at)[0] if at < len(content) else b""
    pairs, place = list[tuple[str, str]](), 0
    while place < len(packed):
        key, place = _text(packed, place)
        value, place = _text(packed, place)
        pairs.append((key, value))
    return tuple(pairs)


class Statistics(NamedTuple):
    """The writer's own count of its messages, log times in ns."""

    message_count: int
    first_log_time: int
    last_log_time: int
    counts_by_channel: Mapping[int, int]


class Summary(NamedTuple):
    """The part behind the data section."""

    start: int  # where the data section ends, in bytes
    declared: Declared  # a writer may leave them out
    statistics: Statistics | None  # None where the writer left them out

    def stated_count(self, topic: str) -> int | None:
        """Number of messages of a topic; None where the writer left it out."""
        if self.statistics is None:
            return None
        same = [i for i, channel in self.declared.channels.items() if channel.topic == topic]
        return sum(self.statistics.counts_by_channel.get(i, 0) for i in same)


def record_offsets(buffer: memoryview) -> tuple[list[int], int]:
    """Begins of the records that lie whole in a buffer, and the end of the last of them.

    Examples
    --------
    >>> record_offsets(memoryview(PREFIX.pack(CHUNK, 2) + b"abc"))
    ([0], 11)
    """
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
    """Numbers of one type at any positions, aligned or not."""
    kind = np.dtype(dtype)
    if not at.size:
        return np.empty(0, kind)
    everywhere: NDArray[Any] = np.ndarray(
        (len(buffer) - kind.itemsize + 1,), kind, buffer, strides=(1,)
    )
    # Messages of one length lie in equal steps.
    step = int(at[1] - at[0]) if at.size > 1 else 1
    if step > 0 and (np.diff(at) == step).all():
        return everywhere[at[0] : at[-1] + 1 : step].copy()
    return everywhere[at]


def column(buffer: memoryview, at: int, dtype: str, size: int) -> NDArray[Any]:
    """Numbers of one type at a place in each of the rows of `size` bytes that fill a buffer."""
    rows = (len(buffer) // size,)
    return np.ndarray(rows, dtype, buffer, at, strides=(size,)).copy()


def read_summary(path: Path) -> Summary:
    """Footer and summary section of a file."""
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
            statistics = _statistics(path, content)
    return declared, statistics


def _statistics(path: Path, content: bytes) -> Statistics:
    try:
        messages, *_, first, last, size = _STATISTICS.unpack_from(content)
        counts = _CHANNEL_COUNT.iter_unpack(content[_STATISTICS.size :][:size])
    except struct.error as error:
        raise LogError("log_damaged", path, f"the summary's statistics: {error}") from error
    return Statistics(messages, first, last, dict(counts))


def _text(content: bytes, at: int) -> tuple[str, int]:
    """A text that has its length before it, and where it ends."""
    text, end = _bytes(content, at)
    return text.decode(), end


def _bytes(content: bytes, at: int) -> tuple[bytes, int]:
    """Bytes that have their number before them, and where they end."""
    (size,) = struct.unpack_from("<I", content, at)
    end = at + 4 + size
    if end > len(content):
        raise struct.error(f"a text of {size} bytes goes beyond its record")
    return content[at + 4 : end], end

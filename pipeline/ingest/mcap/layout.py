"""Layout of an MCAP file, and its summary, which is read from the end.

Opcodes and the order of fields are those of the MCAP specification, https://mcap.dev/spec. A record
is an opcode, a length and a content.
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Schema, Statistics
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
NO_SCHEMA = Schema(0, b"", "", "")

_FOOTER = struct.Struct("<BQQQI")
_CHECKSUM_BYTES = 4
_Record = TypeVar("_Record", Channel, Schema, Statistics)


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

    def stated_count(self, topic: str) -> int | None:
        """Number of messages of a topic; None where the writer left it out."""
        if self.statistics is None:
            return None
        same = [i for i, channel in self.declared.channels.items() if channel.topic == topic]
        return sum(self.statistics.channel_message_counts.get(i, 0) for i in same)


def record_offsets(buffer: memoryview) -> tuple[list[int], int]:
    """Begins of the records that lie whole in a buffer, and the end of the last of them."""
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
    """Numbers of a type at any positions, aligned or not."""
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
    """Numbers of a type at a place in each of the rows of `size` bytes that fill a buffer."""
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
            statistics = _record(path, Statistics, content)
    return declared, statistics

"""Payloads of messages, one behind the other, and the readings that a decoder makes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.arrays import Rows
from pipeline.config.field_paths import FieldPath
from pipeline.config.time_formats import EPOCH_UNITS
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.layout import fields_at
from pipeline.ingest.mcap.messages import Messages
from pipeline.ingest.time_stamps import WrittenStamps, written_as_numbers
from pipeline.ingest.wall_clock import LATEST_US

_NEWLINE = 10

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
"""Names of the two numbers of a stamp: of ROS 2, of ROS 1 and JSON, and of Protobuf."""


@dataclass(frozen=True, slots=True)
class Payloads:
    """Payloads of some messages, each with a newline before it."""

    text: NDArray[np.uint8]
    start: NDArray[np.int64]  # of each payload in the text
    length: NDArray[np.int64]
    topic: NDArray[np.int16]  # position among the wanted topics
    time_ns: NDArray[np.uint64]  # log or publish time

    @property
    def first(self) -> bytes:
        """The first payload; there is one at least."""
        return self.text[self.start[0] :][: self.length[0]].tobytes()

    def each(self) -> Iterator[bytes]:
        """One payload after the other."""
        text = self.text.tobytes()
        for start, length in zip(self.start.tolist(), self.length.tolist(), strict=True):
            yield text[start : start + length]

    def by_length(self) -> Iterator[tuple[Rows, int, memoryview]]:
        """Rows of messages of one length, the length, and their text: a byte and a payload each."""
        if (self.length == self.length[0]).all():
            yield slice(None), int(self.length[0]), self.text.data
            return
        for length in np.flatnonzero(np.bincount(self.length)).tolist():
            rows = np.flatnonzero(self.length == length)
            text = fields_at(self.text.data, self.start[rows] - 1, f"V{length + 1}")
            yield rows, length, text.view(np.uint8).data


@dataclass(frozen=True, slots=True)
class Decoded:
    """Readings of the wanted fields of messages, and the stamps in them where they are wanted."""

    fields: Mapping[FieldPath, Readings]
    stamps: WrittenStamps | None  # None where the log time is to be used
    # Of JSON: text, numbers or truth values. In other encodings it is a number, among the fields.
    qualities: Mapping[FieldPath, pa.Array] = field(default_factory=dict)


Decoder = Callable[[Payloads], Decoded]
Numbers = tuple[NDArray[Any], NDArray[np.bool_]]
"""Numbers, and where there is one."""


def payloads_of(
    messages: Messages,
    chosen: Rows,
    topic: NDArray[np.int16],
    time_ns: NDArray[np.uint64],
) -> Payloads:
    """Payloads of the chosen messages, one at least, with the topics and times of all messages."""
    starts, ends = messages.payload_start[chosen], messages.payload_end[chosen]
    length = ends - starts
    if (length == length[0]).all():
        size = int(length[0]) + 1
        text = fields_at(messages.buffer, starts - 1, f"V{size}").view(np.uint8)
        placed = np.arange(1, text.size + 1, size)
    else:
        edges = np.append(np.column_stack([starts - 1, ends]), ends[-1])
        buffers = [None, pa.py_buffer(edges), pa.py_buffer(messages.buffer)]
        pieces = pa.Array.from_buffers(pa.large_binary(), edges.size - 1, buffers)
        texts = pieces.take(pa.array(np.arange(0, edges.size - 1, 2)))
        text = np.frombuffer(texts.buffers()[2], np.uint8, int((length + 1).sum()))
        placed = _starts(length)
    text[placed - 1] = _NEWLINE
    return Payloads(text, placed, length, topic[chosen], time_ns[chosen])


def stacked(parts: Sequence[Payloads]) -> Payloads:
    """Payloads one after the other."""
    if len(parts) == 1:
        return parts[0]
    length = np.concatenate([part.length for part in parts])
    return Payloads(
        text=np.concatenate([part.text for part in parts]),
        start=_starts(length),
        length=length,
        topic=np.concatenate([part.topic for part in parts]),
        time_ns=np.concatenate([part.time_ns for part in parts]),
    )


def stamps_of_numbers(
    numbers: NDArray[np.integer] | NDArray[np.floating], time_format: str
) -> WrittenStamps:
    """Stamps that are one number; none of them can be read where the format is one of text."""
    if time_format in EPOCH_UNITS or time_format == "excel_days":
        return written_as_numbers(numbers, time_format)
    return unreadable_stamps(numbers.size)


def stamps_of_parts(parts: Sequence[Numbers], time_format: str) -> WrittenStamps:
    """Stamps of one number, or of whole seconds since 1970, UTC, and nanoseconds.

    Nanoseconds are cut off to microseconds.
    """
    if len(parts) == 1:
        ((numbers, there),) = parts
        # Nothing is before 1990, so that a missing one is not readable.
        return stamps_of_numbers(np.where(there, numbers, 0), time_format)
    (seconds, there), (nanoseconds, also) = parts
    latest = LATEST_US // 1_000_000
    sound = there & also & (seconds >= 0) & (seconds < latest)
    sound &= (nanoseconds >= 0) & (nanoseconds < 1_000_000_000)
    whole = np.where(sound, seconds, 0).astype(np.int64)
    time_us = whole * 1_000_000 + np.where(sound, nanoseconds, 0).astype(np.int64) // 1000
    return written_as_numbers(np.where(sound, time_us, 0), "epoch_us")


def unreadable_stamps(count: int) -> WrittenStamps:
    """No stamp at all in any of so many messages."""
    return WrittenStamps(np.zeros(count, np.int64), np.zeros(count, np.int8))


def _starts(length: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.cumsum(length + 1) - length

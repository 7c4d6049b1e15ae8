"""Payloads of messages, one behind the other, and what a decoder makes of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.config.field_paths import FieldPath
from pipeline.config.time_formats import EPOCH_UNITS
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap_messages import Messages
from pipeline.ingest.time_stamps import WrittenStamps, written_as_numbers
from pipeline.ingest.wall_clock import LATEST_US

_NEWLINE = 10

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
"""Names of the two numbers of a stamp: of ROS 2, of ROS 1 and JSON, and of Protobuf."""


@dataclass(frozen=True, slots=True)
class Payloads:
    """Payloads of some messages, each with a newline behind it.

    Attributes
    ----------
    text : (m,) uint8
    start, length : (n,) int64
        Where each payload lies in the text.
    topic : (n,) int16
        Position among the wanted topics.
    time_ns : (n,) uint64
        Log or publish time.
    """

    text: NDArray[np.uint8]
    start: NDArray[np.int64]
    length: NDArray[np.int64]
    topic: NDArray[np.int16]
    time_ns: NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Decoded:
    """Readings of the wanted fields of messages, and the stamps in them where they are wanted.

    Attributes
    ----------
    fields
        Readings by path.
    stamps
        None where the log time is to be used.
    qualities
        What messages of JSON say of their samples, by path: text, numbers or truth values. With
        other encodings it is a number, and among the fields.
    """

    fields: Mapping[FieldPath, Readings]
    stamps: WrittenStamps | None
    qualities: Mapping[FieldPath, pa.Array] = field(default_factory=dict)


Decoder = Callable[[Payloads], Decoded]


def payloads_of(
    messages: Messages,
    chosen: NDArray[np.intp],
    topic: NDArray[np.int16],
    time_ns: NDArray[np.uint64],
) -> Payloads:
    """Payloads of the chosen messages, out of their buffer.

    Parameters
    ----------
    messages
        n messages.
    chosen : (m,) intp
        Positions of those that are wanted, one at least, in the order of the file.
    topic : (n,) int16
    time_ns : (n,) uint64
        Their topics, and the times that go with them.
    """
    starts, ends = messages.payload_start[chosen], messages.payload_end[chosen]
    length = ends - starts
    low, high = int(starts[0]), int(ends[-1])
    text = _as_lines(messages.buffer[low:high], starts - low, ends - low)
    return Payloads(text, _starts(length), length, topic[chosen], time_ns[chosen])


def stacked(parts: Sequence[Payloads]) -> Payloads:
    """Payloads one after the other."""
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
    return WrittenStamps(np.zeros(numbers.size, np.int64), np.zeros(numbers.size, np.int8))


def stamps_of_seconds(
    seconds: NDArray[np.integer], nanoseconds: NDArray[np.integer], there: NDArray[np.bool_]
) -> WrittenStamps:
    """Stamps of whole seconds since 1970, UTC, and nanoseconds, cut off to microseconds.

    Parameters
    ----------
    seconds, nanoseconds : (n,) integer
    there : (n,) bool
        False where a message has no stamp.
    """
    latest = LATEST_US // 1_000_000
    sound = there & (seconds >= 0) & (seconds < latest)
    sound &= (nanoseconds >= 0) & (nanoseconds < 1_000_000_000)
    whole = np.where(sound, seconds, 0).astype(np.int64)
    time_us = whole * 1_000_000 + np.where(sound, nanoseconds, 0).astype(np.int64) // 1000
    return written_as_numbers(np.where(sound, time_us, 0), "epoch_us")


def unreadable_stamps(count: int) -> WrittenStamps:
    """No stamp at all in any of so many messages."""
    return WrittenStamps(np.zeros(count, np.int64), np.zeros(count, np.int8))


def _starts(length: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.cumsum(length + 1) - (length + 1)


def _as_lines(
    buffer: memoryview, starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """The payloads from `starts` to `ends`, each with a newline behind it."""
    text = np.empty(len(buffer) + 1, dtype=np.uint8)
    text[:-1] = np.frombuffer(buffer, np.uint8)
    # Behind a payload is the head of the next record, or the end: room for the newline.
    text[ends] = _NEWLINE
    edges = np.empty(2 * starts.size + 2, dtype=np.int64)
    edges[0], edges[1:-1:2], edges[2:-1:2], edges[-1] = 0, starts, ends + 1, text.size
    inside = np.zeros(edges.size - 1, dtype=np.bool_)
    inside[1::2] = True
    return text[np.repeat(inside, np.diff(edges))]

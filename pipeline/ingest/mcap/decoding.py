"""Payloads of messages, and the readings that are in them, a message at a time.

What is faster for many messages at once is each encoding's own; this is what all fall back to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.arrays import Rows
from pipeline.config.logs import EPOCH_UNITS, EXCEL_DAYS, FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.messages import Messages, fields_at
from pipeline.ingest.time_stamps import LATEST_US, WrittenStamps, parse_numbers, parse_written

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
"""Names of the two numbers of a stamp: of ROS 2, of ROS 1 and JSON, and of Protobuf."""

_NEWLINE = 10
ELEMENTS_SHOWN = 4
_DEEPEST = 6
_MOST_NAMES = 40
_INT64 = np.iinfo(np.int64)


class Wanted(NamedTuple):
    """What is wanted of each message of a topic."""

    readings: tuple[FieldPath, ...]
    qualities: tuple[FieldPath, ...] = ()  # what it says of the readings
    stamp: FieldPath | None = None  # None where the log or publish time is to be used
    time_format: str = "epoch_ns"  # of the stamp


@dataclass(frozen=True, slots=True)
class Payloads:
    """Payloads of some messages, each with a newline before it."""

    text: NDArray[np.uint8]
    length: NDArray[np.int64]
    time_ns: NDArray[np.uint64]  # log or publish time

    @property
    def start(self) -> NDArray[np.int64]:
        """Of each payload in the text."""
        return np.cumsum(self.length + 1) - self.length

    @property
    def first(self) -> bytes:
        """The first payload; there is at least one."""
        return self.text[1:][: self.length[0]].tobytes()

    def each(self) -> Iterator[bytes]:
        """Yield the payloads in turn."""
        text = self.text.data
        for start, length in zip(self.start.tolist(), self.length.tolist(), strict=True):
            yield bytes(text[start : start + length])

    def by_length(self) -> Iterator[tuple[NDArray[np.intp], int, memoryview]]:
        """Yield rows of messages of equal length, the length, and a byte and payload each."""
        if (self.length == self.length[0]).all():
            yield np.arange(self.length.size), int(self.length[0]), self.text.data
            return
        for length in np.flatnonzero(np.bincount(self.length)).tolist():
            rows = np.flatnonzero(self.length == length)
            text = fields_at(self.text.data, self.start[rows] - 1, f"V{length + 1}")
            yield rows, length, text.view(np.uint8).data


@dataclass(frozen=True, slots=True)
class Decoded:
    """Readings of the wanted fields of messages, what they say of them, and stamps if wanted."""

    fields: Mapping[FieldPath, Readings]
    stamps: WrittenStamps | None
    qualities: Mapping[FieldPath, pa.Array]


class Decoder(NamedTuple):
    """How messages of an encoding and schema are read."""

    decode: Callable[[Payloads], Decoded]
    tree: Callable[[bytes], Any]  # a message as dicts, lists and values; None for what is none


Value = Callable[[Any], Any]
"""A function of a message that gives what a path leads to; None where it leads nowhere."""


def payloads_of(messages: Messages, chosen: Rows, time_ns: NDArray[np.uint64]) -> Payloads:
    """Return payloads of the chosen messages, one at least, with the times of all messages."""
    starts, ends = messages.payload_start(chosen), messages.payload_end[chosen]
    length = ends - starts
    if (length == length[0]).all():
        size = int(length[0]) + 1
        text = fields_at(messages.buffer, starts - 1, f"V{size}").view(np.uint8)
    else:
        edges = np.append(np.column_stack([starts - 1, ends]), ends[-1])
        buffers = [None, pa.py_buffer(edges), pa.py_buffer(messages.buffer)]
        pieces = pa.Array.from_buffers(pa.large_binary(), edges.size - 1, buffers)
        texts = pieces.take(pa.array(np.arange(0, edges.size - 1, 2)))
        text = np.frombuffer(texts.buffers()[2], np.uint8, int((length + 1).sum()))
    payloads = Payloads(text, length, time_ns[chosen])
    text[payloads.start - 1] = _NEWLINE
    return payloads


def stacked(parts: Sequence[Payloads]) -> Payloads:
    """Return payloads in turn."""
    arrays = zip(*((part.text, part.length, part.time_ns) for part in parts), strict=True)
    return Payloads(*map(np.concatenate, arrays))


def one_by_one(
    messages: Sequence[Any], wanted: Wanted, values: Mapping[FieldPath, Value], example: str
) -> Decoded:
    """Return what is wanted of messages, None for what is none; `example` is a message in words.

    `values` are the functions of a message by path.
    """
    by_path = {
        path: [None if message is None else value(message) for message in messages]
        for path, value in values.items()
    }
    broken = np.array([message is None for message in messages], np.bool_)
    fields = {path: _readings(by_path[path], broken, example) for path in wanted.readings}
    words = {path: pa.array(map(_word, by_path[path]), pa.string()) for path in wanted.qualities}
    stamps = None if wanted.stamp is None else stamps_of(by_path[wanted.stamp], wanted.time_format)
    return Decoded(fields, stamps, words)


def _readings(values: list[Any], broken: NDArray[np.bool_], example: str) -> Readings:
    missing = np.array([value is None for value in values], np.bool_)
    try:
        if set(map(type, values)) <= {int, float, type(None)}:
            raw = np.array(values, np.float64)
            return Readings(raw, missing, broken, example if broken.any() else None)
    except OverflowError:
        pass
    numbers = [number_of(value) for value in values]
    unparsed = broken | (~missing & np.array([number is None for number in numbers], np.bool_))
    first = int(np.argmax(unparsed))
    shown = example if broken[first] else repr(values[first])[:60]
    raw = np.array(numbers, np.float64)
    return Readings(raw, missing | unparsed, unparsed, shown if unparsed.any() else None)


def no_field(path: Path, topic: str, field: FieldPath, there: Iterable[str]) -> LogError:
    """Return the error of a field that no message of a topic has, with those that there are."""
    names = ", ".join(map(repr, islice(there, _MOST_NAMES)))
    how = f"no message of topic {topic!r} has a field {path_text(field)!r}; there are {names}"
    return LogError("log_column_missing", path, how, topic)


def number_of(value: object) -> float | None:
    """Return a number as a float; None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:  # An integer of more than 308 digits is a number, but not finite.
        return math.inf if value > 0 else -math.inf


def _word(value: object) -> str | None:
    # Halves of letters beyond the first 65 536 are no text to Arrow.
    return None if value is None else str(value).encode(errors="replace").decode()


def stamps_of(values: Sequence[Any], time_format: str) -> WrittenStamps:
    """Return stamps of any kind each: text, a number, or a message of seconds and nanoseconds."""
    is_counted = time_format in (*EPOCH_UNITS, EXCEL_DAYS)
    texts = pa.array([_stamp_text(value, is_counted) for value in values], pa.string())
    stamps = parse_written([pa.chunked_array([texts])], time_format)
    names = {i: pair_of(value) for i, value in enumerate(values) if isinstance(value, dict)}
    parts = [(i, values[i][pair[0]], values[i][pair[1]]) for i, pair in names.items() if pair]
    if not parts:
        return stamps
    rows, seconds, nanoseconds = zip(*parts, strict=True)
    pairs = stamps_of_pairs(_int64(seconds), _int64(nanoseconds))
    time_us, kind = stamps.time_us.copy(), stamps.kind.copy()
    time_us[list(rows)], kind[list(rows)] = pairs.time_us, pairs.kind
    return WrittenStamps(time_us, kind, stamps.example or pairs.example)


def _stamp_text(value: object, is_counted: bool) -> str | None:
    if type(value) is str:
        # No stamp holds a letter beyond ASCII, and halves of such letters are no text to Arrow.
        return value if value.isascii() else None
    return repr(value) if is_counted and type(value) in (int, float) else None


Numbers = tuple[NDArray[Any], NDArray[np.bool_]]
"""Numbers, and where there are any."""


def _int64(values: Sequence[Any]) -> Numbers:
    """Return whole numbers, 0 where there is none, and where there are any."""
    there = [type(value) is int and _INT64.min <= value <= _INT64.max for value in values]
    whole = [value if ok else 0 for value, ok in zip(values, there, strict=True)]
    return np.array(whole, np.int64), np.array(there, np.bool_)


def pair_of(names: Container[str]) -> tuple[str, str] | None:
    """Return those names of some that are of the seconds and nanoseconds of a stamp."""
    seconds = next((name for name in SECONDS if name in names), None)
    nanoseconds = next((name for name in NANOSECONDS if name in names), None)
    return (seconds, nanoseconds) if seconds and nanoseconds else None


def stamps_of_numbers(parts: Sequence[Numbers], time_format: str) -> WrittenStamps:
    """Return stamps of a number each, or of whole seconds and nanoseconds."""
    return stamps_of_pairs(*parts) if len(parts) > 1 else parse_numbers(parts[0][0], time_format)


def stamps_of_pairs(seconds: Numbers, nanoseconds: Numbers) -> WrittenStamps:
    """Return stamps of whole seconds since 1970, UTC, and nanoseconds, cut off to microseconds."""
    (whole, there), (rest, also) = seconds, nanoseconds
    sound = there & also & (whole >= 0) & (whole < LATEST_US // 1_000_000)
    sound &= (rest >= 0) & (rest < 1_000_000_000)
    time_us = np.where(sound, whole, 0).astype(np.int64) * 1_000_000
    time_us += np.where(sound, rest, 0).astype(np.int64) // 1000
    return parse_numbers(time_us, "epoch_us")


def value_at(node: Any, path: FieldPath) -> Any:
    """Return the value that a path leads to in a tree; None where it leads nowhere."""
    for step in path:
        if not _leads(node, step):
            return None
        node = node[step]
    return node


def has(node: Any, path: FieldPath) -> bool:
    """Return True if a path leads to something, be it null, or is cut short by a null."""
    for step in path:
        if not _leads(node, step):
            return node is None
        node = node[step]
    return True


def _leads(node: object, step: str | int) -> bool:
    """Return True for a dict with such a key, or a list with such a position."""
    if isinstance(step, str):
        return isinstance(node, dict) and step in node
    return isinstance(node, list) and step < len(node)


def leaves(node: Any, path: FieldPath = ()) -> Iterator[tuple[FieldPath, Any]]:
    """Yield values that are neither dicts nor lists, by path; of a list the first ones."""
    below: Sequence[tuple[Any, Any]] = ()
    if isinstance(node, dict):
        below = list(node.items())
    elif isinstance(node, list):
        below = list(enumerate(node[:ELEMENTS_SHOWN]))
    else:
        yield path, node
    for step, inner in below if len(path) < _DEEPEST else ():
        # A key without a letter cannot stand in a path.
        if step != "":
            yield from leaves(inner, (*path, step))

"""Messages of ROS 2 in CDR, the encoding of DDS, as a definition in ``ros2msg`` says.

The format's own package reads definitions and messages. Of messages of one length, whose texts and
sequences have one length too, it reads the first, and says where each number stands in it; the
wanted ones are then taken from all of these messages at once. Where they have too many layouts, or
one is cut, it reads each message, which takes some thirty times as long. It reads no ``wstring``
and no types of ROS 1.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from mcap_ros2._cdr import CdrReader
from mcap_ros2._dynamic import TimeDefinition, _for_each_msgdef, _read_complex_type
from mcap_ros2._vendor.rosidl_adapter.parser import MessageSpecification
from numpy.typing import NDArray

from pipeline.config.dialect import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.decoding import (
    Decoded,
    Decoder,
    Payloads,
    Wanted,
    leaves,
    number_of,
    one_by_one,
    pair_of,
    stamps_of_pairs,
    value_at,
)
from pipeline.ingest.mcap.layout import Schema, column
from pipeline.ingest.time_stamps import WrittenStamps, written_as_numbers

_ORDERS = {b"\x00\x00", b"\x00\x01"}
"""Representation identifiers of plain CDR: high byte first, low byte first."""

_OTHERS = {bytes([0, mark]) for mark in (*range(2, 12), *range(0x10, 0x16))}
"""Identifiers of PL_CDR, XML, CDR2, D_CDR2 and PL_CDR2 (DDS-XTypes 1.3, table 60)."""

_HEAD = 4
_BROKEN = "a message that is cut or not in CDR"
_MOST_NAMES = 40
_MOST_LAYOUTS = 16

MOST_READ = 2**18
"""Numbers of a message; definitions of a few lines may have any number, one in another."""

_Definitions = dict[str, MessageSpecification]
"""Definitions of messages by ``package/Name``."""


def ros2_decoder(path: Path, topic: str, schema: Schema, wanted: Wanted) -> Decoder:
    """Decoder of the messages of a topic.

    Raises
    ------
    LogError
        ``log_damaged`` for a definition that is none, ``log_encoding`` for a type that is not read,
        ``log_column_missing`` or ``log_type`` for a field that is not in it or no number, and
        ``log_too_large`` where messages have no end of numbers. The decoder raises
        ``log_encoding`` where no message is in plain CDR, and ``log_too_large``.
    """
    paths = (*wanted.readings, *wanted.qualities)
    topic_of = _Topic(path, topic, _short(schema.name), _definitions(path, topic, schema))
    sample = topic_of.sample(schema, paths)
    for number in paths:
        _require_number(path, topic, sample, number)
    stamp = () if wanted.stamp is None else (wanted.stamp,)
    values = {at: partial(value_at, path=at) for at in (*paths, *stamp)}
    parts = _stamp_parts(sample, wanted.stamp)

    def tree(payload: bytes) -> Any:
        message = topic_of.read(payload, _Reader)
        return None if message is None else _tree(message)

    def decode(payloads: Payloads) -> Decoded:
        _require_plain(path, topic, payloads)
        numbers = _at_once(payloads, topic_of, (*paths, *parts))
        if numbers is None:
            return one_by_one(list(map(tree, payloads.each())), wanted, values, _BROKEN)
        none, floats = np.zeros(payloads.length.size, np.bool_), np.float64
        fields = {at: Readings(numbers[at].astype(floats), none, none) for at in wanted.readings}
        words = {at: pa.array(numbers[at]) for at in wanted.qualities}
        return Decoded(fields, _stamps([numbers[at] for at in parts], wanted.time_format), words)

    return Decoder(decode, tree)


@dataclass(frozen=True, slots=True)
class _Topic:
    """The messages of a topic, as the package reads them."""

    path: Path
    name: str
    root: str  # the message's own definition
    definitions: _Definitions
    classes: dict[str, type] = field(default_factory=dict)  # the package's, of messages

    def read(self, payload: bytes, reader_of: Callable[[bytes], CdrReader]) -> Any:
        """A message; None for one that is cut, or in another encoding."""
        if payload[:2] not in _ORDERS or len(payload) < _HEAD:
            return None
        reader, root = reader_of(payload), self.definitions[self.root]
        try:
            message = _read_complex_type(root, self.definitions, reader, self.classes)
        except struct.error:
            return None
        except OverflowError as error:
            raise _too_large(self.path, self.name) from error
        return message if reader.offset <= len(payload) else None

    def sample(self, schema: Schema, paths: Sequence[FieldPath]) -> Any:
        """A message of zeros, as dicts, lists and values; its sequences are as long as is asked.

        Raises LogError as `ros2_decoder`.
        """
        longest = 1 + max((step for at in paths for step in at if isinstance(step, int)), default=0)
        zeros = b"\0\1" + bytes(2 + 8 * MOST_READ)
        try:
            message = self.read(zeros, partial(_SampleReader, length=longest))
        except NotImplementedError as error:
            how = f"messages of topic {self.name!r} have a field that is not read: {error}"
            raise LogError("log_encoding", self.path, how, self.name) from error
        except (LookupError, ValueError, RecursionError) as error:
            raise _damaged(self.path, schema, error) from error
        if message is None:
            raise _too_large(self.path, self.name)
        return _tree(message)


def _tree(node: Any) -> Any:
    """A value as dicts, lists and plain values."""
    names = getattr(type(node), "__slots__", ())
    if names:
        return {name: _tree(getattr(node, name)) for name in names}
    if isinstance(node, list | bytes):
        return [_tree(element) for element in node]
    return int(node) if isinstance(node, bool) else node


def _require_plain(path: Path, topic: str, payloads: Payloads) -> None:
    if payloads.first[:2] in _ORDERS:
        return
    heads = {payload[:2] for payload in payloads.each()}
    if heads & _OTHERS and not heads & _ORDERS:
        raise LogError(
            "log_encoding",
            path,
            f"messages of topic {topic!r} are in a representation of DDS that is not read, such as "
            "PL_CDR or CDR2; read is plain CDR of version 1, as ROS 2 writes it",
            topic,
        )


# Definitions


def _definitions(path: Path, topic: str, schema: Schema) -> _Definitions:
    """Definitions of a message and of those that it is made of."""
    # rosbag2 puts a service's own definition there, or the package refuses the name.
    if re.search(rb"^(SRV:|---)", schema.data, re.MULTILINE) or "/srv/" in schema.name:
        how = f"messages of topic {topic!r} are events of a service, which are not read"
        raise LogError("log_encoding", path, how, topic)
    # Recorders leave these out where nothing else names them.
    times = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
    definitions = dict.fromkeys(times, TimeDefinition)

    def add(_: str, short_name: str, definition: MessageSpecification) -> None:
        definitions[short_name] = definition

    try:
        # Its parser prints what it raises.
        with redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            _for_each_msgdef(schema.name, schema.data.decode(), add)
    # The package raises whatever its parser meets.
    except Exception as error:
        raise _damaged(path, schema, error) from error
    return definitions


def _short(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return f"{name.split('/')[0]}/{name.split('/')[-1]}"


def _damaged(path: Path, schema: Schema, error: Exception) -> LogError:
    return LogError("log_damaged", path, f"the definition of {schema.name} cannot be read: {error}")


def _too_large(path: Path, topic: str) -> LogError:
    how = f"messages of topic {topic!r} have more than {MOST_READ} numbers"
    return LogError("log_too_large", path, how, topic)


def _require_number(path: Path, topic: str, sample: Any, wanted: FieldPath) -> None:
    """Refuse a field that a sample of the messages has not, or that is no number there."""
    value = value_at(sample, wanted)
    if value is None:
        numbers = (at for at, leaf in leaves(sample) if number_of(leaf) is not None)
        there = ", ".join(repr(path_text(at)) for at in islice(numbers, _MOST_NAMES))
        how = f"messages of topic {topic!r} have no field {path_text(wanted)!r}; there are {there}"
        raise LogError("log_column_missing", path, how, topic)
    if number_of(value) is None:
        kind = "an array" if isinstance(value, list) else "text or a message"
        how = f"field {path_text(wanted)!r} is no number but {kind}"
        raise LogError("log_type", path, how, topic)


def _stamp_parts(sample: Any, stamp: FieldPath | None) -> tuple[FieldPath, ...]:
    """Where a stamp's number stands, or its seconds and nanoseconds."""
    if stamp is None:
        return ()
    value = value_at(sample, stamp)
    names = pair_of(value) if isinstance(value, dict) else None
    return (stamp,) if names is None else tuple((*stamp, name) for name in names)


# Messages


class _Payload(bytes):
    """A payload that counts what is read of it: numbers, and arrays of bytes."""

    n_read = 0

    def __getitem__(self, part: Any) -> Any:
        self.count_one()
        return super().__getitem__(part)

    def count_one(self) -> None:
        """Count one more; raises OverflowError if these are too many."""
        self.n_read += 1
        if self.n_read > MOST_READ:
            raise OverflowError


class _Reader(CdrReader):
    """The package's reader, which does not read without an end."""

    data: _Payload

    def __init__(self, payload: bytes) -> None:
        super().__init__(_Payload(payload))

    def _unpack(self, fn: Any, size: int) -> Any:
        self.data.count_one()
        return super()._unpack(fn, size)

    def string_raw(self, length: int) -> str:
        """A text, in whatever encoding."""
        return self.uint8_array(length).decode(errors="replace")


class _SampleReader(_Reader):
    """A reader of a message of which all texts and sequences have one length."""

    def __init__(self, payload: bytes, length: int) -> None:
        super().__init__(payload)
        self.length = length

    def uint32(self) -> int:
        """A length: for numbers of a message the package takes the class's own function."""
        return self.length


class _Place(NamedTuple):
    """Where a number stands in a payload, and its type."""

    at: int
    kind: str

    def __ne__(self, _: object) -> Any:
        """The place of a truth value, which the package makes by comparing a byte with 0."""
        return _Place(self.at, "?")


class _PlaceReader(_Reader):
    """A reader that gives the places of numbers instead of the numbers, but for lengths."""

    def __init__(self, payload: bytes, lengths: list[int]) -> None:
        super().__init__(payload)
        self.lengths = lengths  # where these stand

    def _unpack(self, fn: Any, size: int) -> Any:
        super()._unpack(fn, size)
        return _Place(self.offset - size, fn.__self__.format)

    def uint32(self) -> int:
        """A length, as of `_SampleReader`."""
        place: Any = super().uint32()
        self.lengths.append(place.at)
        return int(np.frombuffer(self.data, place.kind, 1, place.at)[0])


def _at_once(
    payloads: Payloads, topic: _Topic, paths: Sequence[FieldPath]
) -> dict[FieldPath, NDArray[Any]] | None:
    """Numbers at some paths; None unless messages have few layouts, and each has all the numbers.

    They keep their type: those of a stamp have more digits than a float64.
    """
    numbers: dict[FieldPath, NDArray[Any]] = {}
    for rows, length, text in payloads.by_length():
        left, size = np.arange(rows.size), length + 1
        for _ in range(_MOST_LAYOUTS):
            first, lengths = bytes(text[left[0] * size + 1 :][:length]), list[int]()
            message = topic.read(first, partial(_PlaceReader, lengths=lengths))
            if message is None:
                return None
            same = column(text, 1, "V2", size)[left] == np.frombuffer(first, "V2", 1)
            for at in lengths:
                same &= column(text, at + 1, "V4", size)[left] == np.frombuffer(first, "V4", 1, at)
            own, left = left[same], left[~same]
            tree = _tree(message)
            for path in paths:
                place = value_at(tree, path)
                if not isinstance(place, _Place):
                    return None
                values = column(text, place.at + 1, place.kind.replace("?", "u1"), size)[own]
                values = values != 0 if place.kind == "?" else values
                empty = np.empty(payloads.length.size, values.dtype.newbyteorder("="))
                numbers.setdefault(path, empty)[rows[own]] = values
            if not left.size:
                break
        else:
            return None
    return numbers


def _stamps(parts: Sequence[NDArray[Any]], time_format: str) -> WrittenStamps | None:
    if len(parts) < 2:
        return written_as_numbers(parts[0], time_format) if parts else None
    there = np.ones(parts[0].size, np.bool_)
    return stamps_of_pairs(*((part, there) for part in parts))

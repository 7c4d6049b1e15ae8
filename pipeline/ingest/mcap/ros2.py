"""Messages of ROS 2 in CDR, the encoding of DDS, as a definition in ``ros2msg`` says.

The format's own package reads definitions. Where numbers stand in a message depends on the lengths
of its texts and sequences alone: of messages that are alike in these, the wanted numbers are taken
from all at once. Where too many are not alike, or any is cut, each is read by itself, which takes
some thirty times as long. No ``wstring`` is read, and no types of ROS 1.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from mcap.records import Schema
from mcap_ros2._dynamic import TimeDefinition, _for_each_msgdef
from mcap_ros2._vendor.rosidl_adapter.parser import MessageSpecification
from numpy.typing import NDArray

from pipeline.config.logs import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.decoding import (
    ELEMENTS_SHOWN,
    Decoded,
    Decoder,
    Payloads,
    Wanted,
    leaves,
    no_field,
    number_of,
    one_by_one,
    pair_of,
    stamps_of_numbers,
    value_at,
)
from pipeline.ingest.mcap.messages import column

_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
"""Representation identifiers of plain CDR: high byte first, low byte first."""

_OTHERS = {bytes([0, mark]) for mark in (*range(2, 12), *range(0x10, 0x16))}
"""Identifiers of PL_CDR, XML, CDR2, D_CDR2 and PL_CDR2 (DDS-XTypes 1.3, table 60)."""

_NUMBERS = "bool byte char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float32 float64"
_FORMATS = dict(zip(_NUMBERS.split(), "?BbbBhHiIqQfd", strict=True))
_HEAD = 4
_TEXT = "text"
_BROKEN = "a message that is cut or not in CDR"
_MOST_LAYOUTS = 16

MOST_READ = 2**18
"""Numbers of a message; definitions of a few lines may have any number, nested."""


def ros2_decoder(path: Path, topic: str, schema: Schema, wanted: Wanted) -> Decoder:
    """Return decoder of the messages of a topic.

    Raises LogError: ``log_damaged`` for a definition that is none, ``log_encoding`` for a type that
    is not read, ``log_column_missing`` or ``log_type`` for a field that is not in it or no number,
    and ``log_too_large`` where messages have no end of numbers. The decoder raises ``log_encoding``
    where no message is in plain CDR, and ``log_too_large``.
    """
    paths = (*wanted.readings, *wanted.qualities)
    stamp = () if wanted.stamp is None else (wanted.stamp,)
    steps = [step for at in (*paths, *stamp) for step in at if isinstance(step, int)]
    layout = _Layout(path, topic, schema, 1 + max(steps, default=0))
    sample = layout.sample()
    for number in paths:
        _require_number(path, topic, sample, number)
    values = {at: partial(value_at, path=at) for at in (*paths, *stamp)}
    parts = _stamp_parts(sample, wanted.stamp)

    def tree(payload: bytes) -> Any:
        places = layout.places(payload)
        return None if places is None else _fill(places, payload)

    def decode(payloads: Payloads) -> Decoded:
        _require_plain(path, topic, payloads)
        numbers = _at_once(payloads, layout, (*paths, *parts))
        if numbers is None:
            return one_by_one(list(map(tree, payloads.each())), wanted, values, _BROKEN)
        none, floats = np.zeros(payloads.length.size, np.bool_), np.float64
        fields = {at: Readings(numbers[at].astype(floats), none, none) for at in wanted.readings}
        words = {at: pa.array(numbers[at]) for at in wanted.qualities}
        counts = [(numbers[at], ~none) for at in parts]
        stamps = stamps_of_numbers(counts, wanted.time_format) if counts else None
        return Decoded(fields, stamps, words)

    return Decoder(decode, tree)


def _require_plain(path: Path, topic: str, payloads: Payloads) -> None:
    """Refuse messages none of which is in plain CDR."""
    if payloads.first[:2] in _ORDERS:
        return
    heads = {payload[:2] for payload in payloads.each()}
    if heads & _OTHERS and not heads & _ORDERS.keys():
        raise LogError(
            "log_encoding",
            path,
            f"messages of topic {topic!r} are in a representation of DDS that is not read, such as "
            "PL_CDR or CDR2; read is plain CDR of version 1, as ROS 2 writes it",
            topic,
        )


# Definitions


def _definitions(path: Path, topic: str, schema: Schema) -> dict[str, MessageSpecification]:
    """Return definitions of a message and of those that it is made of, by ``package/Name``."""
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


def _damaged(path: Path, schema: Schema, error: Exception) -> LogError:
    return LogError("log_damaged", path, f"the definition of {schema.name} cannot be read: {error}")


def _require_number(path: Path, topic: str, sample: Any, wanted: FieldPath) -> None:
    """Refuse a field that a sample of the messages has not, or that is no number there."""
    value = value_at(sample, wanted)
    if value is None:
        numbers = (path_text(at) for at, leaf in leaves(sample) if number_of(leaf) is not None)
        raise no_field(path, topic, wanted, numbers)
    if number_of(value) is None:
        kind = "an array" if isinstance(value, list) else "text or a message"
        how = f"field {path_text(wanted)!r} is no number but {kind}"
        raise LogError("log_type", path, how, topic)


def _stamp_parts(sample: Any, stamp: FieldPath | None) -> tuple[FieldPath, ...]:
    """Return where a stamp's number stands, or its seconds and nanoseconds."""
    if stamp is None:
        return ()
    value = value_at(sample, stamp)
    names = pair_of(value) if isinstance(value, dict) else None
    return (stamp,) if names is None else tuple((*stamp, name) for name in names)


# Messages


class _Place(NamedTuple):
    """Where a number or a text stands in a payload."""

    at: int
    kind: str  # format of a number as of `struct`, or `_TEXT`
    size: int


class _Layout:
    """Goes through messages and gives places in the place of numbers and texts."""

    def __init__(self, path: Path, topic: str, schema: Schema, longest: int) -> None:
        self.path, self.topic, self.schema = path, topic, schema
        package, *_, name = schema.name.split("/")
        self.root = f"{package}/{name}"
        self.definitions = _definitions(path, topic, schema)
        self.longest = longest  # elements that are wanted of a sequence
        self.lengths: list[int] = []  # places where a message states those of its sequences

    def places(self, payload: bytes, length: int | None = None) -> Any:
        """Return a message as dicts, lists and places; None if it is cut, or no plain CDR.

        With `length`, all its texts and sequences are so long, whatever it says.
        """
        if payload[:2] not in _ORDERS or len(payload) < _HEAD:
            return None
        self.payload, self.length, self.lengths = payload, length, []
        self.order, self.at, self.n_read = _ORDERS[payload[:2]], _HEAD, 0
        try:
            return self._message(self.root)
        except EOFError:
            return None
        except OverflowError as error:
            raise self._too_large() from error

    def sample(self) -> Any:
        """Return a message of zeros with sequences as long as is wanted; raises as the decoder."""
        zeros = b"\0\1" + bytes(2 + 8 * MOST_READ)
        try:
            places = self.places(zeros, self.longest)
        except NotImplementedError as error:
            how = f"messages of topic {self.topic!r} have a field that is not read: {error}"
            raise LogError("log_encoding", self.path, how, self.topic) from error
        except (LookupError, ValueError, RecursionError) as error:
            raise _damaged(self.path, self.schema, error) from error
        if places is None:
            raise self._too_large()
        return _fill(places, zeros)

    def _too_large(self) -> LogError:
        how = f"messages of topic {self.topic!r} have more than {MOST_READ} numbers"
        return LogError("log_too_large", self.path, how, self.topic)

    def _message(self, name: str) -> dict[str, Any]:
        fields = self.definitions[name].fields
        if not fields:
            self._take(1)  # DDS knows no empty message: a byte stands for it
        return {field.name: self._value(field.type) for field in fields}

    def _value(self, kind: Any) -> Any:
        if not kind.is_array:
            return self._single(kind)
        count = kind.array_size if kind.is_fixed_size_array() else self._length()
        if not kind.is_primitive_type() or kind.type not in _FORMATS:
            return [self._single(kind) for _ in range(count)]
        if not count:
            return []
        # Bytes, such as those of a picture, count as a number.
        first = self._number(kind.type, count, 1 if kind.type in ("byte", "uint8") else count)
        shown = range(min(count, max(self.longest, ELEMENTS_SHOWN)))
        return [first._replace(at=first.at + i * first.size) for i in shown]

    def _single(self, kind: Any) -> Any:
        if not kind.is_primitive_type():
            return self._message(f"{kind.pkg_name}/{kind.type}")
        if kind.type == "string":
            size = self._length()
            return _Place(self._take(size), _TEXT, size)
        if kind.type not in _FORMATS:
            raise NotImplementedError(f"type {kind.type}")
        return self._number(kind.type)

    def _length(self) -> int:
        if self.length is not None:
            return self.length
        place = self._number("uint32")
        self.lengths.append(place.at)
        return int(_fill(place, self.payload))

    def _number(self, kind: str, count: int = 1, n_read: int = 1) -> _Place:
        """Return the place of the first of some numbers, aligned to their size."""
        form = self.order + _FORMATS[kind]
        size = struct.calcsize(form)
        self.at += (_HEAD - self.at) % size
        return _Place(self._take(count * size, n_read), form, size)

    def _take(self, size: int, n_read: int = 1) -> int:
        """Pass over some bytes, and return where they begin."""
        begin, self.at = self.at, self.at + size
        self.n_read += n_read
        # A damaged length claims more than there is: that costs the message, not the log.
        if self.at > len(self.payload):
            raise EOFError
        if self.n_read > MOST_READ:
            raise OverflowError
        return begin


def _fill(node: Any, payload: bytes) -> Any:
    """Return dicts and lists with what stands at their places."""
    if isinstance(node, dict):
        return {name: _fill(inner, payload) for name, inner in node.items()}
    if isinstance(node, list):
        return [_fill(inner, payload) for inner in node]
    if node.kind == _TEXT:
        return payload[node.at : node.at + node.size].removesuffix(b"\0").decode(errors="replace")
    number = struct.unpack_from(node.kind, payload, node.at)[0]
    return int(number) if isinstance(number, bool) else number


def _at_once(
    payloads: Payloads, layout: _Layout, paths: Sequence[FieldPath]
) -> dict[FieldPath, NDArray[Any]] | None:
    """Return numbers at some paths; None if layouts are many, or any lacks a number.

    They keep their type: those of a stamp have more digits than a float64.
    """
    numbers: dict[FieldPath, NDArray[Any]] = {}
    for rows, length, text in payloads.by_length():
        left, size = np.arange(rows.size), length + 1
        for _ in range(_MOST_LAYOUTS):
            first = bytes(text[left[0] * size + 1 :][:length])
            message = layout.places(first)
            if message is None:
                return None
            same = column(text, 1, "V2", size)[left] == np.frombuffer(first, "V2", 1)
            for at in layout.lengths:
                same &= column(text, at + 1, "V4", size)[left] == np.frombuffer(first, "V4", 1, at)
            own, left = left[same], left[~same]
            for path in paths:
                place = value_at(message, path)
                if not isinstance(place, _Place) or place.kind == _TEXT:
                    return None
                is_truth = place.kind.endswith("?")
                kind = "u1" if is_truth else place.kind
                values = column(text, place.at + 1, kind, size)[own]
                values = values != 0 if is_truth else values
                empty = np.empty(payloads.length.size, values.dtype.newbyteorder("="))
                numbers.setdefault(path, empty)[rows[own]] = values
            if not left.size:
                break
        else:
            return None
    return numbers

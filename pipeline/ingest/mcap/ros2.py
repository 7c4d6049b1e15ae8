"""Messages of ROS 2 in CDR, the encoding of DDS, laid out as a definition in ``ros2msg`` says.

Messages of one length, whose texts and sequences have one length too, have one layout: it is found
in the first of them, and their numbers are then read at once. All others are decoded one by one by
the format's own package, which reads no ``wstring`` and no types of ROS 1. CDR aligns a number to
its own size, counted from behind the four bytes that say the byte order (OMG DDS-XTypes 1.3, 7.4.1,
XCDR version 1).
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.config.field_paths import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.decoding import (
    NANOSECONDS,
    SECONDS,
    Decoded,
    Decoder,
    Numbers,
    Payloads,
    Value,
    Wanted,
    one_by_one,
    stamps_of_numbers,
    stamps_of_pairs,
)
from pipeline.ingest.mcap.layout import Schema, column
from pipeline.ingest.time_stamps import WrittenStamps

_HEAD = 4
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
"""Byte order by representation identifier, for plain CDR."""

_OTHERS = {bytes([0, mark]) for mark in (*range(2, 12), *range(0x10, 0x16))}
"""Identifiers of PL_CDR, XML, CDR2, D_CDR2 and PL_CDR2 (DDS-XTypes 1.3, table 60)."""

_NUMBERS = {
    "bool": "?",
    "byte": "u1",
    # Unsigned in ROS 2; signed in the format's own package, whose figures we keep.
    "char": "i1",
    "float32": "f4",
    "float64": "f8",
    **{f"int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
}
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(\[(?:<=)?\d*\])?")
_TIME = (("sec", "uint32", ""), ("nanosec", "uint32", ""))
# Recorders leave these out where nothing else names them.
_BUILT_IN = {"builtin_interfaces/Time": _TIME, "builtin_interfaces/Duration": _TIME}
_BROKEN = "a message that is cut or not in CDR"

MOST_FIELDS = 2**18
"""Fields of a message; definitions of a few lines may have any number, one in another."""

_LONGEST_SIZE = len("[<=1000000000]")
_LONGEST_ALONE = 2**20
"""Bytes of a message that is decoded by itself."""

_MOST_LAYOUTS = 4
"""Layouts of messages of one length that are tried before the rest is decoded one by one."""

_Fields = tuple[tuple[str, str, str], ...]
"""Name, type and array of each field of a message; the array is empty for a single value."""


class _CutError(Exception):
    """A message ends before all that it says it has."""


class _TooManyFieldsError(Exception):
    """A message has more fields than any of a log."""


def ros2_decoder(path: Path, topic: str, schema: Schema, wanted: Wanted) -> Decoder:
    """Decoder of the messages of a topic.

    Raises
    ------
    LogError
        ``log_damaged`` for a definition that is none, ``log_encoding`` for a type that is not read.
        The decoder raises ``log_encoding`` where no message is in plain CDR, and ``log_too_large``
        where messages have no end of fields.
    """
    decode_one = _decode_function(path, topic, schema)
    definitions, root = _definitions(schema), _short(schema.name)
    try:
        _require_known(definitions, root, (), set())
    except NotImplementedError as error:
        how = f"messages of topic {topic!r} have {error}"
        raise LogError("log_encoding", path, how, topic) from error
    except (ValueError, RecursionError) as error:
        how = f"the definition of {schema.name} cannot be read: {error}"
        raise LogError("log_damaged", path, how) from error
    for one in (*wanted.readings, *wanted.qualities):
        _require_number(path, topic, definitions, root, one)
    pairs = tuple((*wanted.stamp, name) for name in (*SECONDS, *NANOSECONDS) if wanted.stamp)
    stamp = (wanted.stamp, *pairs) if wanted.stamp else ()
    paths = frozenset((*wanted.readings, *wanted.qualities, *stamp))
    values = {one: _value(one) for one in (*wanted.readings, *wanted.qualities, *stamp[:1])}
    layouts = _Layouts(definitions, root, paths)

    def decode(payloads: Payloads) -> Decoded:
        _require_plain(path, topic, payloads)
        try:
            found = layouts.read(payloads)
        except _TooManyFieldsError as error:
            how = f"messages of topic {topic!r} have more fields, one in another, than are read"
            raise LogError("log_too_large", path, how, topic) from error
        rest = np.flatnonzero(~found.done)
        if not rest.size:
            return found.decoded(wanted)
        if payloads.length[rest].max() > _LONGEST_ALONE:
            how = f"a message of topic {topic!r} has more than {_LONGEST_ALONE} bytes"
            raise LogError("log_too_large", path, how, topic)
        messages = list(map(decode_one, payloads.each(rest)))
        others = one_by_one(messages, wanted, values, _BROKEN)
        return found.decoded(wanted, others, rest)

    def tree(payload: bytes) -> Any:
        message = decode_one(payload)
        return None if message is None else _tree(message)

    return Decoder(decode, tree)


def _decode_function(path: Path, topic: str, schema: Schema) -> Value:
    """Function of a payload that gives its message by the format's own package, or None."""
    # Imported where it is needed: most logs have no such messages.
    from mcap.records import Schema as SchemaRecord
    from mcap_ros2.decoder import DecoderFactory

    record = SchemaRecord(1, schema.data, "ros2msg", schema.name)
    # rosbag2 puts a service's own definition there, or the package refuses the name.
    if re.search(rb"^(SRV:|---)", schema.data, re.MULTILINE) or "/srv/" in schema.name:
        how = f"messages of topic {topic!r} are events of a service, which are not read"
        raise LogError("log_encoding", path, how, topic)
    try:
        # Its parser prints what it raises.
        with redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            decode_plain: Any = DecoderFactory().decoder_for("cdr", record)
    # The package raises whatever its parser meets.
    except Exception as error:
        how = f"the definition of {schema.name} cannot be read: {error}"
        raise LogError("log_damaged", path, how) from error

    def decode(payload: bytes) -> Any:
        if payload[:2] not in _ORDERS:
            return None
        try:
            return decode_plain(payload)
        except NotImplementedError as error:
            how = f"messages of topic {topic!r} have a type that is not read: {error}"
            raise LogError("log_encoding", path, how, topic) from error
        except (struct.error, ValueError, LookupError, TypeError, RecursionError):
            return None

    return decode


def _require_plain(path: Path, topic: str, payloads: Payloads) -> None:
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


def _value(path: FieldPath) -> Value:
    def value(message: Any) -> Any:
        for step in path:
            is_list = isinstance(message, list | bytes)
            if isinstance(step, int):
                message = message[step] if is_list and step < len(message) else None
            else:
                message = getattr(message, step) if step in _names(message) else None
        return _tree(message)

    return value


def _names(message: Any) -> tuple[str, ...]:
    return tuple(getattr(type(message), "__slots__", ()))


def _tree(node: Any) -> Any:
    """A value as dicts, lists and plain values."""
    names = _names(node)
    if names:
        return {name: _tree(getattr(node, name)) for name in names}
    if isinstance(node, list | bytes):
        return [_tree(one) for one in node]
    return int(node) if isinstance(node, bool) else node


def _definitions(schema: Schema) -> dict[str, _Fields]:
    """Fields of a message and of those that it is made of, by name; constants have no layout."""
    found: dict[str, _Fields] = dict(_BUILT_IN)
    name = _short(schema.name)
    for text in re.split(r"^={3,}\s*$", schema.data.decode(), flags=re.MULTILINE):
        fields = []
        for line in text.splitlines():
            words = line.partition("#")[0].split()
            if words[:1] == ["MSG:"] and len(words) > 1:
                name = _short(words[1])
            elif (
                len(words) > 1
                and "=" not in " ".join(words[1:])
                and (kind := _FIELD.fullmatch(words[0]))
            ):
                fields.append((words[1], _full(kind[1], name), kind[2] or ""))
        found[name] = tuple(fields)
    return found


def _short(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return f"{name.split('/')[0]}/{name.split('/')[-1]}"


def _full(kind: str, message: str) -> str:
    """A type by its name, that of a message with its package."""
    if kind in _NUMBERS or kind in ("string", "wstring", "time", "duration"):
        return kind
    return _short(kind) if "/" in kind else f"{message.split('/')[0]}/{kind}"


def _require_known(
    definitions: Mapping[str, _Fields], name: str, around: tuple[str, ...], known: set[str]
) -> None:
    """Refuse a message that holds itself, or what is not defined, or a type that is not read."""
    if name in around:
        raise ValueError(f"{name} holds itself")
    if name not in definitions:
        raise ValueError(f"there is no definition of {name}")
    for field_name, kind, array in definitions[name]:
        if len(array) > _LONGEST_SIZE:
            raise ValueError(f"{field_name} is longer than any message")
        if kind in ("wstring", "time", "duration"):
            raise NotImplementedError(f"a field of type {kind}, which is not read")
        if kind not in _NUMBERS and kind != "string" and kind not in known:
            _require_known(definitions, kind, (*around, name), known)
    known.add(name)


def _fields_of(
    definitions: Mapping[str, _Fields], kind: str, array: str
) -> dict[str | int, tuple[str, str]]:
    """Types one step further inwards; of an array the first."""
    if array:
        return {0: (kind, "")}
    return {name: (inner, many) for name, inner, many in definitions.get(kind, ())}


def _require_number(
    path: Path, topic: str, definitions: Mapping[str, _Fields], root: str, wanted: FieldPath
) -> None:
    """Refuse a field that is not in the definition, or is no number there."""
    place: tuple[str, str] | None = (root, "")
    for step in wanted:
        bound = place[1].strip("[]") if place else ""
        if isinstance(step, int) and place and place[1]:
            place = (place[0], "") if not bound.isdecimal() or step < int(bound) else None
        elif place:
            place = _fields_of(definitions, *place).get(step) if not place[1] else None
    if place is None:
        there = ", ".join(repr(name) for name in islice(_names_in(definitions, root, "", ()), 40))
        raise LogError(
            "log_column_missing",
            path,
            f"messages of topic {topic!r} have no field {path_text(wanted)!r}; there are {there}",
            topic,
        )
    if place[0] not in _NUMBERS or place[1]:
        how = f"field {path_text(wanted)!r} is no number but {'an array' if place[1] else place[0]}"
        raise LogError("log_type", path, how, topic)


def _names_in(
    definitions: Mapping[str, _Fields], kind: str, array: str, path: FieldPath
) -> Iterator[str]:
    """Paths of numbers within a type."""
    if kind in _NUMBERS and not array:
        yield path_text(path)
    for step, inner in _fields_of(definitions, kind, array).items() if len(path) < 8 else ():
        yield from _names_in(definitions, *inner, (*path, step))


class _Number(NamedTuple):
    """A wanted number: where it stands in a payload, and NumPy's name of its type."""

    at: int
    kind: str


@dataclass(slots=True)
class _Layout:
    """The layout of a message, from the payload itself."""

    payload: bytes
    definitions: Mapping[str, _Fields]
    wanted: frozenset[FieldPath]
    order: str
    at: int = _HEAD
    fields_left: int = MOST_FIELDS
    numbers: dict[FieldPath, _Number] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=list)  # where lengths of texts and sequences stand

    def message(self, name: str, path: FieldPath) -> None:
        """Go past a message."""
        fields = self.definitions[name]
        # A message of no fields has one byte on the wire.
        self.at += not fields
        for own, kind, array in fields:
            if not array:
                self.one(kind, (*path, own))
            else:
                bound = array.strip("[]")
                count = int(bound) if bound.isdecimal() else self.length()
                self.array(kind, count, (*path, own))

    def one(self, kind: str, path: FieldPath) -> None:
        """Go past one value."""
        self.fields_left -= 1
        if self.fields_left < 0:
            raise _TooManyFieldsError
        if self.at > len(self.payload):
            raise _CutError
        if kind in _NUMBERS:
            self.array(kind, 1, path, is_single=True)
        elif kind == "string":
            length = self.length()  # moves on, too
            self.at += length
        else:
            self.message(kind, path)

    def array(self, kind: str, count: int, path: FieldPath, *, is_single: bool = False) -> None:
        """Go past so many values of one type."""
        if kind not in _NUMBERS:
            for i in range(count):
                self.one(kind, (*path, i))
            return
        size = np.dtype(_NUMBERS[kind]).itemsize
        # Nothing is aligned where there is nothing.
        self.at += (_HEAD - self.at) % size if count else 0
        if is_single and path in self.wanted:
            self.numbers[path] = _Number(self.at, self.order + _NUMBERS[kind])
        elif not is_single:
            for one in self.wanted:
                step = one[-1] if one[:-1] == path else None
                if isinstance(step, int) and step < count:
                    at = self.at + step * size
                    self.numbers[one] = _Number(at, self.order + _NUMBERS[kind])
        self.at += size * count

    def length(self) -> int:
        """The length of a text or sequence that begins here."""
        self.at += -self.at % 4
        self.lengths.append(self.at)
        self.at += 4
        if self.at > len(self.payload):
            raise _CutError
        return int(struct.unpack_from(self.order + "I", self.payload, self.at - 4)[0])


@dataclass(slots=True)
class _Found:
    """Numbers of messages by path, and which messages are done."""

    done: NDArray[np.bool_]
    broken: NDArray[np.bool_]
    raw: dict[FieldPath, NDArray[Any]]
    there: dict[FieldPath, NDArray[np.bool_]]

    def keep(self, path: FieldPath, rows: NDArray[np.intp], numbers: NDArray[Any]) -> None:
        """Keep numbers in their own type: those of a stamp have more digits than a float64."""
        if path not in self.raw:
            self.raw[path] = np.zeros(self.done.size, numbers.dtype.newbyteorder("="))
            self.there[path] = np.zeros(self.done.size, np.bool_)
        self.raw[path][rows] = numbers
        self.there[path][rows] = True

    def _numbers(self, path: FieldPath) -> Numbers:
        none = np.zeros(self.done.size, np.bool_)
        return self.raw.get(path, np.zeros(self.done.size)), self.there.get(path, none)

    def decoded(
        self, wanted: Wanted, others: Decoded | None = None, rest: NDArray[np.intp] | None = None
    ) -> Decoded:
        """All readings, with those of the rest of the messages."""
        fields: dict[FieldPath, Readings] = {}
        for path in wanted.readings:
            numbers, there = self._numbers(path)
            raw, missing = np.where(there, numbers.astype(np.float64), np.nan), ~there
            unparsed, example = self.broken.copy(), _BROKEN if self.broken.any() else None
            if others is not None:
                own = others.fields[path]
                raw[rest], missing[rest], unparsed[rest] = own.raw, own.missing, own.unparsed
                example = example or own.example
            fields[path] = Readings(raw, missing, unparsed, example)
        cells: dict[FieldPath, pa.Array] = {}
        for path in wanted.qualities:
            numbers, there = self._numbers(path)
            texts = numbers.astype(str).astype(object)
            texts[~there] = None
            if others is not None:
                texts[rest] = others.qualities[path].to_pylist()
            cells[path] = pa.array(texts, pa.string())
        return Decoded(fields, self._stamps(wanted, others, rest), cells)

    def _stamps(
        self, wanted: Wanted, others: Decoded | None, rest: NDArray[np.intp] | None
    ) -> WrittenStamps | None:
        if wanted.stamp is None:
            return None
        seconds = [(*wanted.stamp, name) for name in SECONDS if (*wanted.stamp, name) in self.raw]
        nanoseconds = [
            (*wanted.stamp, name) for name in NANOSECONDS if (*wanted.stamp, name) in self.raw
        ]
        if seconds and nanoseconds:
            stamps = stamps_of_pairs(self._numbers(seconds[0]), self._numbers(nanoseconds[0]))
        else:
            # Nothing is before 1990, so that a missing one is not readable.
            stamps = stamps_of_numbers(self._numbers(wanted.stamp)[0], wanted.time_format)
        if others is None or others.stamps is None:
            return stamps
        time_us, kind = stamps.time_us.copy(), stamps.kind.copy()
        time_us[rest], kind[rest] = others.stamps.time_us, others.stamps.kind
        return WrittenStamps(time_us, kind, others.stamps.example)


@dataclass(frozen=True, slots=True)
class _Layouts:
    """Reads messages that have a layout in common."""

    definitions: Mapping[str, _Fields]
    root: str
    wanted: frozenset[FieldPath]

    def read(self, payloads: Payloads) -> _Found:
        """The numbers of all messages whose layout is that of others."""
        none = np.zeros(payloads.length.size, np.bool_)
        found = _Found(none, none.copy(), {}, {})
        for rows, length, text in payloads.by_length():
            left = np.arange(rows.size)
            for _ in range(_MOST_LAYOUTS):
                if not left.size:
                    break
                first = bytes(text[left[0] * (length + 1) + 1 :][:length])
                layout = self._layout_of(first)
                if layout is None:
                    found.broken[rows[left[0]]] = found.done[rows[left[0]]] = True
                    left = left[1:]
                    continue
                same = self._same(layout, text, length)[left]
                own = left[same]
                for path, (at, kind) in layout.numbers.items():
                    numbers = column(text, at + 1, kind.replace("?", "u1"), length + 1)[own]
                    found.keep(path, rows[own], numbers != 0 if kind[1:] == "?" else numbers)
                found.done[rows[own]] = True
                left = left[~same]
        return found

    def _layout_of(self, payload: bytes) -> _Layout | None:
        """The layout of a message; None where it is cut."""
        order = _ORDERS.get(payload[:2])
        if order is None:
            return None
        layout = _Layout(payload, self.definitions, self.wanted, order)
        try:
            layout.message(self.root, ())
        except (_CutError, RecursionError):
            return None
        return layout if layout.at <= len(payload) else None

    @staticmethod
    def _same(layout: _Layout, text: memoryview, length: int) -> NDArray[np.bool_]:
        """True for messages of the layout: their byte order and all lengths in them are its own."""
        size = length + 1
        same = column(text, 1, "V2", size) == np.frombuffer(layout.payload[:2], "V2")
        for at in layout.lengths:
            own = np.frombuffer(layout.payload, "<u4", 1, at)
            same &= column(text, at + 1, "<u4", size) == own
        return np.asarray(same, np.bool_)

"""Messages of ROS 2 in CDR, the encoding of DDS, laid out as a definition in ``ros2msg`` says.

Messages of one length, whose texts and sequences have one length too, have one layout: it is found
in the first of them, and their numbers are then read at once. The format's own package judges the
definition; it reads no ``wstring`` and no types of ROS 1, and takes cut messages for whole ones.
CDR aligns a number to its own size, counted from behind the four bytes that say the byte order (OMG
DDS-XTypes 1.3, 7.4.1, XCDR version 1).
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
from typing import Any

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
    Wanted,
    pair_of,
    stamps_of_pairs,
)
from pipeline.ingest.mcap.layout import Schema, column
from pipeline.ingest.time_stamps import written_as_numbers

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
_UNREAD = ("wstring", "time", "duration")
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(\[(?:<=)?\d*\])?")
_TIME = {"sec": ("uint32", ""), "nanosec": ("uint32", "")}
_BROKEN = "a message that is cut or not in CDR"

MOST_FIELDS = 2**18
"""Fields of a message; definitions of a few lines may have any number, one in another."""

_LONGEST_SIZE = len("[<=1000000000]")
_DEEPEST = 8

_Definitions = Mapping[str, Mapping[str, tuple[str, str]]]
"""Type and array of each field, by message; the array is empty for a single value."""


def ros2_decoder(path: Path, topic: str, schema: Schema, wanted: Wanted) -> Decoder:
    """Decoder of the messages of a topic.

    Raises
    ------
    LogError
        ``log_damaged`` for a definition that is none, ``log_encoding`` for a type that is not read.
        The decoder raises ``log_encoding`` where no message is in plain CDR, and ``log_too_large``
        where messages have no end of fields.
    """
    decode_one = _official_decoder(path, topic, schema)
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

    def decode(payloads: Payloads) -> Decoded:
        _require_plain(path, topic, payloads)
        try:
            return _decoded(*_found_in(payloads, definitions, root, paths), wanted)
        except OverflowError as error:
            how = f"messages of topic {topic!r} have more fields, one in another, than are read"
            raise LogError("log_too_large", path, how, topic) from error

    def tree(payload: bytes) -> Any:
        try:
            return _tree(decode_one(payload)) if payload[:2] in _ORDERS else None
        except (struct.error, ValueError, LookupError, TypeError, RecursionError):
            return None

    return Decoder(decode, tree)


def _official_decoder(path: Path, topic: str, schema: Schema) -> Any:
    """Function of the format's own package of a payload."""
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
            return DecoderFactory().decoder_for("cdr", record)
    # The package raises whatever its parser meets.
    except Exception as error:
        how = f"the definition of {schema.name} cannot be read: {error}"
        raise LogError("log_damaged", path, how) from error


def _tree(node: Any) -> Any:
    """A value as dicts, lists and plain values."""
    names = getattr(type(node), "__slots__", ())
    if names:
        return {name: _tree(getattr(node, name)) for name in names}
    if isinstance(node, list | bytes):
        return [_tree(one) for one in node]
    return int(node) if isinstance(node, bool) else node


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


# Definitions


def _definitions(schema: Schema) -> _Definitions:
    """Fields of a message and of those that it is made of; constants have no layout."""
    # Recorders leave these out where nothing else names them.
    found = {"builtin_interfaces/Time": _TIME, "builtin_interfaces/Duration": _TIME}
    name = _short(schema.name)
    for text in re.split(r"^={3,}\s*$", schema.data.decode(), flags=re.MULTILINE):
        fields = {}
        for line in text.splitlines():
            words = line.partition("#")[0].split()
            if words[:1] == ["MSG:"] and len(words) > 1:
                name = _short(words[1])
            elif len(words) > 1 and "=" not in " ".join(words[1:]):
                kind = _FIELD.fullmatch(words[0])
                if kind:
                    fields[words[1]] = (_full(kind[1], name), kind[2] or "")
        found[name] = fields
    return found


def _short(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return f"{name.split('/')[0]}/{name.split('/')[-1]}"


def _full(kind: str, message: str) -> str:
    """A type by its name, that of a message with its package."""
    if kind in _NUMBERS or kind == "string" or kind in _UNREAD:
        return kind
    return _short(kind) if "/" in kind else f"{message.split('/')[0]}/{kind}"


def _require_known(
    definitions: _Definitions, name: str, around: tuple[str, ...], known: set[str]
) -> None:
    """Refuse a message that holds itself, or what is not defined, or a type that is not read."""
    if name in around:
        raise ValueError(f"{name} holds itself")
    if name not in definitions:
        raise ValueError(f"there is no definition of {name}")
    for field_name, (kind, array) in definitions[name].items():
        if len(array) > _LONGEST_SIZE:
            raise ValueError(f"{field_name} is longer than any message")
        if kind in _UNREAD:
            raise NotImplementedError(f"a field of type {kind}, which is not read")
        if kind not in _NUMBERS and kind != "string" and kind not in known:
            _require_known(definitions, kind, (*around, name), known)
    known.add(name)


def _require_number(
    path: Path, topic: str, definitions: _Definitions, root: str, wanted: FieldPath
) -> None:
    """Refuse a field that is not in the definition, or is no number there."""
    place: tuple[str, str] | None = (root, "")
    for step in wanted:
        kind, array = place or ("", "")
        if isinstance(step, str):
            place = definitions.get(kind, {}).get(step) if not array else None
        else:
            bound = array.strip("[]")
            place = (kind, "") if array and not (bound.isdecimal() and step >= int(bound)) else None
    if place is None:
        names = islice(_numbers_in(definitions, root, ()), 40)
        there = ", ".join(repr(path_text(one)) for one in names)
        how = f"messages of topic {topic!r} have no field {path_text(wanted)!r}; there are {there}"
        raise LogError("log_column_missing", path, how, topic)
    if place[0] not in _NUMBERS or place[1]:
        how = f"field {path_text(wanted)!r} is no number but {'an array' if place[1] else place[0]}"
        raise LogError("log_type", path, how, topic)


def _numbers_in(definitions: _Definitions, kind: str, above: FieldPath) -> Iterator[FieldPath]:
    """Paths of numbers within a message; of arrays the first."""
    for name, (inner, array) in definitions[kind].items() if len(above) < _DEEPEST else ():
        path = (*above, name, 0) if array else (*above, name)
        if inner in _NUMBERS:
            yield path
        elif inner in definitions:
            yield from _numbers_in(definitions, inner, path)


# Messages


@dataclass(slots=True)
class _Layout:
    """The layout of a message, from the payload itself."""

    payload: bytes
    definitions: _Definitions
    wanted: frozenset[FieldPath]
    order: str
    at: int = _HEAD
    fields_left: int = MOST_FIELDS
    numbers: dict[FieldPath, tuple[int, str]] = field(default_factory=dict)  # place, NumPy's type
    lengths: list[int] = field(default_factory=list)  # where lengths of texts and sequences stand

    def pass_by(self, kind: str, array: str, path: FieldPath) -> None:
        """Go past a value, or an array of values."""
        bound = array.strip("[]")
        count = 1 if not array else int(bound) if bound.isdecimal() else self._length()
        if kind in _NUMBERS:
            self._count_one()
            self._pass_numbers(_NUMBERS[kind], count, path, is_array=bool(array))
            return
        for i in range(count):
            self._count_one()
            if kind == "string":
                length = self._length()  # moves on, too
                self.at += length
                continue
            fields = self.definitions[kind]
            # A message of no fields has one byte on the wire.
            self.at += not fields
            within = (*path, i) if array else path
            for name, (inner, many) in fields.items():
                self.pass_by(inner, many, (*within, name))

    def _pass_numbers(self, kind: str, count: int, path: FieldPath, *, is_array: bool) -> None:
        size = np.dtype(kind).itemsize
        # Nothing is aligned where there is nothing.
        self.at += (_HEAD - self.at) % size if count else 0
        if not is_array and path in self.wanted:
            self.numbers[path] = self.at, self.order + kind
        for one in self.wanted if is_array else ():
            step = one[-1] if one[:-1] == path else None
            if isinstance(step, int) and step < count:
                self.numbers[one] = self.at + step * size, self.order + kind
        self.at += size * count

    def _count_one(self) -> None:
        self.fields_left -= 1
        if self.fields_left < 0:
            raise OverflowError
        if self.at > len(self.payload):
            raise EOFError

    def _length(self) -> int:
        """The length of a text or sequence that begins here."""
        self.at += -self.at % 4
        self.lengths.append(self.at)
        self.at += 4
        if self.at > len(self.payload):
            raise EOFError
        return int(struct.unpack_from(self.order + "I", self.payload, self.at - 4)[0])

    def is_of(self, text: memoryview, size: int) -> NDArray[np.bool_]:
        """True for messages of the layout: their byte order and all lengths in them are its own.

        The text has a byte before each payload; both together have a size.
        """
        same = column(text, 1, "V2", size) == np.frombuffer(self.payload[:2], "V2")
        for at in self.lengths:
            same &= column(text, at + 1, "<u4", size) == np.frombuffer(self.payload, "<u4", 1, at)
        return np.asarray(same, np.bool_)


def _layout_of(
    payload: bytes, definitions: _Definitions, root: str, wanted: frozenset[FieldPath]
) -> _Layout | None:
    """The layout of a message, None where it is cut; OverflowError: it has no end of fields."""
    if payload[:2] not in _ORDERS:
        return None
    layout = _Layout(payload, definitions, wanted, _ORDERS[payload[:2]])
    try:
        layout.pass_by(root, "", ())
    except EOFError:
        return None
    return layout if layout.at <= len(payload) else None


def _found_in(
    payloads: Payloads, definitions: _Definitions, root: str, wanted: frozenset[FieldPath]
) -> tuple[dict[FieldPath, Numbers], NDArray[np.bool_]]:
    """The wanted numbers that messages have, and which are broken; one layout is read at once.

    Numbers keep their own type: those of a stamp have more digits than a float64.
    """
    found: dict[FieldPath, Numbers] = {}
    broken = np.zeros(payloads.length.size, np.bool_)
    for rows, length, text in payloads.by_length():
        size, left = length + 1, np.arange(rows.size)
        while left.size:
            first = bytes(text[left[0] * size + 1 :][:length])
            layout = _layout_of(first, definitions, root, wanted)
            if layout is None:
                broken[rows[left[0]]] = True
                left = left[1:]
                continue
            same = layout.is_of(text, size)[left]
            own = left[same]
            for path, (at, kind) in layout.numbers.items():
                numbers = column(text, at + 1, kind.replace("?", "u1"), size)[own]
                numbers = numbers != 0 if kind[1:] == "?" else numbers
                if path not in found:
                    empty = np.zeros(broken.size, numbers.dtype.newbyteorder("="))
                    found[path] = empty, np.zeros(broken.size, np.bool_)
                for array, values in zip(found[path], (numbers, True), strict=True):
                    array[rows[own]] = values
            left = left[~same]
    return found, broken


def _decoded(
    found: Mapping[FieldPath, Numbers], broken: NDArray[np.bool_], wanted: Wanted
) -> Decoded:
    """All readings, stamps and qualities."""
    none: Numbers = (np.zeros(broken.size), np.zeros(broken.size, np.bool_))
    example = _BROKEN if broken.any() else None
    fields: dict[FieldPath, Readings] = {}
    for path in wanted.readings:
        numbers, there = found.get(path, none)
        raw = np.where(there, numbers.astype(np.float64), np.nan)
        fields[path] = Readings(raw, ~there, broken, example)
    cells: dict[FieldPath, pa.Array] = {}
    for path in wanted.qualities:
        numbers, there = found.get(path, none)
        cells[path] = pa.array(numbers, mask=~there)
    if wanted.stamp is None:
        return Decoded(fields, None, cells)
    pair = pair_of([str(one[-1]) for one in found if one[:-1] == wanted.stamp])
    if pair is not None:
        stamps = stamps_of_pairs(*(found[(*wanted.stamp, name)] for name in pair))
    else:
        # Nothing is before 1990, so that a missing one is not readable.
        stamps = written_as_numbers(found.get(wanted.stamp, none)[0], wanted.time_format)
    return Decoded(fields, stamps, cells)

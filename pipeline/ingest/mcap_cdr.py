"""Messages of ROS 2 in CDR, the encoding of DDS: all messages are walked at once.

The walk goes through the definition field by field, with a position for every message. As long as
no text or sequence has been met, all messages have one layout, and a field is one strided read; a
text or sequence moves each position by its own length. CDR aligns a number to its own size, counted
from behind the four bytes that say the byte order. The layout is that of the Object Management
Group's DDS-XTypes 1.3, 7.4.1 (XCDR version 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap_layout import Schema
from pipeline.ingest.mcap_messages import fields_at
from pipeline.ingest.mcap_paths import FieldPath
from pipeline.ingest.mcap_payloads import (
    Decoded,
    Decoder,
    Payloads,
    stamps_of_numbers,
    stamps_of_seconds,
)
from pipeline.ingest.mcap_ros2msg import (
    NUMBERS,
    Definitions,
    Field,
    kind_of_field,
    ros2_definitions,
    stamp_parts,
)
from pipeline.ingest.time_stamps import WrittenStamps

_HEAD = 4
_LARGEST_NUMBER = 8
_Wanted = Mapping[str | int, Any]
"""Wanted fields as a tree; a leaf is the path that leads to it."""


@dataclass(slots=True)
class _Found:
    """Numbers found so far, by path, in their own type, and in which messages they were."""

    values: dict[FieldPath, NDArray[Any]]
    there: dict[FieldPath, NDArray[np.bool_]]


@dataclass(slots=True)
class _Walk:
    """Where some messages of one byte order have been read to.

    A message's position is its anchor plus the offset that all have in common; anchors are
    multiples of `alignment` away from the base.
    """

    text: NDArray[np.uint8]
    order: str
    row: NDArray[np.intp]
    base: NDArray[np.int64]
    end: NDArray[np.int64]
    sound: NDArray[np.bool_]
    anchor: NDArray[np.int64]
    offset: int = 0
    alignment: int = _LARGEST_NUMBER

    def align(self, size: int) -> None:
        """Go on to where a number of this size can stand."""
        if size <= self.alignment:
            self.offset += -self.offset % size
            return
        self.anchor = self.anchor + self.offset
        self.anchor += (self.base - self.anchor) % size
        self.offset, self.alignment = 0, size

    def move(self, position: NDArray[np.int64]) -> None:
        """Go on to positions of each message's own."""
        self.anchor, self.offset, self.alignment = position, 0, 1

    def numbers(self, kind: str, ahead: int = 0) -> NDArray[Any]:
        """Numbers where the walk stands or a little ahead; of no meaning beyond a message's end."""
        last = self.text.size - _LARGEST_NUMBER
        at = np.minimum(self.anchor + (self.offset + ahead), last)
        return fields_at(self.text.data, at, self.order + kind)

    def count(self) -> NDArray[np.int64]:
        """Length of the text or sequence that begins here; 0 where it is cut."""
        self.align(4)
        counts = self.numbers("u4").astype(np.int64)
        self.offset += 4
        self.sound &= self.anchor + self.offset <= self.end
        return np.where(self.sound, counts, 0)

    def require(self, length: NDArray[np.int64] | int) -> None:
        """Messages without so many more bytes are not sound."""
        self.sound &= self.anchor + self.offset + length <= self.end


def cdr_decoder(
    path: Path,
    topic: str,
    schema: Schema,
    fields: Sequence[FieldPath],
    stamp: FieldPath | None,
    time_format: str,
) -> Decoder:
    """Decoder of the messages of a schema.

    Parameters
    ----------
    path, topic
        For messages of errors.
    schema
        Its record.
    fields
        What is wanted of each message.
    stamp
        Where its time stamp is: a number, or a message of seconds and nanoseconds.
    time_format
        How a stamp is written that is one number.

    Raises
    ------
    LogError
        ``log_damaged``, ``log_encoding``; ``log_column_missing`` or ``log_type`` where a path leads
        nowhere, or to something else than a number.
    """
    definitions = ros2_definitions(path, schema)
    stamps = [] if stamp is None else stamp_parts(definitions, stamp)
    kinds = {one: kind_of_field(path, topic, definitions, one) for one in (*fields, *stamps)}
    wanted = _tree(kinds)

    def decode(payloads: Payloads) -> Decoded:
        found, sound = _walked(payloads, definitions, wanted, kinds)
        readings = {one: _readings(found, one, sound) for one in fields}
        return Decoded(readings, _stamps(found, stamps, sound, time_format) if stamps else None)

    return decode


def _walked(
    payloads: Payloads, definitions: Definitions, wanted: _Wanted, kinds: Mapping[FieldPath, str]
) -> tuple[_Found, NDArray[np.bool_]]:
    """What is wanted of each message, and which messages are sound to their end."""
    count = payloads.start.size
    found = _Found(
        {path: np.zeros(count, kind) for path, kind in kinds.items()},
        {path: np.zeros(count, np.bool_) for path in kinds},
    )
    sound = np.zeros(count, np.bool_)
    text = np.pad(payloads.text, (0, _LARGEST_NUMBER))
    head = payloads.start
    long_enough = (payloads.length >= _HEAD) & (text[head] == 0)
    for order, mark in (("<", 1), (">", 0)):
        row = np.flatnonzero(long_enough & (text[head + 1] == mark))
        if not row.size:
            continue
        base = head[row] + _HEAD
        end = (head + payloads.length)[row]
        walk = _Walk(text, order, row, base, end, np.ones(row.size, np.bool_), base)
        _read_message(walk, definitions, definitions.root, wanted, found)
        walk.require(0)
        sound[row] = walk.sound
    return found, sound


def _read_message(
    walk: _Walk, definitions: Definitions, name: str, wanted: _Wanted, found: _Found
) -> None:
    fields = definitions.fields[name]
    if not fields:
        walk.offset += 1
    for field in fields:
        inside = wanted.get(field.name, {})
        if field.count is None:
            _read_one(walk, definitions, field.type, inside, found)
        elif field.count and field.type in NUMBERS | {"bool": "u1"}:
            _read_numbers(walk, field, inside, found)
        elif field.count:
            _read_array(walk, definitions, field, inside, found)
        elif field.type in NUMBERS | {"bool": "u1"}:
            _read_sequence_of_numbers(walk, field, inside, found)
        else:
            _read_sequence(walk, definitions, field, inside, found)


def _read_one(walk: _Walk, definitions: Definitions, kind: str, inside: Any, found: _Found) -> None:
    """A number, a text or a message."""
    if kind == "string":
        counts = walk.count()
        walk.require(counts)
        walk.move(walk.anchor + walk.offset + np.where(walk.sound, counts, 0))
    elif kind in definitions.fields:
        _read_message(walk, definitions, kind, inside, found)
    else:
        size = definitions.smallest[kind]
        walk.align(size)
        if inside:
            _keep(walk, kind, inside, found)
        walk.offset += size


def _keep(
    walk: _Walk,
    kind: str,
    path: FieldPath,
    found: _Found,
    ahead: int = 0,
    where: NDArray[np.bool_] | None = None,
) -> None:
    values = walk.numbers(NUMBERS[kind], ahead)
    row = walk.row if where is None else walk.row[where]
    found.values[path][row] = values if where is None else values[where]
    found.there[path][row] = True


def _read_numbers(walk: _Walk, field: Field, inside: _Wanted, found: _Found) -> None:
    """An array of numbers."""
    size = int((NUMBERS | {"bool": "u1"})[field.type][1])
    walk.align(size)
    for position, path in inside.items():
        _keep(walk, field.type, path, found, int(position) * size)
    walk.offset += size * (field.count or 0)


def _read_sequence_of_numbers(walk: _Walk, field: Field, inside: _Wanted, found: _Found) -> None:
    size = int((NUMBERS | {"bool": "u1"})[field.type][1])
    counts = walk.count()
    start = walk.anchor + walk.offset
    # Nothing is aligned where there is nothing.
    start = start + np.where(counts > 0, (walk.base - start) % size, 0)
    walk.move(start)
    walk.require(counts * size)
    counts = np.where(walk.sound, counts, 0)
    for position, path in inside.items():
        _keep(walk, field.type, path, found, int(position) * size, counts > int(position))
    walk.move(start + counts * size)


def _read_array(
    walk: _Walk, definitions: Definitions, field: Field, inside: _Wanted, found: _Found
) -> None:
    """An array of texts or messages."""
    count = field.count or 0
    walk.require(count * definitions.smallest[field.type])
    # Where no message is long enough, there may be more elements to walk than there are bytes.
    for position in range(count if walk.sound.any() else 0):
        _read_one(walk, definitions, field.type, inside.get(position, {}), found)


def _read_sequence(
    walk: _Walk, definitions: Definitions, field: Field, inside: _Wanted, found: _Found
) -> None:
    """A sequence of texts or messages, as long as each message has it."""
    counts = walk.count()
    walk.require(counts * definitions.smallest[field.type])
    counts = np.where(walk.sound, counts, 0)
    position = walk.anchor + walk.offset
    for index in range(int(counts.max(initial=0))):
        longer = np.flatnonzero((counts > index) & walk.sound)
        part = _Walk(
            walk.text,
            walk.order,
            walk.row[longer],
            walk.base[longer],
            walk.end[longer],
            walk.sound[longer],
            position[longer],
            alignment=1,
        )
        _read_one(part, definitions, field.type, inside.get(index, {}), found)
        part.require(0)
        position[longer] = part.anchor + part.offset
        walk.sound[longer] = part.sound
    walk.move(position)


def _tree(paths: Mapping[FieldPath, str]) -> _Wanted:
    tree: dict[str | int, Any] = {}
    for path in paths:
        node = tree
        for step in path[:-1]:
            node = node.setdefault(step, {})
        node[path[-1]] = path
    return tree


def _readings(found: _Found, path: FieldPath, sound: NDArray[np.bool_]) -> Readings:
    there = found.there[path] & sound
    raw = np.where(there, found.values[path].astype(np.float64), np.nan)
    example = None if sound.all() else "a message that is cut or not in CDR"
    return Readings(raw, ~there, ~sound, example)


def _stamps(
    found: _Found, parts: Sequence[FieldPath], sound: NDArray[np.bool_], time_format: str
) -> WrittenStamps:
    there = found.there[parts[0]] & sound
    if len(parts) == 2:
        return stamps_of_seconds(found.values[parts[0]], found.values[parts[1]], there)
    # Nothing is before 1990, so that a missing one is not readable.
    return stamps_of_numbers(np.where(there, found.values[parts[0]], 0), time_format)

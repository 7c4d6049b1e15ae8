"""The walk through many messages in CDR at once, field by field as a definition has them.

There is a position for every message. As long as no text or sequence has been met, all messages
have one layout, and a field is one strided read; a text or sequence moves each position by its own
length. CDR aligns a number to its own size, counted from behind the four bytes that say the byte
order. The layout is that of the Object Management Group's DDS-XTypes 1.3, 7.4.1 (XCDR version 1).

Characters of a ``wstring`` take four bytes where Fast CDR 1 or rmw_cyclonedds wrote them and two
where Fast CDR 2 did, and no header says which: of the two, that is taken with which the messages
end where they end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config.field_paths import FieldPath
from pipeline.ingest.mcap.layout import fields_at
from pipeline.ingest.mcap.payloads import Payloads
from pipeline.ingest.mcap.ros2_types import Array, Definitions, Message, Number, Text, Type

HEAD = 4
"""Bytes that say which representation a message is in."""

ORDERS = {0: ">", 1: "<"}
"""Byte order by representation identifier, for plain CDR."""

_LARGEST_NUMBER = 8
_MOST_PADDING = 3

MOST_STEPS = 2**18
"""Fields that a walk goes past; definitions of a few lines may have any number, one in another."""

_Wanted = Mapping[str | int, Any]
"""Wanted fields as a tree; a leaf is the path that leads to it."""


class TooManySteps(Exception):  # noqa: N818 - it says what there is
    """Messages have more fields to go past than any log."""


@dataclass(slots=True)
class Found:
    """Numbers found in messages, by path."""

    values: dict[FieldPath, NDArray[Any]]  # in their own type
    there: dict[FieldPath, NDArray[np.bool_]]  # messages that have them
    sound: NDArray[np.bool_]  # messages that have all that they say they have
    steps_left: int = MOST_STEPS  # fields that may still be gone past

    def step(self) -> None:
        """Count a field that is gone past."""
        self.steps_left -= 1
        if self.steps_left < 0:
            raise TooManySteps


@dataclass(slots=True)
class _Walk:
    """Places up to which some messages of one byte order have been read.

    A message's position is its anchor plus the offset that all have in common; anchors are
    multiples of `alignment` away from the base.
    """

    text: NDArray[np.uint8]
    order: str
    wide_bytes: int
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
        # Any byte but 0 is true.
        return fields_at(self.text.data, at, self.order + kind.replace("?", "u1"))

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

    def only(self, chosen: NDArray[np.intp], position: NDArray[np.int64]) -> _Walk:
        """The walk of some messages, from positions of their own."""
        return _Walk(
            self.text,
            self.order,
            self.wide_bytes,
            self.row[chosen],
            self.base[chosen],
            self.end[chosen],
            self.sound[chosen],
            position[chosen],
            alignment=1,
        )


def walked(
    payloads: Payloads,
    identifier: NDArray[np.int64],
    definitions: Definitions,
    kinds: Mapping[FieldPath, str],
) -> Found:
    """Wanted numbers of messages, of NumPy's types by path.

    Messages whose representation identifiers are not in `ORDERS` are not sound.

    Raises
    ------
    TooManySteps
    """
    wanted = _tree(kinds)
    if not definitions.has_wide_text:
        return _walk_through(payloads, identifier, definitions, wanted, kinds, 0)
    of_four, of_two = (
        _walk_through(payloads, identifier, definitions, wanted, kinds, size) for size in (4, 2)
    )
    return of_four if of_four.sound.sum() >= of_two.sound.sum() else of_two


def _walk_through(
    payloads: Payloads,
    identifier: NDArray[np.int64],
    definitions: Definitions,
    wanted: _Wanted,
    kinds: Mapping[FieldPath, str],
    wide_bytes: int,
) -> Found:
    count = payloads.start.size
    found = Found(
        {path: np.zeros(count, kind) for path, kind in kinds.items()},
        {path: np.zeros(count, np.bool_) for path in kinds},
        np.zeros(count, np.bool_),
    )
    text = np.pad(payloads.text, (0, _LARGEST_NUMBER))
    for mark, order in ORDERS.items():
        row = np.flatnonzero(identifier == mark)
        if not row.size:
            continue
        base = payloads.start[row] + HEAD
        end = (payloads.start + payloads.length)[row]
        sound = np.ones(row.size, np.bool_)
        walk = _Walk(text, order, wide_bytes, row, base, end, sound, base)
        _read(walk, definitions, Message(definitions.root), wanted, found)
        walk.require(0)
        if wide_bytes:
            walk.sound &= walk.end - (walk.anchor + walk.offset) <= _MOST_PADDING
        found.sound[row] = walk.sound
    return found


def _read(walk: _Walk, definitions: Definitions, kind: Type, inside: Any, found: Found) -> None:
    """Go past what is of a type, and keep what is wanted of it."""
    found.step()
    match kind:
        case Number():
            walk.align(kind.size)
            if inside:
                _keep(walk, kind, inside, found)
            walk.offset += kind.size
        case Text():
            counts = walk.count() * (walk.wide_bytes if kind.is_wide else 1)
            walk.require(counts)
            walk.move(walk.anchor + walk.offset + np.where(walk.sound, counts, 0))
        case Message():
            fields = definitions.fields[kind.name]
            # A message of no fields has one byte on the wire.
            walk.offset += not fields
            for name, inner in fields.items():
                _read(walk, definitions, inner, inside.get(name, {}), found)
        case Array(Number() as element, None):
            _read_sequence_of_numbers(walk, element, inside, found)
        case Array(Number() as element, int(count)):
            _read_numbers(walk, element, count, inside, found)
        case Array(element, None):
            _read_sequence(walk, definitions, element, inside, found)
        case Array(element, int(count)):
            _read_array(walk, definitions, element, count, inside, found)


def _keep(
    walk: _Walk,
    kind: Number,
    path: FieldPath,
    found: Found,
    ahead: int = 0,
    where: NDArray[np.bool_] | None = None,
) -> None:
    values = walk.numbers(kind.kind, ahead)
    row = walk.row if where is None else walk.row[where]
    found.values[path][row] = values if where is None else values[where]
    found.there[path][row] = True


def _read_numbers(walk: _Walk, element: Number, count: int, inside: _Wanted, found: Found) -> None:
    """An array of numbers."""
    walk.align(element.size)
    for position, path in inside.items():
        _keep(walk, element, path, found, int(position) * element.size)
    walk.offset += element.size * count


def _read_array(
    walk: _Walk, definitions: Definitions, element: Type, count: int, inside: _Wanted, found: Found
) -> None:
    """An array of texts, messages or arrays."""
    walk.require(count * definitions.smallest(element))
    # Where no message is long enough, there may be more elements to walk than there are bytes.
    for position in range(count if walk.sound.any() else 0):
        _read(walk, definitions, element, inside.get(position, {}), found)


def _read_sequence_of_numbers(walk: _Walk, element: Number, inside: _Wanted, found: Found) -> None:
    counts = walk.count()
    start = walk.anchor + walk.offset
    # Nothing is aligned where there is nothing.
    start = start + np.where(counts > 0, (walk.base - start) % element.size, 0)
    walk.move(start)
    walk.require(counts * element.size)
    counts = np.where(walk.sound, counts, 0)
    for position, path in inside.items():
        ahead = int(position) * element.size
        _keep(walk, element, path, found, ahead, counts > int(position))
    walk.move(start + counts * element.size)


def _read_sequence(
    walk: _Walk, definitions: Definitions, element: Type, inside: _Wanted, found: Found
) -> None:
    """A sequence of texts, messages or arrays, as long as each message has it."""
    counts = walk.count()
    walk.require(counts * definitions.smallest(element))
    counts = np.where(walk.sound, counts, 0)
    position = walk.anchor + walk.offset
    for index in range(int(counts.max(initial=0))):
        longer = np.flatnonzero((counts > index) & walk.sound)
        part = walk.only(longer, position)
        _read(part, definitions, element, inside.get(index, {}), found)
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

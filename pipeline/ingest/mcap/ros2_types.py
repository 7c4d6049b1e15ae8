"""Types of ROS 2 messages, whatever the language in which they are defined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.ingest.mcap.layout import LONGEST_RECORD

NUMBERS = {
    "bool": "?",
    "byte": "u1",
    # Unsigned in ROS 2; signed in the format's own reader, whose figures we keep.
    "char": "i1",
    "float32": "f4",
    "float64": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
}
"""NumPy's names of the number types, without a byte order."""

_ELEMENTS_SHOWN = 4


@dataclass(frozen=True, slots=True)
class Number:
    """A number, of NumPy's type `kind`; "?" is a truth value in a byte."""

    kind: str

    @property
    def size(self) -> int:
        """Bytes, which are its alignment too."""
        return np.dtype(self.kind).itemsize


@dataclass(frozen=True, slots=True)
class Text:
    """A text of characters of one byte, or wide ones of two or four."""

    is_wide: bool = False


@dataclass(frozen=True, slots=True)
class Message:
    """A message by its name."""

    name: str


@dataclass(frozen=True, slots=True)
class Array:
    """Elements of one type, `count` of them, or in a sequence of any length (None)."""

    element: Type
    count: int | None = None


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A type that is not read."""

    what: str


TEXTS = {"string": Text(), "wstring": Text(is_wide=True)}

Type = Number | Text | Message | Array | Unreadable

Fields = Mapping[str, Type]


@dataclass(frozen=True, slots=True)
class Definitions:
    """A message and those it is made of, by name."""

    root: str  # name of the message
    fields: Mapping[str, Fields]
    sizes: Mapping[str, int]  # fewest bytes, without padding
    has_wide_text: bool

    def smallest(self, kind: Type) -> int:
        """Fewest bytes that a type can take, without padding."""
        return _smallest(kind, self.sizes)


def definitions_of(root: str, fields: Mapping[str, Fields]) -> Definitions:
    """A message and those it is made of, each of which has to be there, and none within itself.

    Raises
    ------
    ValueError
        A definition is missing or holds itself.
    NotImplementedError
        Something is not read; it says what.
    """
    sizes: dict[str, int] = {}
    texts: set[Text] = set()
    _measure(Message(root), fields, sizes, texts, ())
    return Definitions(root, {name: fields[name] for name in sizes}, sizes, Text(True) in texts)


def _measure(
    kind: Type,
    fields: Mapping[str, Fields],
    sizes: dict[str, int],
    texts: set[Text],
    around: tuple[str, ...],
) -> None:
    if isinstance(kind, Unreadable):
        raise NotImplementedError(kind.what)
    if isinstance(kind, Text):
        texts.add(kind)
    elif isinstance(kind, Array):
        _measure(kind.element, fields, sizes, texts, around)
    elif isinstance(kind, Message) and kind.name not in sizes:
        if kind.name in around:
            raise ValueError(f"{kind.name} holds itself")
        if kind.name not in fields:
            raise ValueError(f"there is no definition of {kind.name}")
        inside = fields[kind.name].values()
        for inner in inside:
            _measure(inner, fields, sizes, texts, (*around, kind.name))
        # A message of no fields has one byte on the wire.
        sizes[kind.name] = max(sum(_smallest(inner, sizes) for inner in inside), 1)
        if sizes[kind.name] > LONGEST_RECORD:
            raise ValueError(f"{kind.name} is longer than any record of a file that is read")


def _smallest(kind: Type, sizes: Mapping[str, int]) -> int:
    if isinstance(kind, Number):
        return kind.size
    if isinstance(kind, Message):
        return sizes[kind.name]
    if isinstance(kind, Array) and kind.count is not None:
        return kind.count * _smallest(kind.element, sizes)
    return 4


@dataclass(frozen=True, slots=True)
class Ros2Place:
    """A place in a message, as `pipeline.ingest.mcap.fields` asks for it."""

    definitions: Definitions
    type: Type

    @property
    def number(self) -> str | None:
        """NumPy's name of the type of the number that is here."""
        return self.type.kind if isinstance(self.type, Number) else None

    @property
    def what(self) -> str:
        """The thing that is here, in words."""
        match self.type:
            case Array():
                return "an array"
            case Message(name):
                return f"a message {name}"
            case Text():
                return "a text"
            case _:
                return "a number"

    def steps(self) -> list[str | int]:
        """The steps inwards."""
        if isinstance(self.type, Array):
            # Of a sequence of any length the first element stands for all.
            return list(range(min(self.type.count or 1, _ELEMENTS_SHOWN)))
        return list(self._fields)

    def inside(self, step: str | int) -> Ros2Place | None:
        """The place one step further inwards."""
        if isinstance(step, str):
            inner = self._fields.get(step)
        elif isinstance(self.type, Array) and step < (self.type.count or step + 1):
            inner = self.type.element
        else:
            inner = None
        return None if inner is None else Ros2Place(self.definitions, inner)

    @property
    def _fields(self) -> Fields:
        return self.definitions.fields[self.type.name] if isinstance(self.type, Message) else {}

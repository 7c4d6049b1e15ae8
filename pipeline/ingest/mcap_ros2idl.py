"""Message definitions of ROS 2 in the interface definition language ("ros2idl").

Each definition stands behind a line of equal signs and a line ``IDL: package/msg/Name``. The
language is the Object Management Group's IDL 4.2, of which ROS 2 uses the part that
https://design.ros2.org/articles/idl_interface_definition.html names. What is outside of that part,
such as a union, is refused by name, but only where the message holds it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from pipeline.ingest.mcap_layout import Schema
from pipeline.ingest.mcap_ros2_types import (
    Array,
    Definitions,
    Message,
    Number,
    Text,
    Type,
    Unreadable,
    definitions_of,
)

_HEADING = re.compile(r"^(?:={3,}|IDL:.*)[ \t\r]*$", re.MULTILINE)
_SERVICE = re.compile(r"^SRV:", re.MULTILINE)
_NAME = r"[A-Za-z_]\w*"
# What is opened and never closed goes to the end, so that no place of a text is looked at twice.
_TOKEN = re.compile(
    rf"""(?P<nothing>\s+ | //[^\n]* | /\*.*?(?:\*/|\Z) | \#[^\n]*)
    | L?"(?:\\.|[^"\\])*(?:"|\Z) | L?'(?:\\.|[^'\\])+(?:'|\Z)
    | (?:::)?{_NAME}(?:::{_NAME})*
    | 0[xX][0-9a-fA-F]+ | (?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[dD]?
    | [^\s\w]""",
    re.VERBOSE | re.DOTALL,
)
_BRACKETS = {"{": "}", "(": ")"}

_NUMBERS = {
    "boolean": "?",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "unsigned short": "u2",
    "uint16": "u2",
    "long": "i4",
    "int32": "i4",
    "unsigned long": "u4",
    "uint32": "u4",
    "long long": "i8",
    "int64": "i8",
    "unsigned long long": "u8",
    "uint64": "u8",
    "float": "f4",
    "double": "f8",
}
_OF_SEVERAL_WORDS = {
    "unsigned": ("short", "long"),
    "unsigned long": ("long",),
    "long": ("long", "double"),
}
_TEXTS = {"string": Text(), "wstring": Text(is_wide=True)}
# Wide characters are of two or of four bytes, as the writer has it, and nothing tells which.
_NOT_IN_ROS_2 = ("long double", "wchar", "fixed", "map", "any")
_NOT_STRUCTS = ("union", "bitmask", "bitset", "interface", "exception", "native", "valuetype")


@dataclass(frozen=True, slots=True)
class _Reference:
    """A name, to be looked up from a scope outwards once all are declared."""

    scope: tuple[str, ...]
    name: str


@dataclass(frozen=True, slots=True)
class _List:
    """An array, or a sequence (None)."""

    element: _Declared
    count: int | _Reference | None


_Declared = Number | Text | Unreadable | _Reference | _List


@dataclass(frozen=True, slots=True)
class _Declarations:
    """What a text declares, by full name such as ``package::msg::Name``."""

    structs: dict[str, dict[str, _Declared]] = field(default_factory=dict)
    types: dict[str, _Declared] = field(default_factory=dict)
    constants: dict[str, int] = field(default_factory=dict)


def ros2idl_definitions(schema: Schema) -> Definitions:
    """Definitions out of a schema record.

    Raises
    ------
    ValueError
        The definition contradicts itself.
    NotImplementedError
        It has a type that is not read.
    """
    text = schema.data.decode()
    if _SERVICE.search(text):
        raise NotImplementedError("the definition of a service beside IDL, which is not read")
    parser = _Parser(_HEADING.sub("", text))
    parser.definitions(())
    found = parser.found
    messages = {
        name: {one: _resolved(kind, found, ()) for one, kind in fields.items()}
        for name, fields in found.structs.items()
    }
    package, *_, name = schema.name.split("/")
    return definitions_of(f"{package}::msg::{name}", messages)


def _resolved(kind: _Declared, found: _Declarations, around: tuple[str, ...]) -> Type:
    """A type without names of types other than messages."""
    if isinstance(kind, _Reference):
        name = _looked_up(kind, found.structs, found.types)
        if name in around:
            raise ValueError(f"{name} is declared as itself")
        if name in found.types:
            return _resolved(found.types[name], found, (*around, name))
        return Message(name)
    if isinstance(kind, _List):
        element = _resolved(kind.element, found, around)
        count = kind.count
        if isinstance(count, _Reference):
            count = found.constants.get(_looked_up(count, found.constants), 0)
        if count == 0:
            raise ValueError("an array has no size")
        return Array(element, count)
    return kind


def _looked_up(reference: _Reference, *declared: Mapping[str, object]) -> str:
    """Full name of what a name stands for; the name itself where nothing is declared so."""
    bare = reference.name.removeprefix("::")
    outermost = 0 if bare != reference.name else len(reference.scope)
    for depth in range(outermost, -1, -1):
        name = "::".join((*reference.scope[:depth], bare))
        if any(name in names for names in declared):
            return name
    return bare


def _tokens(text: str) -> Iterator[str]:
    for match in _TOKEN.finditer(text):
        if match["nothing"] is None:
            yield match[0]


class _Parser:
    """Reads definitions one after the other into `found`."""

    def __init__(self, text: str) -> None:
        self.found = _Declarations()
        self._tokens = [*_tokens(text), ""]
        self._at = 0

    @property
    def _next(self) -> str:
        return self._tokens[self._at]

    def _take(self, *wanted: str) -> str:
        token = self._next
        if not token or (wanted and token not in wanted):
            expected = f" where {' or '.join(wanted)} has to be" if wanted else ""
            raise ValueError(f"there is {token or 'the end'!r}{expected}")
        self._at += 1
        return token

    def _name(self) -> str:
        name = self._take()
        if not re.fullmatch(_NAME, name):
            raise ValueError(f"{name!r} is no name")
        return name

    def definitions(self, scope: tuple[str, ...], end: str = "") -> None:
        """Definitions up to a token."""
        while self._next != end:
            self._definition(scope)

    def _definition(self, scope: tuple[str, ...]) -> None:
        notes = self._annotations()
        word = self._take()
        if word == "module":
            name = self._name()
            self._take("{")
            self.definitions((*scope, name), "}")
            self._take("}")
        elif word == "struct":
            self._struct(scope)
        elif word == "enum":
            bits = int(notes.get("bit_bound", ["32"])[-1])
            self._declare(scope, Number("u1" if bits <= 8 else "u2" if bits <= 16 else "u4"))
        elif word == "typedef":
            declared = self._declarators(scope, self._type(scope))
            self.found.types.update(("::".join((*scope, name)), kind) for name, kind in declared)
        elif word == "const":
            self._constant(scope)
        elif word in _NOT_STRUCTS:
            self._declare(scope, Unreadable(f"a field of a {word}, which is not read"))
        else:
            raise ValueError(f"{word!r} begins no definition")
        self._take(";")

    def _declare(self, scope: tuple[str, ...], kind: _Declared) -> None:
        """A type of its own, whose members do not matter."""
        self.found.types["::".join((*scope, self._name()))] = kind
        self._skip()

    def _struct(self, scope: tuple[str, ...]) -> None:
        name = self._name()
        if self._next == ";":
            return
        if self._next == ":":
            what = Unreadable("a field of a struct that inherits, which is not read")
            self.found.types["::".join((*scope, name))] = what
            self._skip()
            return
        self._take("{")
        fields: dict[str, _Declared] = {}
        while self._next != "}":
            is_optional = "optional" in self._annotations()
            for one, kind in self._declarators(scope, self._type(scope)):
                if one in fields:
                    raise ValueError(f"{name} has two fields {one}")
                fields[one] = Unreadable("an optional field") if is_optional else kind
            self._take(";")
        self._take("}")
        self.found.structs["::".join((*scope, name))] = fields

    def _constant(self, scope: tuple[str, ...]) -> None:
        self._type(scope)
        name = self._name()
        self._take("=")
        value = self._skip()
        if len(value) == 1 and (number := _whole_number(value[0])) is not None:
            self.found.constants["::".join((*scope, name))] = number

    def _declarators(
        self, scope: tuple[str, ...], kind: _Declared
    ) -> Iterator[tuple[str, _Declared]]:
        """Names, each with its own size of an array."""
        while True:
            name, sizes = self._name(), []
            while self._next == "[":
                self._take("[")
                sizes.append(self._size(scope, "]"))
            declared = kind
            for size in reversed(sizes):
                declared = _List(declared, size)
            yield name, declared
            if self._next != ",":
                return
            self._take(",")

    def _type(self, scope: tuple[str, ...]) -> _Declared:
        word = self._take()
        while self._next in _OF_SEVERAL_WORDS.get(word, ()):
            word = f"{word} {self._take()}"
        if word == "sequence":
            self._take("<")
            element = self._type(scope)
            if self._take(",", ">") == ",":
                self._size(scope, ">")
            return _List(element, None)
        if word in _TEXTS:
            if self._next == "<":
                self._take("<")
                self._size(scope, ">")
            return _TEXTS[word]
        if word in _NUMBERS:
            return Number(_NUMBERS[word])
        if word in _NOT_IN_ROS_2:
            self._skip_angles()
            return Unreadable(f"a field of type {word}, which is not read")
        return _Reference(scope, word)

    def _size(self, scope: tuple[str, ...], end: str) -> int | _Reference:
        word = self._take()
        if self._next != end:
            raise NotImplementedError("a size that is an expression, which is not read")
        self._take(end)
        number = _whole_number(word)
        return _Reference(scope, word) if number is None else number

    def _annotations(self) -> dict[str, list[str]]:
        """Annotations with what stands between their brackets."""
        found: dict[str, list[str]] = {}
        while self._next == "@":
            self._take("@")
            name = self._take()
            found[name] = self._bracket()[1:-1] if self._next == "(" else []
        return found

    def _skip_angles(self) -> None:
        depth = int(self._next == "<")
        while depth:
            self._take()
            depth += (self._next == "<") - (self._next == ">")
            if not depth:
                self._take(">")

    def _skip(self) -> list[str]:
        """Tokens up to the semicolon."""
        start = self._at
        while self._next != ";":
            self._bracket()
        return self._tokens[start : self._at]

    def _bracket(self) -> list[str]:
        """A token, and where it is a bracket all up to the one that closes it."""
        start = self._at
        end = _BRACKETS.get(self._take())
        while end is not None and self._next != end:
            self._bracket()
        if end is not None:
            self._take(end)
        return self._tokens[start : self._at]


def _whole_number(token: str) -> int | None:
    if re.fullmatch(r"0[xX][0-9a-fA-F]+", token):
        return int(token, 16)
    # A zero in front of a number makes it octal.
    return int(token, 8 if token.startswith("0") else 10) if token.isdigit() else None

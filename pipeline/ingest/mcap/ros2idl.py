"""Message definitions of ROS 2 in the interface definition language ("ros2idl").

rosbag2 writes them for packages with ``.idl`` files, each file after a line of equal signs and a
line ``IDL: package/msg/Name``. The parser reads what interface packages and ROS 2's adapter from
``.msg`` contain: modules, structs, constants, typedefs and annotations, full names or names of a
typedef, one member per declaration, arrays of one dimension and a plain size. Enums and unions are
not part of ROS 2. See https://design.ros2.org/articles/idl_interface_definition.html.
"""

from __future__ import annotations

import re

from pipeline.ingest.mcap.layout import Schema
from pipeline.ingest.mcap.ros2_types import (
    NUMBERS,
    TEXTS,
    Array,
    Definitions,
    Message,
    Number,
    Type,
    Unreadable,
    definitions_of,
)

_HEADING = re.compile(r"^={3,}[ \t\r]*\nIDL:.*$", re.MULTILINE)
_SERVICE = re.compile(r"^SRV:", re.MULTILINE)
# What is opened and never closed goes to the end, so that no place of a text is looked at twice.
_NO_LAYOUT = re.compile(
    r"""
    "(?:\\.|[^"\\])*(?:"|\Z) | '(?:\\.|[^'\\])' | //[^\n]* | /\*.*?(?:\*/|\Z) | ^[ \t]*\#[^\n]*
    """,
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)
_ANNOTATION = re.compile(r"@(?!optional\b)\w+\s*(?:\([^()]*\))?")
# How long a text or sequence may be does not shape its layout.
_BOUND = re.compile(r",\s*[\w:]+\s*(?=>)|(?<=string)\s*<[^<>]*>")
_STATEMENT = re.compile(r"([^;{}]*)([;{}]|\Z)")
_SCOPE = re.compile(r"(module|struct)\s+(\w+)")
_MEMBER = re.compile(r"(.*[\s>])([A-Za-z_]\w*)\s*((?:\[[^\[\]]*\]\s*)*)", re.DOTALL)
_CONSTANT = re.compile(r"(?:@optional\s+)?const\s")
_SEQUENCE = re.compile(r"sequence\s*<(.*)>", re.DOTALL)
_REFERENCE = re.compile(r"(?:::)?[A-Za-z_]\w*(?:::[A-Za-z_]\w*)*")

_NUMBERS = {
    **{name: kind for name, kind in NUMBERS.items() if "int" in name},
    "boolean": "?",
    "octet": "u1",
    "char": "u1",
    "short": "i2",
    "unsigned short": "u2",
    "long": "i4",
    "unsigned long": "u4",
    "long long": "i8",
    "unsigned long long": "u8",
    "float": "f4",
    "double": "f8",
}
# Wide characters are of two or of four bytes, as the writer has it, and nothing tells which.
_UNREADABLE = ("long double", "wchar")

_Types = dict[str, Type]


def ros2idl_definitions(schema: Schema) -> Definitions:
    """Definitions out of a schema record.

    Raises
    ------
    ValueError
        The definition contradicts itself, or is none that ROS 2 takes.
    NotImplementedError
        It has a type that is not read.
    """
    whole = schema.data.decode()
    if _SERVICE.search(whole):
        raise NotImplementedError("the definition of a service beside IDL, which is not read")
    structs: dict[str, _Types] = {}
    for text in _HEADING.split(whole):
        plain = _ANNOTATION.sub(" ", _NO_LAYOUT.sub(" ", text))
        structs |= _structs(_BOUND.sub("", plain))
    package, *_, name = schema.name.split("/")
    return definitions_of(f"{package}::msg::{name}", structs)


def _structs(text: str) -> dict[str, _Types]:
    """Fields of a file's structs, by their full names such as ``package::msg::Name``."""
    structs: dict[str, _Types] = {}
    typedefs: _Types = {}
    scope: list[str] = []
    fields: _Types | None = None
    for match in _STATEMENT.finditer(text):
        statement, mark = match[1].strip(), match[2]
        opened = _SCOPE.fullmatch(statement)
        if mark == "{" and opened and fields is None:
            scope.append(opened[2])
            if opened[1] == "struct":
                fields = structs["::".join(scope)] = {}
        elif mark == "}" and scope and not statement:
            scope.pop()
            fields = None
        elif mark == ";" and fields is not None:
            name, kind = _declared(statement, typedefs)
            if name in fields:
                raise ValueError(f"there are two fields {name}")
            fields[name] = kind
        elif mark == ";" and statement.startswith("typedef "):
            typedefs |= [_declared(statement.removeprefix("typedef "), typedefs)]
        elif (statement and not _CONSTANT.match(statement)) or mark in ("{", "}"):
            raise ValueError(f"{match[0].strip()[:40]!r} is no definition of ROS 2")
    if scope:
        raise ValueError("it ends within a definition")
    return structs


def _declared(text: str, typedefs: _Types) -> tuple[str, Type]:
    """Name and type that a typedef or member declares."""
    if "," in text:
        raise NotImplementedError(f"{text[:40]!r} has several names, which are not read")
    member = _MEMBER.fullmatch(text)
    if member is None:
        raise ValueError(f"{text[:40]!r} declares no field")
    kind = _type(member[1].strip(), typedefs)
    if not member[3]:
        return member[2], kind
    size = member[3].strip()[1:-1].strip()
    if not size.isdecimal():
        raise NotImplementedError(f"an array of {size[:40]!r} elements, which is not read")
    if not int(size):
        raise ValueError("an array has no size")
    return member[2], Array(kind, int(size))


def _type(text: str, typedefs: _Types) -> Type:
    words = " ".join(text.split())
    if words.startswith("@optional"):
        return Unreadable("an optional field")
    if sequence := _SEQUENCE.fullmatch(text):
        return Array(_type(sequence[1].strip(), typedefs))
    if words in TEXTS:
        return TEXTS[words]
    if words in _NUMBERS:
        return Number(_NUMBERS[words])
    if words in _UNREADABLE:
        return Unreadable(f"a field of type {words}, which is not read")
    if not _REFERENCE.fullmatch(text):
        raise ValueError(f"{text[:40]!r} is no type")
    return typedefs.get(text) or Message(text.removeprefix("::"))

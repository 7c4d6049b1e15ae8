"""Message definitions of ROS 2 as they stand in the schema records of MCAP files ("ros2msg").

The definition of the message itself comes first, then those it is made of, each behind a line of
equal signs and a line ``MSG: package/Name``. See
https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import LogError
from pipeline.ingest.mcap_layout import Schema
from pipeline.ingest.mcap_paths import FieldPath, path_text
from pipeline.ingest.mcap_payloads import NANOSECONDS, SECONDS

NUMBERS = {
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

_SIZES = {name: int(kind[1]) for name, kind in NUMBERS.items()} | {"bool": 1, "string": 4}
_UNREADABLE = ("wstring", "time", "duration")
_FIELD = re.compile(r"(?P<type>[\w/]+)(?:<=\d+)?(?P<array>\[(?P<bound><=)?(?P<count>\d*)\])?")


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message.

    Attributes
    ----------
    type
        Name of a primitive type, or ``package/Name``.
    count
        None: no array; 0: a sequence of any length; else the length of the array.
    """

    name: str
    type: str
    count: int | None


@dataclass(frozen=True, slots=True)
class Definitions:
    """A message and those it is made of.

    Attributes
    ----------
    root
        Name of the message.
    fields
        Fields by name of the message.
    smallest
        Fewest bytes that a type can take, without padding.
    """

    root: str
    fields: Mapping[str, tuple[Field, ...]]
    smallest: Mapping[str, int]


def ros2_definitions(path: Path, schema: Schema) -> Definitions:
    """Definitions out of a schema record.

    Raises
    ------
    LogError
        ``log_damaged``: the definition contradicts itself; ``log_encoding``: it has a type that is
        not read.
    """
    stamp = (Field("sec", "uint32", None), Field("nanosec", "uint32", None))
    fields: dict[str, tuple[Field, ...]] = {}
    fields |= {"builtin_interfaces/Time": stamp, "builtin_interfaces/Duration": stamp}
    root = name = _short(schema.name)
    try:
        for text in re.split(r"^={3,}[ \t\r]*$", schema.data.decode(), flags=re.MULTILINE):
            lines = [line.partition("#")[0].split() for line in text.splitlines()]
            lines = [line for line in lines if line]
            if lines and lines[0][0] == "MSG:":
                name = _short(lines.pop(0)[1])
            package = name.partition("/")[0]
            fields[name] = tuple(
                _field(line, package) for line in lines if "=" not in " ".join(line[1:])
            )
        smallest = dict(_SIZES)
        _measure(root, fields, smallest, ())
    except (ValueError, KeyError, IndexError) as error:
        raise LogError(
            "log_damaged", path, f"the definition of {schema.name} cannot be read: {error}"
        ) from error
    except NotImplementedError as error:
        raise LogError("log_encoding", path, f"{schema.name} has {error}") from error
    return Definitions(root, fields, smallest)


def _short(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return f"{name.split('/')[0]}/{name.split('/')[-1]}"


def _field(words: list[str], package: str) -> Field:
    match = _FIELD.fullmatch(words[0])
    if match is None:
        raise ValueError(f"{words[0]!r} is no type")
    name = match["type"]
    if name in _UNREADABLE:
        raise NotImplementedError(f"a field of type {name}, which is not read")
    kind = name if name in _SIZES else _short(name if "/" in name else f"{package}/{name}")
    if match["array"] is None:
        return Field(words[1], kind, None)
    count = 0 if match["bound"] else int(match["count"] or 0)
    if match["count"] and not int(match["count"]):
        raise ValueError(f"{words[0]!r} is an array of nothing")
    return Field(words[1], kind, count)


def _measure(
    name: str,
    fields: Mapping[str, tuple[Field, ...]],
    smallest: dict[str, int],
    around: tuple[str, ...],
) -> int:
    """Fewest bytes of a type; on the way every type is found, and none within itself."""
    if name in smallest:
        return smallest[name]
    if name in around:
        raise ValueError(f"{name} holds itself")
    if name not in fields:
        raise ValueError(f"there is no definition of {name}")
    size = 0
    for field in fields[name]:
        inner = _measure(field.type, fields, smallest, (*around, name))
        size += 4 if field.count == 0 else inner * (field.count or 1)
    # A message of no fields has one byte on the wire.
    smallest[name] = max(size, 1)
    return smallest[name]


def kind_of_field(path: Path, topic: str, definitions: Definitions, wanted: FieldPath) -> str:
    """NumPy's name of the type of a field.

    Raises
    ------
    LogError
        ``log_column_missing`` or ``log_type``: the path leads nowhere, or to no number.
    """
    message, field, in_array = definitions.root, None, False
    for step in wanted:
        if isinstance(step, int):
            inside = in_array and (field is None or not field.count or step < field.count)
            in_array = False
        else:
            fields = () if in_array else definitions.fields.get(message, ())
            field = next((one for one in fields if one.name == step), None)
            inside = field is not None
            if field is not None:
                message, in_array = field.type, field.count is not None
        if not inside:
            raise LogError(
                "log_column_missing",
                path,
                f"messages of topic {topic!r} have no field {path_text(wanted)!r}; there are "
                + ", ".join(_names(definitions, definitions.root, "")[:40]),
                topic,
            )
    if in_array or message not in NUMBERS:
        what = f"an array of {message}" if in_array else message
        raise LogError(
            "log_type", path, f"field {path_text(wanted)!r} is no number but {what}", topic
        )
    return NUMBERS[message]


def _names(definitions: Definitions, message: str, before: str) -> list[str]:
    """Paths to all numbers, an array's by its first element."""
    names: list[str] = []
    for field in definitions.fields[message]:
        name = before + field.name + ("" if field.count is None else "[0]")
        if field.type in NUMBERS:
            names.append(repr(name))
        elif field.type in definitions.fields and len(names) < 40:
            names += _names(definitions, field.type, name + ".")
    return names


def stamp_parts(definitions: Definitions, stamp: FieldPath) -> list[FieldPath]:
    """Paths to the seconds and nanoseconds of a stamp, or to the one number that it is."""
    message = definitions.root
    for step in stamp:
        fields = definitions.fields.get(message, ())
        field = next((one for one in fields if one.name == step), None)
        if field is not None:
            message = field.type
    names = [field.name for field in definitions.fields.get(message, ())]
    seconds = [(*stamp, name) for name in SECONDS if name in names]
    nanoseconds = [(*stamp, name) for name in NANOSECONDS if name in names]
    return [*seconds[:1], *nanoseconds[:1]] if seconds and nanoseconds else [stamp]

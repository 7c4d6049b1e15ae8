"""Message definitions of ROS 2 as they stand in the schema records of MCAP files ("ros2msg").

The definition of the message itself comes first, then those it is made of, each behind a line of
equal signs and a line ``MSG: package/Name``. See
https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html.
"""

from __future__ import annotations

import re

from pipeline.ingest.mcap_layout import Schema
from pipeline.ingest.mcap_ros2_types import (
    NUMBERS,
    Array,
    Definitions,
    Fields,
    Message,
    Number,
    Text,
    Type,
    Unreadable,
    definitions_of,
)

_FIELD = re.compile(r"(?P<type>[\w/]+)(?:<=\d+)?(?P<array>\[(?P<bound><=)?(?P<count>\d*)\])?")
_TEXTS = {"string": Text(), "wstring": Text(is_wide=True)}
# Of ROS 1; ROS 2 keeps the words and gives them no layout.
_UNREADABLE = ("time", "duration")


def ros2msg_definitions(schema: Schema) -> Definitions:
    """Definitions out of a schema record.

    Raises
    ------
    ValueError, KeyError, IndexError
        The definition contradicts itself.
    NotImplementedError
        It has a type that is not read.
    """
    stamp: Fields = {"sec": Number("u4"), "nanosec": Number("u4")}
    messages = {"builtin_interfaces/Time": stamp, "builtin_interfaces/Duration": stamp}
    root = name = _short(schema.name)
    for text in re.split(r"^={3,}[ \t\r]*$", schema.data.decode(), flags=re.MULTILINE):
        lines = [line.partition("#")[0].split() for line in text.splitlines()]
        lines = [line for line in lines if line]
        if lines and lines[0][0] == "MSG:":
            name = _short(lines.pop(0)[1])
        package = name.partition("/")[0]
        # What has an equals sign is a constant, which is not on the wire.
        fields = [line for line in lines if "=" not in " ".join(line[1:])]
        messages[name] = {words[1]: _type(words[0], package) for words in fields}
        if len(messages[name]) < len(fields):
            raise ValueError(f"{name} has two fields of one name")
    return definitions_of(root, messages)


def _short(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return f"{name.split('/')[0]}/{name.split('/')[-1]}"


def _type(word: str, package: str) -> Type:
    match = _FIELD.fullmatch(word)
    if match is None:
        raise ValueError(f"{word!r} is no type")
    element = _element(match["type"], package)
    if match["array"] is None:
        return element
    if match["count"] and not int(match["count"]):
        raise ValueError(f"{word!r} is an array of nothing")
    return Array(element, int(match["count"]) if match["count"] and not match["bound"] else None)


def _element(name: str, package: str) -> Type:
    if name in NUMBERS:
        return Number(NUMBERS[name])
    if name in _TEXTS:
        return _TEXTS[name]
    if name in _UNREADABLE:
        return Unreadable(f"a field of type {name}, which is not read")
    return Message(_short(name if "/" in name else f"{package}/{name}"))

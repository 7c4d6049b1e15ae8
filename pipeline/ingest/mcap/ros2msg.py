"""Message definitions of ROS 2 as they stand in the schema records of MCAP files ("ros2msg").

The definition of the message itself comes first, then those it is made of, each behind a line of
equal signs and a line ``MSG: package/Name``. See
https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html. For the events of a service
rosbag2 writes ``SRV: package/srv/Name`` and the service's own definition, request and response with
``---`` between them, not that of the message (https://github.com/ros2/rosbag2/issues/2365).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from pipeline.ingest.mcap.layout import Schema
from pipeline.ingest.mcap.ros2_types import (
    NUMBERS,
    TEXTS,
    Array,
    Definitions,
    Fields,
    Message,
    Number,
    Type,
    Unreadable,
    definitions_of,
)

_FIELD = re.compile(r"(?P<type>[\w/]+)(?:<=\d+)?(?P<array>\[(?P<bound><=)?(?P<count>\d*)\])?")
# Of ROS 1; ROS 2 keeps the words and gives them no layout.
_UNREADABLE = ("time", "duration")
_STAMP: Fields = {"sec": Number("u4"), "nanosec": Number("u4")}
# Recorders leave these out where nothing else names them.
_BUILT_IN: Mapping[str, Fields] = {
    "builtin_interfaces/Time": _STAMP,
    "builtin_interfaces/Duration": _STAMP,
    "service_msgs/ServiceEventInfo": {
        "event_type": Number("u1"),
        "stamp": Message("builtin_interfaces/Time"),
        "client_gid": Array(Number("i1"), 16),
        "sequence_number": Number("i8"),
    },
}


def ros2msg_definitions(schema: Schema) -> Definitions:
    """Definitions out of a schema record.

    Raises
    ------
    ValueError
        The definition contradicts itself.
    NotImplementedError
        It has a type that is not read.
    """
    messages: dict[str, Fields] = dict(_BUILT_IN)
    root = name = _short(schema.name)
    for text in re.split(r"^={3,}[ \t\r]*$", schema.data.decode(), flags=re.MULTILINE):
        lines = [line.partition("#")[0].split() for line in text.splitlines()]
        lines = [line for line in lines if line]
        if lines and lines[0][0] in ("MSG:", "SRV:"):
            name = _short(_second(lines.pop(0)))
        if ["---"] in lines:
            messages |= _service(name.removesuffix("_Event"), lines)
        else:
            messages[name] = _fields(name, lines)
    return definitions_of(root, messages)


def _service(name: str, lines: list[list[str]]) -> dict[str, Fields]:
    """Messages of a service, and the one of its events, in whose place its definition stands."""
    between = lines.index(["---"])
    request, response = f"{name}_Request", f"{name}_Response"
    return {
        request: _fields(request, lines[:between]),
        response: _fields(response, lines[between + 1 :]),
        f"{name}_Event": {
            "info": Message("service_msgs/ServiceEventInfo"),
            "request": Array(Message(request)),
            "response": Array(Message(response)),
        },
    }


def _fields(name: str, lines: list[list[str]]) -> Fields:
    package = name.partition("/")[0]
    # What has an equals sign is a constant, which is not on the wire.
    fields = [line for line in lines if "=" not in " ".join(line[1:])]
    found = {_second(words): _type(words[0], package) for words in fields}
    if len(found) < len(fields):
        raise ValueError(f"{name} has two fields of one name")
    return found


def _second(words: list[str]) -> str:
    if len(words) < 2:
        raise ValueError(f"{words[0]!r} stands alone, without a name behind it")
    return words[1]


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
    if name in TEXTS:
        return TEXTS[name]
    if name in _UNREADABLE:
        return Unreadable(f"a field of type {name}, which is not read")
    return Message(_short(name if "/" in name else f"{package}/{name}"))

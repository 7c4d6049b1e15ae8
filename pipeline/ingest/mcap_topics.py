"""The topics of an MCAP file: their fields, with samples as the reader itself decodes them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.field_paths import FieldPath
from pipeline.errors import LogError
from pipeline.ingest.mcap_cdr import ROS2_LANGUAGES, cdr_decoder, ros2_definitions
from pipeline.ingest.mcap_json import json_decoder
from pipeline.ingest.mcap_layout import ChannelRecord, Schema, Summary, read_summary
from pipeline.ingest.mcap_messages import Messages, read_messages
from pipeline.ingest.mcap_payloads import Decoder, Payloads, payloads_of, stacked
from pipeline.ingest.mcap_protobuf import protobuf_decoder
from pipeline.ingest.mcap_ros2_types import Array, Definitions, Message, Number, Type

MESSAGES_READ = 50
_MOST_BYTES = 64 * 2**20
_MOST_FIELDS = 60
_MOST_ELEMENTS = 4
_DEEPEST = 6
_REPEATED = 3
_PROTOBUF_NUMBERS = {1, 2, 3, 4, 5, 6, 7, 13, 15, 16, 17, 18}
"""Types of numbers in ``descriptor.proto``; neither truth values nor enums."""


@dataclass(slots=True)
class Topic:
    """A topic.

    Attributes
    ----------
    count
        Messages; None where the file does not say it.
    log_ns, publish_ns
        Times of the first messages.
    fields
        Numbers by path, of the first messages; nan where a message has none.
    texts
        Text by path, of the first message (JSON only).
    fault
        Why the messages cannot be read; empty where they can.
    """

    name: str
    encoding: str
    schema: str
    count: int | None = None
    log_ns: list[int] = field(default_factory=list)
    publish_ns: list[int] = field(default_factory=list)
    fields: Mapping[FieldPath, tuple[float, ...]] = field(default_factory=dict)
    texts: Mapping[FieldPath, str] = field(default_factory=dict)
    fault: str = ""


def read_topics(path: Path) -> list[Topic]:
    """All topics of a file, by name, those without a message too.

    Parameters
    ----------
    path
        An existing file, of which no more is read than is needed to see each topic.

    Raises
    ------
    LogError
        As `pipeline.ingest.mcap_messages.read_messages`.
    """
    with path.open("rb") as file:
        summary = read_summary(path, file)
    payloads: dict[str, list[Payloads]] = {}
    topics: dict[str, Topic] = {}
    schemas: dict[str, Schema] = {}
    for messages in read_messages(path):
        for channel in {**summary.channels, **messages.channels}.values():
            schema = {**summary.schemas, **messages.schemas}.get(channel.schema_id)
            schemas.setdefault(channel.topic, schema or Schema("", "", b""))
            topics.setdefault(channel.topic, _topic(channel, schema, summary))
        _take(messages, topics, payloads)
        whole = all(len(one.log_ns) >= MESSAGES_READ for one in topics.values())
        if (whole and summary.channels) or messages.read_to > _MOST_BYTES:
            break
    for name, found in payloads.items():
        _decode(path, topics[name], schemas[name], stacked(found))
    return [topics[name] for name in sorted(topics)]


def _topic(channel: ChannelRecord, schema: Schema | None, summary: Summary) -> Topic:
    count = None
    if summary.statistics is not None:
        same = [i for i, one in summary.channels.items() if one.topic == channel.topic]
        count = sum(summary.statistics.counts_by_channel.get(i, 0) for i in same)
    return Topic(channel.topic, channel.encoding, "" if schema is None else schema.name, count)


def _take(
    messages: Messages, topics: Mapping[str, Topic], payloads: dict[str, list[Payloads]]
) -> None:
    """Take the first messages of each topic out of a piece."""
    for name, topic in topics.items():
        ids = [i for i, channel in messages.channels.items() if channel.topic == name]
        wanted = MESSAGES_READ - len(topic.log_ns)
        rows = np.flatnonzero(np.isin(messages.channel_id, ids))[: max(wanted, 0)]
        if rows.size:
            numbers = np.zeros(messages.channel_id.size, np.int16)
            taken = payloads_of(messages, rows, numbers, messages.log_time)
            payloads.setdefault(name, []).append(taken)
            topic.log_ns += messages.log_time[rows].tolist()
            topic.publish_ns += messages.publish_time[rows].tolist()


def _decode(path: Path, topic: Topic, schema: Schema, payloads: Payloads) -> None:
    try:
        if topic.encoding == "json":
            objects = list(_objects(payloads))
            paths = list(dict.fromkeys(p for one in objects for p, _ in _leaves(one, _is_number)))
            texts = [leaf for one in objects[:1] for leaf in _leaves(one, _is_text)]
            topic.texts = dict(texts)
            decoder = json_decoder(paths[:_MOST_FIELDS], None, "epoch_ns")
        elif topic.encoding == "cdr" and schema.encoding in ROS2_LANGUAGES:
            definitions = ros2_definitions(path, topic.name, schema)
            paths = list(_ros2_paths(definitions, definitions.root, ()))
            decoder = _made(cdr_decoder, path, topic, schema, paths)
        elif (topic.encoding, schema.encoding) == ("protobuf", "protobuf"):
            paths = list(_protobuf_paths(path, schema))
            decoder = _made(protobuf_decoder, path, topic, schema, paths)
        else:
            topic.fault = f"messages in {topic.encoding or 'an encoding without a name'!r}"
            return
        paths = paths[:_MOST_FIELDS]
        decoded = decoder(payloads) if paths else None
    except LogError as error:
        topic.fault = error.message
        return
    if decoded is not None:
        topic.fields = {one: tuple(decoded.fields[one].raw.tolist()) for one in paths}


def _made(
    decoder: Callable[..., Decoder],
    path: Path,
    topic: Topic,
    schema: Schema,
    paths: Sequence[FieldPath],
) -> Decoder:
    return decoder(path, topic.name, schema, paths[:_MOST_FIELDS], None, "epoch_ns")


def _objects(payloads: Payloads) -> Iterator[Any]:
    text = payloads.text.tobytes()
    for start, length in zip(payloads.start.tolist(), payloads.length.tolist(), strict=True):
        try:
            yield json.loads(text[start : start + length])
        except (ValueError, RecursionError):
            continue


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _leaves(
    node: Any, wanted: Callable[[object], bool], path: FieldPath = ()
) -> Iterator[tuple[FieldPath, Any]]:
    """Values of a JSON message that are wanted, by path."""
    below: Sequence[tuple[str | int, Any]] = ()
    if isinstance(node, dict):
        below = list(node.items())
    elif isinstance(node, list):
        below = list(enumerate(node[:_MOST_ELEMENTS]))
    elif path and wanted(node):
        yield path, node
    for step, inner in below if len(path) < _DEEPEST else ():
        # A key without a letter cannot stand in a path.
        if step != "":
            yield from _leaves(inner, wanted, (*path, step))


def _ros2_paths(definitions: Definitions, message: str, path: FieldPath) -> Iterator[FieldPath]:
    for name, kind in definitions.fields[message].items():
        yield from _ros2_paths_of(definitions, kind, (*path, name))


def _ros2_paths_of(definitions: Definitions, kind: Type, path: FieldPath) -> Iterator[FieldPath]:
    if isinstance(kind, Number):
        yield path
    elif isinstance(kind, Array):
        # Of a sequence of any length the first element stands for all.
        count = 1 if kind.count is None else min(kind.count, _MOST_ELEMENTS)
        for place in range(count):
            yield from _ros2_paths_of(definitions, kind.element, (*path, place))
    elif isinstance(kind, Message) and len(path) < 2 * _DEEPEST:
        yield from _ros2_paths(definitions, kind.name, path)


def _protobuf_paths(path: Path, schema: Schema) -> Iterator[FieldPath]:
    try:
        from google.protobuf import descriptor_pb2
        from google.protobuf.message import DecodeError
    except ImportError as error:
        raise LogError(
            "log_extra_missing",
            path,
            "its messages are Protobuf: install the extra protobuf "
            "(pip install 'motor-leakage[protobuf]')",
        ) from error
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
    except DecodeError as error:
        raise LogError("log_damaged", path, f"the descriptors cannot be read: {error}") from error
    messages: dict[str, Any] = {}
    for file in files:
        _add_messages(f".{file.package}" if file.package else "", file.message_type, messages)
    yield from _fields_of(messages, f".{schema.name}", ())


def _add_messages(package: str, types: Any, messages: dict[str, Any]) -> None:
    for one in types:
        messages[f"{package}.{one.name}"] = one
        _add_messages(f"{package}.{one.name}", one.nested_type, messages)


def _fields_of(messages: Mapping[str, Any], name: str, path: FieldPath) -> Iterator[FieldPath]:
    for one in messages[name].field if name in messages else ():
        inner = (*path, one.name, *((0,) if one.label == _REPEATED else ()))
        if one.type in _PROTOBUF_NUMBERS:
            yield inner
        # A message may hold itself.
        elif one.type_name and len(path) < _DEEPEST:
            yield from _fields_of(messages, one.type_name, inner)

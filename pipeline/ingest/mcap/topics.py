"""The topics of an MCAP file: their fields, with samples as the reader itself decodes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.config.field_paths import FieldPath
from pipeline.errors import LogError
from pipeline.ingest.mcap.cdr import ROS2_LANGUAGES, cdr_decoder, ros2_root
from pipeline.ingest.mcap.fields import number_paths
from pipeline.ingest.mcap.json import json_decoder, json_object, leaves
from pipeline.ingest.mcap.layout import ChannelRecord, Schema, Summary, read_summary
from pipeline.ingest.mcap.messages import Messages, read_messages
from pipeline.ingest.mcap.payloads import Payloads, payloads_of, stacked
from pipeline.ingest.mcap.protobuf import protobuf_decoder, protobuf_root

MESSAGES_READ = 50
_MOST_BYTES = 64 * 2**20
_MOST_FIELDS = 60


@dataclass(slots=True)
class Topic:
    """A topic, with samples of its first messages."""

    name: str
    encoding: str
    schema: str
    count: int | None = None  # messages; None where the file does not say it
    log_ns: list[int] = field(default_factory=list)
    publish_ns: list[int] = field(default_factory=list)
    fields: Mapping[FieldPath, tuple[float, ...]] = field(default_factory=dict)  # nan for none
    texts: Mapping[FieldPath, str] = field(default_factory=dict)  # of the first message (JSON)
    fault: str = ""  # why the messages cannot be read


def read_topics(path: Path) -> list[Topic]:
    """All topics of a file, by name, those without a message too.

    No more is read than is needed to see each topic.
    """
    summary = read_summary(path)
    payloads: dict[str, list[Payloads]] = {}
    topics: dict[str, Topic] = {}
    schemas: dict[str, Schema] = {}
    for messages in read_messages(path):
        for channel in {**summary.declared.channels, **messages.channels}.values():
            schema = {**summary.declared.schemas, **messages.schemas}.get(channel.schema_id)
            schemas.setdefault(channel.topic, schema or Schema("", "", b""))
            topics.setdefault(channel.topic, _topic(channel, schema, summary))
        _take(messages, topics, payloads)
        whole = all(len(one.log_ns) >= MESSAGES_READ for one in topics.values())
        if (whole and summary.declared.channels) or messages.read_to > _MOST_BYTES:
            break
    for name, found in payloads.items():
        _decode(path, topics[name], schemas[name], stacked(found))
    return [topics[name] for name in sorted(topics)]


def _topic(channel: ChannelRecord, schema: Schema | None, summary: Summary) -> Topic:
    name = "" if schema is None else schema.name
    return Topic(channel.topic, channel.encoding, name, summary.stated_count(channel.topic))


def _take(
    messages: Messages, topics: Mapping[str, Topic], payloads: dict[str, list[Payloads]]
) -> None:
    """Take the first messages of each topic out of a piece."""
    for name, topic in topics.items():
        ids = [i for i, channel in messages.channels.items() if channel.topic == name]
        wanted = MESSAGES_READ - len(topic.log_ns)
        rows = np.flatnonzero(np.isin(messages.channel_id, ids))[: max(wanted, 0)]
        if rows.size:
            numbers, log_time = np.zeros(messages.start.size, np.int16), messages.times("log_time")
            taken = payloads_of(messages, rows, numbers, log_time)
            payloads.setdefault(name, []).append(taken)
            topic.log_ns += log_time[rows].tolist()
            topic.publish_ns += messages.times("publish_time")[rows].tolist()


def _decode(path: Path, topic: Topic, schema: Schema, payloads: Payloads) -> None:
    kind = (topic.encoding, schema.encoding)
    try:
        if topic.encoding == "json":
            messages = [one for one in map(json_object, payloads.each()) if one is not None]
            found = [leaf for one in messages for leaf in leaves(one)]
            paths = list(dict.fromkeys(at for at, value in found if _is_number(value)))
            texts = leaves(messages[0]) if messages else ()
            topic.texts = {at: text for at, text in texts if isinstance(text, str)}
            decoder = json_decoder(paths[:_MOST_FIELDS], None, "epoch_ns")
        elif topic.encoding == "cdr" and schema.encoding in ROS2_LANGUAGES:
            paths = number_paths(ros2_root(path, topic.name, schema), _MOST_FIELDS)
            decoder = cdr_decoder(path, topic.name, schema, paths, None, "epoch_ns")
        elif kind == ("protobuf", "protobuf"):
            paths = number_paths(protobuf_root(path, schema), _MOST_FIELDS)
            decoder = protobuf_decoder(path, topic.name, schema, paths, None, "epoch_ns")
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


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)

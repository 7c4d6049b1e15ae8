"""The topics of an MCAP file: their fields, with samples as the reader itself decodes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.config.field_paths import FieldPath
from pipeline.errors import LogError
from pipeline.ingest.mcap.decoding import Payloads, Wanted, leaves, payloads_of, stacked
from pipeline.ingest.mcap.layout import NO_SCHEMA, ChannelRecord, Schema, Summary, read_summary
from pipeline.ingest.mcap.log import decoder_of
from pipeline.ingest.mcap.messages import Messages, read_messages

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
    texts: Mapping[FieldPath, str] = field(default_factory=dict)  # of the first message
    fault: str = ""  # why the messages cannot be read


def read_topics(path: Path) -> list[Topic]:
    """All topics of a file, by name, those without a message too.

    No more is read than is needed to see each topic.
    """
    summary = read_summary(path)
    payloads: dict[str, list[Payloads]] = {}
    topics: dict[str, Topic] = {}
    records: dict[str, ChannelRecord] = {}
    schemas: dict[int, Schema] = {}
    for messages in read_messages(path):
        schemas |= {**summary.declared.schemas, **messages.schemas}
        for channel in {**summary.declared.channels, **messages.channels}.values():
            records.setdefault(channel.topic, channel)
            topics.setdefault(channel.topic, _topic(channel, schemas, summary))
        _take(messages, topics, payloads)
        whole = all(len(one.log_ns) >= MESSAGES_READ for one in topics.values())
        if (whole and summary.declared.channels) or messages.read_to > _MOST_BYTES:
            break
    for name, record in records.items():
        try:
            schema = schemas.get(record.schema_id, NO_SCHEMA)
            _decode(path, topics[name], record, schema, payloads.get(name, []))
        except LogError as error:
            topics[name].fault = error.message
    return [topics[name] for name in sorted(topics)]


def _topic(channel: ChannelRecord, schemas: Mapping[int, Schema], summary: Summary) -> Topic:
    schema = schemas.get(channel.schema_id)
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
            log_time = messages.times("log_time")
            taken = payloads_of(messages, rows, np.zeros(log_time.size, np.int16), log_time)
            payloads.setdefault(name, []).append(taken)
            topic.log_ns += log_time[rows].tolist()
            topic.publish_ns += messages.times("publish_time")[rows].tolist()


def _decode(
    path: Path,
    topic: Topic,
    record: ChannelRecord,
    schema: Schema,
    found: list[Payloads],
) -> None:
    if record.encoding not in ("json", "protobuf", "cdr"):
        topic.fault = f"messages in {record.encoding or 'an encoding without a name'!r}"
        return
    read_tree = decoder_of(path, record, schema, Wanted(())).tree
    if not found:
        return
    payloads = stacked(found)
    trees = [tree for tree in map(read_tree, payloads.each()) if tree is not None]
    values = [leaf for tree in trees for leaf in leaves(tree)]
    numbers = [at for at, value in values if at and _is_number(value)]
    paths = tuple(dict.fromkeys(numbers))[:_MOST_FIELDS]
    topic.texts = {at: one for at, one in leaves(trees[0]) if isinstance(one, str)} if trees else {}
    decoded = decoder_of(path, record, schema, Wanted(paths)).decode(payloads)
    topic.fields = {one: tuple(decoded.fields[one].raw.tolist()) for one in paths}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)

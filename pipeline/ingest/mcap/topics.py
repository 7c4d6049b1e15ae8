"""The topics of an MCAP file: their fields, with the figures of the first messages."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from pipeline.config.dialect import FieldPath
from pipeline.errors import LogError
from pipeline.ingest.mcap.decoding import Wanted, leaves, number_of, value_at
from pipeline.ingest.mcap.log import decoder_of
from pipeline.ingest.mcap.messages import NO_SCHEMA, Messages, read_messages, read_summary

MESSAGES_READ = 50
UNIT_KEYS = ("unit", "units", "uom", "x-unit")
_MOST_BYTES = 64 * 2**20
_MOST_FIELDS = 60


@dataclass(slots=True)
class Topic:
    """A topic, with samples of its first messages."""

    name: str
    encoding: str
    schema: str
    fields: Mapping[FieldPath, tuple[float, ...]] = field(default_factory=dict)  # nan for none
    texts: Mapping[FieldPath, str] = field(default_factory=dict)  # of the first message with any
    payloads: list[bytes] = field(default_factory=list)
    # Units that the channel's metadata or the schema state, by field; () is of every field.
    units: Mapping[FieldPath, str] = field(default_factory=dict)
    descriptions: Mapping[FieldPath, str] = field(default_factory=dict)  # in a JSON schema


def read_topics(path: Path) -> list[Topic]:
    """All topics of a file, by name, those without a message too.

    No more is read than is needed to see each topic.
    """
    summary = read_summary(path)
    topics: dict[str, Topic] = {}
    schemas: dict[str, Schema] = {}
    for messages in read_messages(path):
        known = {**summary.declared.schemas, **messages.schemas}
        channels = {**summary.declared.channels, **messages.channels}
        for channel in channels.values():
            if channel.topic not in topics:
                schema = schemas[channel.topic] = known.get(channel.schema_id, NO_SCHEMA)
                units = {**dict(_schema_units(schema)), **dict(_metadata_units(channel))}
                topics[channel.topic] = Topic(
                    channel.topic,
                    channel.message_encoding,
                    schema.name,
                    units=units,
                    descriptions=dict(_json_texts(schema, ("description",))),
                )
        for topic in topics.values():
            _take(topic, messages)
        whole = all(len(topic.payloads) >= MESSAGES_READ for topic in topics.values())
        if (whole and summary.declared.channels) or messages.read_to > _MOST_BYTES:
            break
    for name, topic in topics.items():
        with suppress(LogError):  # what cannot be read has no fields
            _decode(path, topic, schemas[name])
    return [topics[name] for name in sorted(topics)]


def _take(topic: Topic, messages: Messages) -> None:
    """Take the first messages of a topic out of a piece."""
    rows = messages.rows_of(topic.name)[: MESSAGES_READ - len(topic.payloads)]
    topic.payloads += [messages.payload(i) for i in rows.tolist()]


def _decode(path: Path, topic: Topic, schema: Schema) -> None:
    decoder = decoder_of(path, topic.name, topic.encoding, schema, Wanted(()))
    trees = [decoder.tree(payload) for payload in topic.payloads]
    pairs = [leaf for tree in trees if tree is not None for leaf in leaves(tree)]
    numbers = [at for at, value in pairs if at and number_of(value) is not None]
    topic.fields = {
        at: tuple(np.array([number_of(value_at(tree, at)) for tree in trees], np.float64).tolist())
        for at in list(dict.fromkeys(numbers))[:_MOST_FIELDS]
    }
    whole = [tree for tree in reversed(trees) if tree is not None]
    topic.texts = {at: text for tree in whole for at, text in leaves(tree) if isinstance(text, str)}


def _metadata_units(channel: Channel) -> Iterator[tuple[FieldPath, str]]:
    for key, value in channel.metadata.items():
        if key.lower() in UNIT_KEYS:
            yield (), value


def _schema_units(schema: Schema) -> Iterator[tuple[FieldPath, str]]:
    """Units of fields: of a JSON schema by their own key, of ROS 2 in a remark."""
    yield from _json_texts(schema, UNIT_KEYS)
    if schema.encoding == "ros2msg":
        text = schema.data.decode(errors="replace")
        for name, remark in re.findall(
            r"^\S+[ \t]+(\w+)[ \t]*#[ \t]*(\S+)[ \t]*$", text, re.MULTILINE
        ):
            yield (name,), remark


def _json_texts(schema: Schema, keys: Collection[str]) -> Iterator[tuple[FieldPath, str]]:
    """Yield what a JSON schema says of its fields under some keys."""
    if schema.encoding == "jsonschema":
        with suppress(ValueError, RecursionError):
            yield from _texts_below(json.loads(schema.data.decode(errors="replace")), keys, ())


def _texts_below(
    node: object, keys: Collection[str], path: FieldPath
) -> Iterator[tuple[FieldPath, str]]:
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        if path and key.lower() in keys and isinstance(value, str):
            yield path, value
    properties = node.get("properties")
    for name, inner in properties.items() if isinstance(properties, dict) else ():
        yield from _texts_below(inner, keys, (*path, name))

"""Logs as MCAP: a topic a channel, a field of its messages the reading.

Messages are taken from the file in pieces of some megabytes, and each piece is decoded at once; of
a piece only the readings and time stamps stay. What cannot be taken at once is taken message by
message, by the `json` module or the format's own packages.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from pipeline.arrays import chosen_rows
from pipeline.config.logs import FieldPath, Logs, field_path, path_text
from pipeline.errors import LogError
from pipeline.ingest.assembly import Gathered, drop_bad_stamps, raw_log
from pipeline.ingest.contract import LogFile, RawChannel, RawLog, Reader, span
from pipeline.ingest.mcap.decoding import (
    Decoded,
    Decoder,
    Payloads,
    Wanted,
    has,
    leaves,
    no_field,
    number_of,
    payloads_of,
    stacked,
    value_at,
)
from pipeline.ingest.mcap.json import json_decoder, json_object
from pipeline.ingest.mcap.messages import NO_SCHEMA, Messages, read_messages, read_summary
from pipeline.ingest.mcap.protobuf import protobuf_decoder
from pipeline.ingest.time_stamps import TimeStamps, parse_numbers, place_in_zone

_PIECE = 2**20
_COST_OF_MESSAGE = 64
"""Bytes that a message takes while it is decoded, besides its payload."""

_MOST_NAMES = 40
_JSON = "json", "", "", b""


def _read(file: LogFile) -> RawLog:
    """Read the wanted topics of an MCAP file, chunked or not."""
    topics = _topics(file)
    for messages in read_messages(file.path):
        times = messages.times(_time_of_record(file.logs))
        for topic in topics:
            topic.take(messages, times)
    for topic in topics:
        topic.decode()
        topic.require_all(messages)  # the last piece knows all channels
    every = [topic.rows.stamps(file.logs.time_zone) for topic in topics]
    stamps, refused = drop_bad_stamps(file.path, every, _time_name(file.logs), file.latest_us)
    by_name: dict[str, RawChannel] = {}
    for topic, own in zip(topics, stamps, strict=True):
        by_name |= topic.raw_channels(own)
    rows = sum(int(np.count_nonzero(own.readable)) for own in stamps)
    refused = {reason.replace("row", "message", 1): n for reason, n in refused.items()}
    in_order: dict[str, RawChannel] = {name: by_name[name] for name in file.channels}
    return raw_log(in_order, rows, refused)


def _span(file: LogFile) -> tuple[int, int]:
    """Return first and last time stamp: of all messages by the summary, or else of those read."""
    statistics, logs = read_summary(file.path).statistics, file.logs
    if statistics and statistics.message_count and not logs.stamp and logs.time != "publish_time":
        log_times = np.array(
            [statistics.message_start_time, statistics.message_end_time], np.uint64
        )
        ends = place_in_zone(parse_numbers(log_times, "epoch_ns"), "UTC")
        # A single stamp may be wrong that the messages themselves would show to be so.
        if ends.readable.all() and (ends.time_us <= file.latest_us).all():
            return span(file.path, [ends.time_us])
    if logs.stamp:
        return span(file.path, _read(file).stamps())
    return span(file.path, _times_of_records(file))


def _topics(file: LogFile) -> list[_Topic]:
    names = dict.fromkeys(channel.source for channel in file.channels.values())
    return [_Topic(file, name) for name in names]


def _times_of_records(file: LogFile) -> list[NDArray[np.int64]]:
    """Return time stamps of the wanted messages, none of which is decoded."""
    topics, times_ns = _topics(file), list[NDArray[np.uint64]]()
    for messages in read_messages(file.path):
        times = messages.times(_time_of_record(file.logs))
        for topic in topics:
            topic.declare(messages)
            times_ns.append(times[messages.rows_of(topic.name)])
    for topic in topics:
        topic.require_all(messages)
    every = place_in_zone(parse_numbers(np.concatenate(times_ns), "epoch_ns"), "UTC")
    stamps, _ = drop_bad_stamps(file.path, [every], _time_name(file.logs), file.latest_us)
    return [own.time_us[own.readable] for own in stamps]


READER = Reader(_read, _span)


def _time_name(logs: Logs) -> str:
    if logs.stamp:
        return f"{logs.stamp!r} in format {logs.time_format}"
    return _time_of_record(logs)


def _time_of_record(logs: Logs) -> str:
    return "publish_time" if logs.time == "publish_time" else "log_time"


def decoder_of(path: Path, topic: str, encoding: str, schema: Schema, wanted: Wanted) -> Decoder:
    """Return decoder of the messages of a topic.

    Raises LogError: ``log_encoding``: messages in this encoding are not read; and as each decoder.
    """
    match encoding, schema.encoding:
        case ["json", _]:
            return json_decoder(wanted)
        case ["protobuf", "protobuf"]:
            return protobuf_decoder(path, topic, schema, wanted)
        case ["cdr", "ros2msg"]:
            # Imported where it is needed: most logs have no such messages.
            from pipeline.ingest.mcap.ros2 import ros2_decoder

            return ros2_decoder(path, topic, schema, wanted)
    raise LogError(
        "log_encoding",
        path,
        f"messages of topic {topic!r} are encoded as {encoding!r} with a schema in "
        f"{schema.encoding!r}; read are 'json', 'protobuf' with descriptors, and 'cdr' with "
        "'ros2msg'",
        topic,
    )


class _Topic:
    """What is wanted of the messages of a topic, gathered in the order of the file."""

    def __init__(self, file: LogFile, name: str) -> None:
        self.path, self.name = file.path, name
        self.channels = {
            key: channel for key, channel in file.channels.items() if channel.source == name
        }
        logs = file.logs
        fields = {
            key: field_path(channel.field or logs.value_column, name)
            for key, channel in self.channels.items()
        }
        self.qualities = {
            channel.quality_source: field_path(channel.quality_source, name)
            for channel in self.channels.values()
            if channel.quality_source
        }
        self.wanted = Wanted(
            tuple(dict.fromkeys(fields.values())),
            tuple(dict.fromkeys(self.qualities.values())),
            field_path(logs.stamp) if logs.stamp else None,
            logs.time_format if logs.stamp else "epoch_ns",
        )
        self.unseen = [*self.wanted.readings, *self.wanted.qualities]
        self.first = b""  # message
        self.rows = Gathered(file.path, self.channels, fields)
        self.known = 0  # channels that the file has declared so far
        self.kind: tuple[str, str, str, bytes] | None = None  # encoding and schema
        self.decoder: Decoder | None = None
        self.held: list[Payloads] = []

    def take(self, messages: Messages, times: NDArray[np.uint64]) -> None:
        """Take its messages of a piece of the file, whose messages have these times."""
        self.declare(messages)
        rows = messages.rows_of(self.name)
        if rows.size:
            self.held.append(payloads_of(messages, rows, times))
            held = (
                payloads.text.size + _COST_OF_MESSAGE * payloads.length.size
                for payloads in self.held
            )
            if sum(held) >= _PIECE:
                self.decode()

    def declare(self, messages: Messages) -> None:
        """Know how its messages are read, by what a piece of the file declares."""
        if len(messages.channels) != self.known:
            self.known = len(messages.channels)
            for channel in messages.channels.values():
                if channel.topic == self.name:
                    self._set_kind(messages, channel)

    def _set_kind(self, messages: Messages, channel: Channel) -> None:
        """Know how its messages are read; several channels may have them, all of the same kind."""
        schema, encoding = (
            messages.schemas.get(channel.schema_id, NO_SCHEMA),
            channel.message_encoding,
        )
        kind = encoding, schema.name, schema.encoding, schema.data
        # Of JSON, the schema is not looked at.
        kind = _JSON if encoding == "json" else kind
        if self.kind is None:
            self.kind = kind
            self.decoder = decoder_of(self.path, self.name, encoding, schema, self.wanted)
        elif self.kind != kind:
            how = f"messages of topic {self.name!r} are of two kinds: have a topic for each"
            raise LogError("log_encoding", self.path, how, self.name)

    def decode(self) -> None:
        """Add the rows of what is held."""
        if self.decoder is None or not self.held:
            return
        payloads, self.held = stacked(self.held), []
        decoded = self.decoder.decode(payloads)
        stamps = decoded.stamps
        if stamps is None:
            stamps = parse_numbers(payloads.time_ns, "epoch_ns")
        qualities = {quality: decoded.qualities[path] for quality, path in self.qualities.items()}
        self.rows.add(stamps, decoded.fields, qualities)
        self.first = self.first or payloads.first
        self.unseen = [path for path in self.unseen if not _has_any(decoded, path)]

    def require_all(self, last: Messages) -> None:
        """Refuse a topic that no channel has, and a field that no message has."""
        if self.kind is None:
            topics = sorted({channel.topic for channel in last.channels.values()})[:_MOST_NAMES]
            how = f"no topic {self.name!r}; there are {', '.join(map(repr, topics))}"
            raise LogError("log_column_missing", self.path, how)
        # Elsewhere, a schema has reported which fields there are.
        first = json_object(self.first) or {}
        lost = [path for path in self.unseen if not has(first, path)]
        if lost and self.first and self.kind == _JSON:
            there = sorted({path_text(path) for path, _ in leaves(first)})
            raise no_field(self.path, self.name, lost[0], there)

    def raw_channels(self, stamps: TimeStamps) -> dict[str, RawChannel]:
        """Return its channels at these stamps; the readings are given up."""
        rows = chosen_rows(stamps.readable)
        return self.rows.channels_at(dict.fromkeys(self.channels, (rows, stamps.time_us[rows])))


def _has_any(decoded: Decoded, path: FieldPath) -> bool:
    """Return True if a message has a value in a field."""
    field, quality = decoded.fields.get(path), decoded.qualities.get(path)
    if field is not None and (field.unparsed | ~field.missing).any():
        return True
    return quality is not None and quality.null_count < len(quality)


# Topics, with the figures of their first messages

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
    """Return all topics of a file, by name, those without a message too.

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
    """Yield units of fields: of a JSON schema by their own key, of ROS 2 in a remark."""
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

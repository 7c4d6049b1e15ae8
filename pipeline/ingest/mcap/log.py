"""Logs as MCAP: a topic a channel, a field of its messages the reading.

Messages are taken from the file in pieces of some megabytes, and each piece is decoded at once; of
a piece only the readings and time stamps are kept. What cannot be taken at once is taken message by
message, by the `json` module or the format's own packages.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.arrays import Rows, chosen_rows
from pipeline.config.channels import Channel, QualityValue
from pipeline.config.field_paths import FieldPath, field_path, path_text
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest.assembly import converted, judged, raw_channel, raw_log, span
from pipeline.ingest.contract import LogFile, RawChannel, RawLog
from pipeline.ingest.gathering import GatheredReadings, GatheredStamps
from pipeline.ingest.mcap.decoding import (
    Decoded,
    Decoder,
    Payloads,
    Wanted,
    has,
    leaves,
    payloads_of,
    stacked,
)
from pipeline.ingest.mcap.json import json_decoder, json_object
from pipeline.ingest.mcap.layout import NO_SCHEMA, ChannelRecord, Schema
from pipeline.ingest.mcap.messages import Messages, read_messages, summary_of
from pipeline.ingest.mcap.protobuf import protobuf_decoder
from pipeline.ingest.mcap.ros2 import ros2_decoder
from pipeline.ingest.quality import BLANK, quality_states
from pipeline.ingest.time_stamps import WrittenStamps, from_epoch, placed, written_as_numbers
from pipeline.ingest.wall_clock import TimeStamps

_PIECE = 2**20
_COST_OF_MESSAGE = 64
"""Bytes that a message takes while it is decoded, besides its payload."""

_MOST_NAMES = 40

_Quality = tuple[FieldPath, tuple[QualityValue, ...]]
"""A field of qualities, and what is good there."""


def read_mcap_log(file: LogFile) -> RawLog:
    """Read the wanted topics of an MCAP file, chunked or not."""
    path, logs = file.path, file.logs
    names = dict.fromkeys(channel.source for channel in file.channels.values())
    topics = [_Topic(file, name) for name in names]
    reading = _Reading(path, logs, topics)
    for messages in read_messages(path, salvage=logs.salvage):
        reading.add(messages)
    reading.finish(messages)
    stamps, refused = judged(
        path, [topic.stamps() for topic in topics], _time_name(logs), file.latest_us
    )
    found: dict[str, RawChannel] = {}
    for topic, of_topic in zip(topics, stamps, strict=True):
        found |= topic.channels(of_topic)
    in_order: dict[str, RawChannel] = {name: found[name] for name in file.channels}
    rows = sum(int(np.count_nonzero(of_topic.readable)) for of_topic in stamps)
    refused = {reason.replace("row", "message", 1): n for reason, n in refused.items()}
    return raw_log(in_order, rows, refused, [messages.loss] if messages.loss else [])


def mcap_time_span(file: LogFile) -> tuple[int, int]:
    """First and last time stamp of all messages, from the summary or else from the messages.

    Where the stamps stand within the messages, only those of the wanted topics are looked at, and
    the file is read.
    """
    path, logs, latest_us = file.path, file.logs, file.latest_us
    if logs.stamp:
        return span(path, read_mcap_log(file).stamps())
    summary_span = None if logs.time == "publish_time" else _summary_span(path, logs, latest_us)
    if summary_span is not None:
        return summary_span
    pieces = read_messages(path, salvage=logs.salvage)
    times = np.concatenate([messages.times(_time_of_record(logs)) for messages in pieces])
    (stamps,), _ = judged(path, [from_epoch(times, "epoch_ns")], _time_name(logs), latest_us)
    return span(path, [stamps.time_us[stamps.readable]])


def _summary_span(path: Path, logs: Logs, latest_us: int | None) -> tuple[int, int] | None:
    """Span that the summary states, if it does."""
    statistics = summary_of(path, salvage=logs.salvage)[0].statistics
    if statistics is None or not statistics.message_count:
        return None
    log_times = [statistics.first_log_time, statistics.last_log_time]
    stamps = from_epoch(np.array(log_times, dtype=np.uint64), "epoch_ns")
    try:
        (good,), refused = judged(path, [stamps], _time_name(logs), latest_us)
    except LogError:
        return None  # The messages themselves say how many of them have no good time.
    # A single stamp may be wrong that the messages themselves would show to be so.
    whole = good.readable.all() and not any(refused.values())
    return span(path, [stamps.time_us]) if whole else None


def _time_name(logs: Logs) -> str:
    if logs.stamp:
        return f"{logs.stamp!r} in format {logs.time_format}"
    return _time_of_record(logs)


def _time_of_record(logs: Logs) -> str:
    return "publish_time" if logs.time == "publish_time" else "log_time"


def decoder_of(path: Path, channel: ChannelRecord, schema: Schema, wanted: Wanted) -> Decoder:
    """Decoder of the messages of a channel record.

    Raises
    ------
    LogError
        ``log_encoding``: messages in this encoding are not read; and as each decoder.
    """
    match channel.encoding, schema.encoding:
        case "json", _:
            return json_decoder(wanted)
        case "protobuf", "protobuf":
            return protobuf_decoder(path, channel.topic, schema, wanted)
        case "cdr", "ros2msg":
            return ros2_decoder(path, channel.topic, schema, wanted)
    raise LogError(
        "log_encoding",
        path,
        f"messages of topic {channel.topic!r} are encoded as {channel.encoding!r} with a schema in "
        f"{schema.encoding!r}; read are 'json', 'protobuf' with descriptors, and 'cdr' with "
        "'ros2msg'",
        channel.topic,
    )


class _Reading:
    """Takes the messages of a file piece by piece, and decodes those of some topics.

    Messages of topics that have encoding, schema and fields in common are decoded together.
    """

    def __init__(self, path: Path, logs: Logs, topics: Sequence[_Topic]) -> None:
        self.path = path
        self.topics = topics
        self.time = _time_of_record(logs)
        self.decoders: dict[tuple[str, Schema, Wanted], Decoder] = {}
        # Number of topic and decoder by channel id; -1 for what is not wanted.
        self.topic_of = np.full(2**16, -1, np.int16)
        self.decoder_of = np.full(2**16, -1, np.int16)
        self.known = 0  # channels that the file has declared so far
        self.in_turn = False  # some topic has messages of more than one decoder
        self.held: dict[int, list[Payloads]] = {}

    def add(self, messages: Messages) -> None:
        """Add the messages of a piece."""
        if len(messages.channels) != self.known:
            self._know(messages)
        if not messages.start.size:
            return
        topic, times = self.topic_of.take(messages.channel_id), messages.times(self.time)
        for number, rows in self._runs(self.decoder_of.take(messages.channel_id)):
            # Messages of one topic keep their order, whatever decodes them.
            for other in [other for other in self.held if self.in_turn and other != number]:
                self._decode(other)
            held = self.held.setdefault(number, [])
            held.append(payloads_of(messages, rows, topic, times))
            if sum(one.text.size + _COST_OF_MESSAGE * one.start.size for one in held) >= _PIECE:
                self._decode(number)

    def _know(self, messages: Messages) -> None:
        """Know the channels that the file has declared so far."""
        self.known = len(messages.channels)
        for channel_id, channel in messages.channels.items():
            for number, topic in enumerate(self.topics):
                if channel.topic == topic.name:
                    schema = messages.schemas.get(channel.schema_id, NO_SCHEMA)
                    # Of JSON, the schema is not looked at.
                    own = NO_SCHEMA if channel.encoding == "json" else schema
                    key = channel.encoding, own, topic.wanted
                    if key not in self.decoders:
                        made = decoder_of(self.path, channel, schema, topic.wanted)
                        self.decoders[key] = made
                    self.topic_of[channel_id] = number
                    self.decoder_of[channel_id] = list(self.decoders).index(key)
                    topic.encodings.add(channel.encoding)
        pairs = set(zip(self.topic_of.tolist(), self.decoder_of.tolist(), strict=True))
        self.in_turn = len(pairs) > len({topic for topic, _ in pairs})

    def _runs(self, numbers: NDArray[np.int16]) -> Iterator[tuple[int, Rows]]:
        """Messages of each decoder; where they take turns, each stretch of them by itself."""
        if self.in_turn:
            edges = np.flatnonzero(np.diff(numbers)) + 1
            for stretch in np.split(np.arange(numbers.size), edges):
                if numbers[stretch[0]] >= 0:
                    yield int(numbers[stretch[0]]), stretch
            return
        for number in range(int(numbers.max(initial=-1)) + 1):
            chosen = numbers == number
            if chosen.any():
                yield number, chosen_rows(chosen)

    def _decode(self, number: int) -> None:
        payloads = stacked(self.held.pop(number))
        decoded = list(self.decoders.values())[number].decode(payloads)
        stamps = decoded.stamps
        if stamps is None:
            stamps = written_as_numbers(payloads.time_ns, "epoch_ns")
        for of_topic, topic in enumerate(self.topics):
            rows = np.flatnonzero(payloads.topic == of_topic)
            if rows.size:
                topic.add(decoded, stamps, rows)

    def finish(self, last: Messages) -> None:
        """Decode what is left; refuse a topic that no channel has, and fields that no message has.

        The last piece of a file knows all channels.
        """
        for number in list(self.held):
            self._decode(number)
        there = ", ".join(
            map(repr, sorted({one.topic for one in last.channels.values()})[:_MOST_NAMES])
        )
        for topic in self.topics:
            if not topic.encodings:
                how = f"no topic {topic.name!r}; there are {there}"
                raise LogError("log_column_missing", self.path, how)
            topic.require_fields()


class _Topic:
    """What is wanted of the messages of one topic, gathered in the order of the file."""

    def __init__(self, file: LogFile, name: str) -> None:
        self.file = file
        self.name = name
        self.own = {key: one for key, one in file.channels.items() if one.source == name}
        qualities = (_quality_of(one) for one in self.own.values() if one.quality_source)
        self.states: dict[_Quality, list[NDArray[np.uint8]]] = {one: [] for one in qualities}
        readings = dict.fromkeys(field_path(one.field, name) for one in self.own.values())
        self.readings = {one: GatheredReadings() for one in readings}
        logs = file.logs
        self.wanted = Wanted(
            tuple(readings),
            tuple(dict.fromkeys(quality for quality, _ in self.states)),
            field_path(logs.stamp) if logs.stamp else None,
            logs.time_format if logs.stamp else "epoch_ns",
        )
        self.written = GatheredStamps()
        self.encodings: set[str] = set()

    def add(self, decoded: Decoded, stamps: WrittenStamps, rows: NDArray[np.intp]) -> None:
        """Add its rows of what was decoded."""
        own = WrittenStamps(stamps.time_us.take(rows), stamps.kind.take(rows), stamps.example)
        self.written.add(own)
        for one, readings in self.readings.items():
            readings.add(decoded.fields[one].rows(rows))
        for (one, good), states in self.states.items():
            cells = decoded.qualities[one].take(pa.array(rows))
            states.append(quality_states(self.file.path, path_text(one), cells, good))

    def require_fields(self) -> None:
        """Refuse a field that no message has."""
        for one, parts in self.readings.items():
            if parts.has_none:
                self._require_field(one)
        for (one, _), states in self.states.items():
            if states and all((part == BLANK).all() for part in states):
                self._require_field(one)

    def _require_field(self, field: FieldPath) -> None:
        """Refuse a field that no message has; one that is null is a missing sample.

        Messages that have a schema are left out: it has told which fields there are.
        """
        if self.encodings != {"json"}:
            return
        there: dict[str, None] = {}
        for messages in read_messages(self.file.path, salvage=self.file.logs.salvage):
            ids = [i for i, channel in messages.channels.items() if channel.topic == self.name]
            for i in np.flatnonzero(np.isin(messages.channel_id, ids)).tolist():
                payload = messages.buffer[messages.payload_start[i] : messages.payload_end[i]]
                message = json_object(bytes(payload)) or {}
                if has(message, field):
                    return
                if len(there) < _MOST_NAMES:
                    there |= dict.fromkeys(path_text(one) for one, _ in leaves(message))
        names = ", ".join(map(repr, sorted(there)[:_MOST_NAMES]))
        raise LogError(
            "log_column_missing",
            self.file.path,
            f"no message of topic {self.name!r} has a field {path_text(field)!r}; "
            f"there are {names}",
            self.name,
        )

    def stamps(self) -> TimeStamps:
        """Stamps of all messages, in UTC; they are given up."""
        return placed(self.written.taken(), self.file.logs.time_zone)

    def channels(self, stamps: TimeStamps) -> dict[str, RawChannel]:
        """Its channels at these stamps; the readings are given up."""
        kept = chosen_rows(stamps.readable)
        time_us = stamps.time_us[kept]
        states = {
            quality: np.concatenate([np.empty(0, np.uint8), *parts])[kept]
            for quality, parts in self.states.items()
        }
        found: dict[str, RawChannel] = {}
        for one in self.wanted.readings:
            # The columns are given up, so that a long log is not held twice.
            readings = self.readings.pop(one).taken().rows(kept)
            for name, channel in self.own.items():
                if field_path(channel.field, self.name) == one:
                    own = converted(name, channel, readings)
                    quality = states.get(_quality_of(channel))
                    found[name] = raw_channel(self.file.path, name, channel, time_us, own, quality)
        return found


def _quality_of(channel: Channel) -> _Quality:
    """Path of a channel's quality, and what is good there."""
    named = channel.quality_source
    return field_path(named, channel.source) if named else (), channel.quality_good

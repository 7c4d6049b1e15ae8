"""Logs as MCAP: a topic a channel, a field of its messages the reading.

Messages are taken from the file in pieces of some megabytes, and each piece is decoded at once; of
a piece only the readings and time stamps are kept. What cannot be taken at once is taken message by
message, by the `json` module or Protobuf's runtime; messages of ROS 2 need no second way. The
format's own reader is the oracle in the tests, which list what only that lets through.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.arrays import Rows, chosen_rows
from pipeline.config.channels import Channel, Channels, QualityValue
from pipeline.config.field_paths import FieldPath, field_path, path_text
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest.assembly import converted, judged, raw_channel, raw_log, span
from pipeline.ingest.contract import LogFile, RawChannel, RawLog
from pipeline.ingest.gathering import GatheredReadings, GatheredStamps
from pipeline.ingest.mcap.cdr import ROS2_LANGUAGES, cdr_decoder
from pipeline.ingest.mcap.json import json_decoder, require_json_field
from pipeline.ingest.mcap.layout import ChannelRecord, Schema
from pipeline.ingest.mcap.messages import Messages, read_messages, summary_of
from pipeline.ingest.mcap.payloads import Decoded, Decoder, Payloads, payloads_of, stacked
from pipeline.ingest.mcap.protobuf import protobuf_decoder
from pipeline.ingest.quality import BLANK, quality_states
from pipeline.ingest.time_stamps import WrittenStamps, from_epoch, placed, written_as_numbers

_PIECE = 2**20
_COST_OF_MESSAGE = 64
"""Bytes that a message takes while it is decoded, besides its payload."""

_NO_SCHEMA = Schema("", "", b"")
_ENCODINGS = {("protobuf", "protobuf"), *(("cdr", language) for language in ROS2_LANGUAGES)}

_Quality = tuple[FieldPath, tuple[QualityValue, ...]]
"""A field of qualities, and what is good there."""


class _Fields(NamedTuple):
    """Wanted fields of each message of a topic: readings, and what it says of them."""

    readings: tuple[FieldPath, ...]
    qualities: tuple[_Quality, ...]


_Wanted = Mapping[str, _Fields]
"""Fields by topic."""

_Key = tuple[str, Schema, _Fields]
"""Encoding, schema and fields: what messages have to share to be decoded together."""


@dataclass(frozen=True, slots=True)
class _Parts:
    """The messages of one topic, in the order of the file."""

    stamps: GatheredStamps
    fields: dict[FieldPath, GatheredReadings]
    states: dict[_Quality, list[NDArray[np.uint8]]]


@dataclass(slots=True)
class _Decoders:
    """Topic and decoder by channel id; -1 for what is not wanted."""

    topic: NDArray[np.int16]
    number: NDArray[np.int16]
    by_key: dict[_Key, Decoder] = field(default_factory=dict)


def read_mcap_log(file: LogFile) -> RawLog:
    """Read the wanted topics of an MCAP file, chunked or not."""
    path, logs, channels = file.path, file.logs, file.channels
    wanted = _wanted(channels)
    content, loss = _content(path, logs, wanted)
    placed_stamps = [placed(parts.stamps.taken(), logs.time_zone) for parts in content.values()]
    stamps, refused = judged(path, placed_stamps, _time_name(logs), file.latest_us)
    del placed_stamps
    found: dict[str, RawChannel] = {}
    rows = 0
    for (topic, fields), judged_stamps in zip(wanted.items(), stamps, strict=True):
        kept = chosen_rows(judged_stamps.readable)
        time_us = judged_stamps.time_us[kept]
        rows += time_us.size
        states = _states(path, logs, topic, content[topic], kept)
        for one in fields.readings:
            # The columns are given up, so that a long log is not held twice.
            readings = content[topic].fields.pop(one).taken().rows(kept)
            if readings.missing.size and readings.missing.all() and not readings.unparsed.any():
                _require_field(path, logs, topic, one)
            found |= {
                name: raw_channel(
                    path,
                    name,
                    channel,
                    time_us,
                    converted(name, channel, readings),
                    states.get(_quality_of(channel)),
                )
                for name, channel in channels.items()
                if channel.source == topic and field_path(channel.field, topic) == one
            }
    in_order: dict[str, RawChannel] = {name: found[name] for name in channels}
    refused = {reason.replace("row", "message", 1): n for reason, n in refused.items()}
    return raw_log(in_order, rows, refused, [loss] if loss else [])


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


def _wanted(channels: Channels) -> _Wanted:
    topics = dict.fromkeys(channel.source for channel in channels.values())
    return {topic: _fields(channels, topic) for topic in topics}


def _fields(channels: Channels, topic: str) -> _Fields:
    own = [channel for channel in channels.values() if channel.source == topic]
    readings = dict.fromkeys(field_path(channel.field, topic) for channel in own)
    qualities = dict.fromkeys(_quality_of(channel) for channel in own if channel.quality_source)
    return _Fields(tuple(readings), tuple(qualities))


def _quality_of(channel: Channel) -> _Quality:
    """Path of a channel's quality, and what is good there."""
    named = channel.quality_source
    return field_path(named, channel.source) if named else (), channel.quality_good


def _states(
    path: Path, logs: Logs, topic: str, parts: _Parts, kept: Rows
) -> dict[_Quality, NDArray[np.uint8]]:
    """The qualities of a topic's messages with a good time."""
    found: dict[_Quality, NDArray[np.uint8]] = {}
    for quality, pieces in parts.states.items():
        states = np.concatenate([np.empty(0, np.uint8), *pieces])
        if states.size and (states == BLANK).all():
            _require_field(path, logs, topic, quality[0])
        found[quality] = states[kept]
    return found


def _content(path: Path, logs: Logs, wanted: _Wanted) -> tuple[dict[str, _Parts], str]:
    """Messages by topic, and what was lost to damage, in words."""
    names = tuple(wanted)
    summary, _ = summary_of(path, salvage=logs.salvage)
    content = {
        name: _no_parts(fields, summary.stated_count(name) or 0) for name, fields in wanted.items()
    }
    decoders = _Decoders(np.empty(0, np.int16), np.empty(0, np.int16))
    known = -1
    held: dict[int, list[Payloads]] = {}
    for messages in read_messages(path, salvage=logs.salvage):
        if len(messages.channels) != known:
            _add_decoders(path, logs, wanted, messages, decoders)
            known = len(messages.channels)
            in_turn = _is_shared(decoders)
        if not messages.start.size:
            continue
        topic = decoders.topic.take(messages.channel_id)
        times = messages.times(_time_of_record(logs))
        for number, chosen in _runs(decoders.number.take(messages.channel_id), in_turn=in_turn):
            # Messages of one topic keep their order, whatever decodes them.
            for other in [other for other in held if in_turn and other != number]:
                _decode(path, decoders, other, held.pop(other), names, content)
            stretches = held.setdefault(number, [])
            stretches.append(payloads_of(messages, chosen, topic, times))
            size = sum(one.text.size + _COST_OF_MESSAGE * one.start.size for one in stretches)
            if size >= _PIECE:
                _decode(path, decoders, number, held.pop(number), names, content)
    for number, stretches in held.items():
        _decode(path, decoders, number, stretches, names, content)
    _require_topics(path, wanted, messages)
    return content, messages.loss


def _no_parts(fields: _Fields, expected: int) -> _Parts:
    return _Parts(
        GatheredStamps(expected),
        {one: GatheredReadings(expected=expected) for one in fields.readings},
        {one: [] for one in fields.qualities},
    )


def _runs(numbers: NDArray[np.int16], *, in_turn: bool) -> Iterator[tuple[int, Rows]]:
    """Messages of each decoder; `in_turn`, each stretch of them by itself."""
    if in_turn:
        edges = np.flatnonzero(np.diff(numbers)) + 1
        for stretch in np.split(np.arange(numbers.size), edges):
            if stretch.size and numbers[stretch[0]] >= 0:
                yield int(numbers[stretch[0]]), stretch
        return
    for number in range(int(numbers.max(initial=-1)) + 1):
        chosen = numbers == number
        if chosen.any():
            yield number, chosen_rows(chosen)


def _is_shared(decoders: _Decoders) -> bool:
    """True if some topic has messages of more than one decoder."""
    pairs = set(zip(decoders.topic.tolist(), decoders.number.tolist(), strict=True))
    return len(pairs) > len({topic for topic, _ in pairs})


def _decode(
    path: Path,
    decoders: _Decoders,
    number: int,
    stretches: Sequence[Payloads],
    names: Sequence[str],
    content: Mapping[str, _Parts],
) -> None:
    payloads = stacked(stretches)
    decoded = list(decoders.by_key.values())[number](payloads)
    stamps = decoded.stamps
    if stamps is None:
        stamps = written_as_numbers(payloads.time_ns, "epoch_ns")
    for topic, name in enumerate(names):
        rows = np.flatnonzero(payloads.topic == topic)
        if not rows.size:
            continue
        parts = content[name]
        parts.stamps.add(
            WrittenStamps(stamps.time_us.take(rows), stamps.kind.take(rows), stamps.example)
        )
        for one, column in parts.fields.items():
            column.add(decoded.fields[one].rows(rows))
        for (one, good), states in parts.states.items():
            cells = _cells(decoded, one).take(pa.array(rows))
            states.append(quality_states(path, path_text(one), cells, good))


def _cells(decoded: Decoded, quality: FieldPath) -> pa.Array:
    if quality in decoded.qualities:
        return decoded.qualities[quality]
    readings = decoded.fields[quality]
    return pa.array(readings.raw, mask=readings.missing)


def _add_decoders(
    path: Path, logs: Logs, wanted: _Wanted, messages: Messages, decoders: _Decoders
) -> None:
    """Know the channels that a file has declared so far."""
    names = list(wanted)
    size = max(messages.channels, default=0) + 1
    decoders.topic = np.full(size, -1, np.int16)
    decoders.number = np.full(size, -1, np.int16)
    for channel_id, channel in messages.channels.items():
        fields = wanted.get(channel.topic)
        if fields is None:
            continue
        key = _key(path, channel, messages.schemas, fields)
        if key not in decoders.by_key:
            decoders.by_key[key] = _decoder(path, logs, channel.topic, key)
        decoders.topic[channel_id] = names.index(channel.topic)
        decoders.number[channel_id] = list(decoders.by_key).index(key)


def _key(
    path: Path, channel: ChannelRecord, schemas: Mapping[int, Schema], fields: _Fields
) -> _Key:
    if channel.encoding == "json":
        return channel.encoding, _NO_SCHEMA, fields
    schema = schemas.get(channel.schema_id, _NO_SCHEMA)
    if (channel.encoding, schema.encoding) not in _ENCODINGS:
        raise LogError(
            "log_encoding",
            path,
            f"messages of topic {channel.topic!r} are encoded as {channel.encoding!r} with a "
            f"schema in {schema.encoding!r}; read are 'json', 'protobuf' with descriptors, and "
            "'cdr' with 'ros2msg' or 'ros2idl'",
            channel.topic,
        )
    return channel.encoding, schema, fields


def _decoder(path: Path, logs: Logs, topic: str, key: _Key) -> Decoder:
    encoding, schema, fields = key
    stamp = field_path(logs.stamp) if logs.stamp else None
    qualities = tuple(dict.fromkeys(one for one, _ in fields.qualities))
    if encoding == "json":
        return json_decoder(fields.readings, stamp, logs.time_format, qualities)
    made = cdr_decoder if encoding == "cdr" else protobuf_decoder
    numbers = tuple(dict.fromkeys((*fields.readings, *qualities)))
    return made(path, topic, schema, numbers, stamp, logs.time_format)


def _require_topics(path: Path, wanted: _Wanted, last: Messages) -> None:
    """Refuse a topic that no channel has; the last piece of a file knows all channels."""
    topics = sorted({one.topic for one in last.channels.values()})
    for name in wanted:
        if name not in topics:
            there = ", ".join(map(repr, topics[:40]))
            raise LogError("log_column_missing", path, f"no topic {name!r}; there are {there}")


def _require_field(path: Path, logs: Logs, topic: str, one: FieldPath) -> None:
    """Refuse a field that no JSON message has; other encodings have said so from the schema."""
    for messages in read_messages(path, salvage=logs.salvage):
        channels = [c for c in messages.channels.values() if c.topic == topic]
    if all(channel.encoding == "json" for channel in channels):
        require_json_field(path, topic, one, salvage=logs.salvage)

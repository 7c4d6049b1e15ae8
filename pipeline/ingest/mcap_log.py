"""Logs as MCAP with JSON messages: a topic a channel, a key of the message its reading.

The payloads of many messages are laid out as lines and parsed at once. Where a piece does not come
out as one object a line, it is parsed message by message, so that what is no number is found and
counted.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json as arrow_json
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings, raw_channel, raw_log, require_time, span
from pipeline.ingest.contract import ChannelSource, LogSource, RawLog
from pipeline.ingest.mcap_layout import Channel, read_summary
from pipeline.ingest.mcap_messages import Messages, read_messages
from pipeline.ingest.time_stamps import from_epoch

_PIECE = 8 * 2**20
_NEWLINE = 10


@dataclass(frozen=True, slots=True)
class _Lines:
    """Payloads of the wanted topics, one a line, in the order of the file."""

    text: NDArray[np.uint8]
    length: NDArray[np.int64]
    topic: NDArray[np.int16]
    time_ns: NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class _Parsed:
    """Readings of each wanted field in the messages of all wanted topics."""

    topic: NDArray[np.int16]
    time_ns: NDArray[np.uint64]
    fields: Mapping[str, Readings]


def read_mcap_log(path: Path, source: LogSource) -> RawLog:
    """Read the wanted topics of an MCAP file, chunked or not.

    Parameters
    ----------
    path
        An existing file.
    source
        Its topics and fields.

    Raises
    ------
    LogError
        As listed in `pipeline.ingest.contract`.
    """
    topics = tuple(dict.fromkeys(channel.source for channel in source.channels))
    fields = tuple(dict.fromkeys(channel.field for channel in source.channels))
    pieces = _pieces(_wanted_lines(path, topics, source.time_source))
    whole = _joined([_parse(piece, fields) for piece in pieces], fields)
    stamps = from_epoch(whole.time_ns, "epoch_ns")
    without_time = require_time(path, stamps, _time_name(source))
    channels = {}
    for channel in source.channels:
        chosen = (whole.topic == topics.index(channel.source)) & stamps.readable
        readings = whole.fields[channel.field].rows(chosen)
        if chosen.any() and readings.missing.all() and not readings.unparsed.any():
            _require_field(path, channel)
        channels[channel.channel] = raw_channel(path, channel, stamps.time_us[chosen], readings)
    refused = {"messages without a readable time": without_time}
    return raw_log(channels, stamps.readable.size - without_time, refused)


def mcap_time_span(path: Path, source: LogSource) -> tuple[int, int]:
    """First and last time stamp of all messages, from the summary or else from the messages.

    Raises
    ------
    LogError
        As `read_mcap_log`; ``log_empty`` where there is no message.
    """
    with path.open("rb") as file:
        statistics = read_summary(path, file).statistics
    if statistics and statistics.message_count and _time_name(source) == "log_time":
        log_times = [statistics.first_log_time, statistics.last_log_time]
        stamps = from_epoch(np.array(log_times, dtype=np.uint64), "epoch_ns")
        if stamps.readable.all():
            return span(path, [stamps.time_us])
    times = [_times(messages, source.time_source) for messages in read_messages(path)]
    stamps = from_epoch(np.concatenate(times), "epoch_ns")
    require_time(path, stamps, _time_name(source))
    return span(path, [stamps.time_us[stamps.readable]])


def _time_name(source: LogSource) -> str:
    return "publish_time" if source.time_source == "publish_time" else "log_time"


def _times(messages: Messages, time_source: str) -> NDArray[np.uint64]:
    return messages.publish_time if time_source == "publish_time" else messages.log_time


def _wanted_lines(path: Path, topics: Sequence[str], time_source: str) -> Iterator[_Lines]:
    channels: Mapping[int, Channel] = {}
    topic_by_channel_id = np.empty(0, np.int16)
    known = -1
    for messages in read_messages(path):
        channels = messages.channels
        if len(channels) != known:
            topic_by_channel_id = _topic_by_channel_id(path, channels, topics)
            known = len(channels)
        topic = topic_by_channel_id[messages.channel_id]
        wanted = topic >= 0
        if wanted.any():
            starts, ends = messages.payload_start[wanted], messages.payload_end[wanted]
            yield _Lines(
                text=_as_lines(messages.buffer, starts, ends),
                length=ends - starts,
                topic=topic[wanted],
                time_ns=_times(messages, time_source)[wanted],
            )
    there = sorted({channel.topic for channel in channels.values()})
    for name in topics:
        if name not in there:
            raise LogError(
                "log_column_missing",
                path,
                f"no topic {name!r}; there are " + ", ".join(map(repr, there[:40])),
            )


def _topic_by_channel_id(
    path: Path, channels: Mapping[int, Channel], topics: Sequence[str]
) -> NDArray[np.int16]:
    """Position in `topics` by channel id, -1 for what is not wanted."""
    table = np.full(max(channels, default=0) + 1, -1, dtype=np.int16)
    for channel_id, channel in channels.items():
        if channel.topic not in topics:
            continue
        if channel.encoding != "json":
            raise LogError(
                "log_encoding",
                path,
                f"messages of topic {channel.topic!r} are encoded as {channel.encoding!r}, and "
                "only 'json' is read",
                channel.topic,
            )
        table[channel_id] = topics.index(channel.topic)
    return table


def _as_lines(
    buffer: memoryview, starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """The payloads from `starts` to `ends`, each with a newline behind it."""
    text = np.empty(len(buffer) + 1, dtype=np.uint8)
    text[:-1] = np.frombuffer(buffer, np.uint8)
    # Behind a payload is the head of the next record, or the end: room for the newline.
    text[ends] = _NEWLINE
    edges = np.empty(2 * starts.size + 2, dtype=np.int64)
    edges[0], edges[1:-1:2], edges[2:-1:2], edges[-1] = 0, starts, ends + 1, text.size
    inside = np.zeros(edges.size - 1, dtype=np.bool_)
    inside[1::2] = True
    return text[np.repeat(inside, np.diff(edges))]


def _pieces(lines: Iterator[_Lines]) -> Iterator[_Lines]:
    """Fewer and longer stretches: a call of the parser has its cost, and so has memory."""
    held: list[_Lines] = []
    size = 0
    for stretch in lines:
        held.append(stretch)
        size += stretch.text.size
        if size >= _PIECE:
            yield _stacked(held)
            held, size = [], 0
    if held:
        yield _stacked(held)


def _stacked(parts: Sequence[_Lines]) -> _Lines:
    return _Lines(
        text=np.concatenate([part.text for part in parts]),
        length=np.concatenate([part.length for part in parts]),
        topic=np.concatenate([part.topic for part in parts]),
        time_ns=np.concatenate([part.time_ns for part in parts]),
    )


def _parse(lines: _Lines, fields: Sequence[str]) -> _Parsed:
    starts = np.cumsum(lines.length + 1) - (lines.length + 1)
    readings = _parse_at_once(lines, starts, fields)
    if readings is None:
        readings = _parse_one_by_one(lines, starts, fields)
    return _Parsed(lines.topic, lines.time_ns, readings)


def _parse_at_once(
    lines: _Lines, starts: NDArray[np.int64], fields: Sequence[str]
) -> dict[str, Readings] | None:
    """Readings, where every line is one object and every wanted value a number or null; else
    None."""
    # The parser takes objects, not lines: without this, an object begun in one message and ended in
    # the next would go through.
    first, last = lines.text[starts], lines.text[starts + lines.length - 1]
    if not ((first == ord("{")).all() and (last == ord("}")).all()):
        return None
    try:
        table = arrow_json.read_json(
            pa.BufferReader(pa.py_buffer(lines.text)),
            read_options=arrow_json.ReadOptions(block_size=max(2**20, 2 * int(lines.length.max()))),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=pa.schema([(field, pa.float64()) for field in fields]),
                unexpected_field_behavior="ignore",
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    if table.num_rows != starts.size:
        return None
    return {field: _readings(table.column(field)) for field in fields}


def _readings(column: pa.ChunkedArray) -> Readings:
    missing = column.is_null().to_numpy()
    raw: NDArray[np.float64] = pc.fill_null(column, np.nan).to_numpy()
    return Readings(raw, missing, np.zeros(missing.size, dtype=np.bool_))


def _parse_one_by_one(
    lines: _Lines, starts: NDArray[np.int64], fields: Sequence[str]
) -> dict[str, Readings]:
    raw = {field: np.full(starts.size, np.nan) for field in fields}
    missing = {field: np.ones(starts.size, dtype=np.bool_) for field in fields}
    unparsed = {field: np.zeros(starts.size, dtype=np.bool_) for field in fields}
    examples: dict[str, str] = {}
    text = lines.text.tobytes()
    for i, (start, length) in enumerate(zip(starts.tolist(), lines.length.tolist(), strict=True)):
        payload = text[start : start + length]
        message = _object(payload)
        for field in fields:
            value = None if message is None else message.get(field)
            number = _number(value)
            if number is not None:
                raw[field][i], missing[field][i] = number, False
            elif message is None or value is not None:
                unparsed[field][i] = True
                examples.setdefault(field, repr(payload if message is None else value)[:60])
    return {
        field: Readings(raw[field], missing[field], unparsed[field], examples.get(field))
        for field in fields
    }


def _object(payload: bytes) -> dict[str, Any] | None:
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:  # An integer of more than 308 digits is a number, but not finite.
        return math.inf if value > 0 else -math.inf


def _joined(parts: Sequence[_Parsed], fields: Sequence[str]) -> _Parsed:
    return _Parsed(
        topic=np.concatenate([np.empty(0, np.int16), *(part.topic for part in parts)]),
        time_ns=np.concatenate([np.empty(0, np.uint64), *(part.time_ns for part in parts)]),
        fields={field: Readings.joined([part.fields[field] for part in parts]) for field in fields},
    )


def _require_field(path: Path, source: ChannelSource) -> None:
    """Refuse a topic without the field in any message; a field that is null is a missing sample."""
    keys: set[str] = set()
    for messages in read_messages(path):
        topic = _topic_by_channel_id(path, messages.channels, [source.source])[messages.channel_id]
        for i in np.flatnonzero(topic == 0).tolist():
            payload = messages.buffer[messages.payload_start[i] : messages.payload_end[i]]
            message = _object(bytes(payload)) or {}
            if source.field in message:
                return
            keys.update(list(message)[:40])
    raise LogError(
        "log_column_missing",
        path,
        f"no message of topic {source.source!r} has a field {source.field!r}; there are "
        + ", ".join(map(repr, sorted(keys)[:40])),
        source.source,
    )

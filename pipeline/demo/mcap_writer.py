"""MCAP files of JSON messages, a chunk at a time.

The official writer takes some 10 µs a message, minutes for the demo's 13 million. Here all messages
have one length, so that a chunk is one NumPy array of records; all other records, which are few,
are the mcap package's own.

References
----------
.. [1] MCAP format specification, https://mcap.dev/spec: message, chunk, message index, chunk
   index, statistics, footer.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

MAGIC: Final = b"\x89MCAP0\r\n"
CHUNK_MESSAGES: Final = 16_384
RECORDING_DELAY_NS: Final = 1_500_000  # from a message's publication to its record
SCHEMA: Final = Schema(
    id=1,
    name="value",
    encoding="jsonschema",
    data=b'{"type":"object","properties":{"value":{"type":"number"}},"required":["value"]}',
)
BEFORE, AFTER = b'{"value":', b"}"
NUMBER_WIDTH: Final = 10
DECIMALS: Final = 3
PAYLOAD_BYTES: Final = len(BEFORE) + NUMBER_WIDTH + len(AFTER)
MESSAGE_HEAD_BYTES: Final = 22  # channel, sequence and two times: all of a message but its payload

MESSAGE: Final = np.dtype(
    [
        ("opcode", "<u1"),
        ("length", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("payload", "u1", (PAYLOAD_BYTES,)),
    ]
)
INDEX_ENTRY: Final = np.dtype([("log_time", "<u8"), ("offset", "<u8")])

Topic = tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.float64]]


def mcap_bytes(topics: Mapping[str, Topic]) -> bytes:
    """A whole MCAP file.

    By topic: place of each message among all topics' messages, publication time [µs since 1970,
    UTC], and value, |value| < 100 000 with three decimals; each of shape (n,).
    """
    channels = [
        Channel(id=number, topic=topic, message_encoding="json", metadata={}, schema_id=SCHEMA.id)
        for number, topic in enumerate(topics, start=1)
    ]
    messages = _messages(list(topics.values()))
    data = RecordBuilder()
    data.write(MAGIC)
    Header(profile="", library="motor-leakage demo").write(data)
    indexes = [
        _write_chunk(data, messages[first : first + CHUNK_MESSAGES], () if first else channels)
        for first in range(0, messages.size, CHUNK_MESSAGES)
    ]
    body = _taken(data)
    data.write(body)
    DataEnd(zlib.crc32(body)).write(data)
    _write_summary(data, channels, messages, indexes)
    data.write(MAGIC)
    return _taken(data)


def fixed_width_numbers(
    values: NDArray[np.float64], width: int = NUMBER_WIDTH, decimals: int = DECIMALS
) -> NDArray[np.uint8]:
    """ASCII codes of finite numbers as text of one width, padded in front, shape (n, width)."""
    whole = np.rint(values * 10**decimals).astype(np.int64)
    rest, unsigned = np.abs(whole), whole >= 0
    text = np.full((values.size, width), ord(" "), dtype=np.uint8)
    columns = [column for column in range(width - 1, 0, -1) if column != width - 1 - decimals]
    text[:, width - 1 - decimals] = ord(".")
    for place, column in enumerate(columns):
        shown = (rest > 0) | (place <= decimals)
        text[:, column] += np.where(shown, rest % 10 + ord("0") - ord(" "), 0).astype(np.uint8)
        rest //= 10
        signed = ~unsigned & (rest == 0) & (place >= decimals)
        text[signed, column - 1] = ord("-")
        unsigned |= signed
    return text


def _messages(topics: Sequence[Topic]) -> NDArray[np.void]:
    """All message records of all topics in the order in which they were recorded."""
    places = np.concatenate([place for place, _, _ in topics])
    messages = np.zeros(places.size, dtype=MESSAGE)
    messages["opcode"] = Opcode.MESSAGE
    messages["length"] = MESSAGE_HEAD_BYTES + PAYLOAD_BYTES
    counts = [place.size for place, _, _ in topics]
    messages["channel_id"] = np.repeat(np.arange(1, len(topics) + 1), counts)
    messages["sequence"] = np.concatenate([np.arange(count) for count in counts])
    messages["publish_time"] = 1000 * np.concatenate([stamps for _, stamps, _ in topics])
    messages["log_time"] = messages["publish_time"] + RECORDING_DELAY_NS
    numbers = fixed_width_numbers(np.concatenate([values for _, _, values in topics]))
    before, after = len(BEFORE), len(BEFORE) + NUMBER_WIDTH
    messages["payload"][:, :before] = np.frombuffer(BEFORE, np.uint8)
    messages["payload"][:, before:after] = numbers
    messages["payload"][:, after:] = np.frombuffer(AFTER, np.uint8)
    return messages[np.lexsort((messages["publish_time"], places))]


def _write_chunk(
    data: RecordBuilder, messages: NDArray[np.void], channels: Sequence[Channel]
) -> ChunkIndex:
    """A chunk, which declares the channels if they are given, and its message indexes."""
    declarations = _declarations(channels)
    content = declarations + messages.tobytes()
    compressed = zstandard.ZstdCompressor(level=1).compress(content)
    first, last = int(messages["log_time"].min()), int(messages["log_time"].max())
    start = data.count
    Chunk(
        compression="zstd",
        data=compressed,
        message_start_time=first,
        message_end_time=last,
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    ).write(data)
    end = data.count
    offsets = _write_message_indexes(data, messages, len(declarations))
    return ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression="zstd",
        compressed_size=len(compressed),
        message_start_time=first,
        message_end_time=last,
        message_index_length=data.count - end,
        message_index_offsets=offsets,
        uncompressed_size=len(content),
    )


def _write_message_indexes(
    data: RecordBuilder, messages: NDArray[np.void], first_offset: int
) -> dict[int, int]:
    """One index a channel; returns where each one starts."""
    starts: dict[int, int] = {}
    for channel_id in np.unique(messages["channel_id"]):
        rows = np.flatnonzero(messages["channel_id"] == channel_id)
        entries = np.empty(rows.size, dtype=INDEX_ENTRY)
        entries["log_time"] = messages["log_time"][rows]
        entries["offset"] = first_offset + rows * MESSAGE.itemsize
        starts[int(channel_id)] = data.count
        head = (Opcode.MESSAGE_INDEX, 6 + entries.nbytes, int(channel_id), entries.nbytes)
        data.write(struct.pack("<BQHI", *head))
        data.write(entries.tobytes())
    return starts


def _write_summary(
    data: RecordBuilder,
    channels: Sequence[Channel],
    messages: NDArray[np.void],
    indexes: Sequence[ChunkIndex],
) -> None:
    """Schema, channels, statistics and chunk indexes, where each group starts, and the footer."""
    groups = {
        Opcode.SCHEMA: [SCHEMA],
        Opcode.CHANNEL: channels,
        Opcode.STATISTICS: [_statistics(channels, messages, len(indexes))],
        Opcode.CHUNK_INDEX: indexes,
    }
    start = data.count
    summary = RecordBuilder()
    offsets = []
    for opcode, records in groups.items():
        group_start = summary.count
        for record in records:
            record.write(summary)
        offsets.append(SummaryOffset(opcode, start + group_start, summary.count - group_start))
    offset_start = start + summary.count
    for offset in offsets:
        offset.write(summary)
    content = _taken(summary)
    data.write(content)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
    Footer(start, offset_start, zlib.crc32(head, zlib.crc32(content))).write(data)


def _statistics(channels: Sequence[Channel], messages: NDArray[np.void], chunks: int) -> Statistics:
    ids, counts = np.unique(messages["channel_id"], return_counts=True)
    return Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=dict(zip(ids.tolist(), counts.tolist(), strict=True)),
        chunk_count=chunks,
        message_count=messages.size,
        message_start_time=int(messages["log_time"].min()),
        message_end_time=int(messages["log_time"].max()),
        metadata_count=0,
        schema_count=1,
    )


def _declarations(channels: Sequence[Channel]) -> bytes:
    """Schema and channels as records; nothing where there are no channels."""
    declarations = RecordBuilder()
    if channels:
        SCHEMA.write(declarations)
    for channel in channels:
        channel.write(declarations)
    return _taken(declarations)


def _taken(builder: RecordBuilder) -> bytes:
    """All that was written, which empties the builder."""
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content

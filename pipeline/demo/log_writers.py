"""A recording as a file: CSV, Parquet and MCAP, each in the dialect that the motor's config states.

The official writer of MCAP takes some 10 µs a message, two minutes for the demo's 13 million. Here
all messages have one length, so that a chunk is one NumPy array; all other records are the `mcap`
package's own [1]_.

References
----------
.. [1] MCAP format specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import Chunk, ChunkIndex, DataEnd, Footer, Header, Schema, Statistics
from numpy.typing import NDArray

from pipeline.config import Channel, MotorFile
from pipeline.demo.noise import FloatArray
from pipeline.demo.recording import Recording
from pipeline.units import from_canonical

STAMP_FORMAT: Final = "%Y-%m-%dT%H:%M:%S%.3fZ"
MAGIC: Final = b"\x89MCAP0\r\n"
CHUNK_MESSAGES: Final = 16_384
RECORDING_DELAY_US: Final = 1_500  # from a message's publication to its record
SCHEMA: Final = Schema(
    id=1,
    name="value",
    encoding="jsonschema",
    data=b'{"type":"object","properties":{"value":{"type":"number"}},"required":["value"]}',
)
BEFORE, AFTER, WIDTH = b'{"value":', b"}", 10
MESSAGE: Final = np.dtype(
    [
        ("opcode", "<u1"),
        ("length", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("payload", "u1", (len(BEFORE) + WIDTH + len(AFTER),)),
    ]
)
INDEX_ENTRY: Final = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


def write_log(path: Path, recording: Recording, motor: MotorFile) -> None:
    """Write a recording to a file that is whole or not there."""
    write = {"csv": _write_csv, "parquet": _write_parquet, "mcap": _write_mcap}
    partial = path.with_name(f".{path.name}.partial")
    write[motor.logs.format](partial, recording, motor)
    partial.replace(path)


def as_logged(channel: str, values: FloatArray, source: Channel) -> FloatArray:
    """Values as the log holds them: the inverse of what the reader does."""
    in_unit = from_canonical(channel, values, source.unit)
    return np.round((in_unit - source.offset) / source.scale, 6) + 0.0  # no -0.0


def _columns(recording: Recording, motor: MotorFile) -> dict[str, FloatArray]:
    return {
        channel.source: as_logged(name, recording.values[name], channel)
        for name, channel in motor.channels.items()
    }


def _write_csv(path: Path, recording: Recording, motor: MotorFile) -> None:
    time = pl.Series(recording.time_us).cast(pl.Datetime("us", "UTC"))
    rows = pl.DataFrame({motor.logs.time: time} | _columns(recording, motor))
    rows.fill_nan(None).write_csv(
        path,
        separator=motor.logs.separator,
        decimal_comma=motor.logs.decimal == ",",
        datetime_format=STAMP_FORMAT,
    )


def _write_parquet(path: Path, recording: Recording, motor: MotorFile) -> None:
    time = pa.array(recording.time_us, pa.timestamp("us", "UTC"))
    if motor.logs.time_format == "epoch_ms":
        time = pa.array(recording.time_us // 1000)
    columns = {
        name: pa.array(values, from_pandas=True)
        for name, values in _columns(recording, motor).items()
    }
    table = pa.table({motor.logs.time: time} | columns)
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def _write_mcap(path: Path, recording: Recording, motor: MotorFile) -> None:
    topics = [channel.source for channel in motor.channels.values()]
    channels = [McapChannel(n, topic, "json", {}, SCHEMA.id) for n, topic in enumerate(topics, 1)]
    messages = _messages(recording, motor)
    data, summary, end = RecordBuilder(), RecordBuilder(), RecordBuilder()
    data.write(MAGIC)
    Header(profile="", library="motor-leakage demo").write(data)
    chunks = [
        _write_chunk(data, messages[first : first + CHUNK_MESSAGES], [] if first else channels)
        for first in range(0, messages.size, CHUNK_MESSAGES)
    ]
    body = _bytes_of(data)
    DataEnd(zlib.crc32(body)).write(end)
    start = len(body) + end.count
    ids, counts = np.unique(messages["channel_id"], return_counts=True)
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=dict(zip(ids.tolist(), counts.tolist(), strict=True)),
        chunk_count=len(chunks),
        message_count=messages.size,
        message_start_time=int(messages["log_time"].min()),
        message_end_time=int(messages["log_time"].max()),
        metadata_count=0,
        schema_count=1,
    )
    for record in (SCHEMA, *channels, statistics, *chunks):
        record.write(summary)
    content = _bytes_of(summary)
    end.write(content)
    # The checksum is over the footer's head, too.
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    Footer(start, 0, zlib.crc32(head, zlib.crc32(content))).write(end)
    end.write(MAGIC)
    path.write_bytes(body + _bytes_of(end))


def _bytes_of(builder: RecordBuilder) -> bytes:
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content


def _messages(recording: Recording, motor: MotorFile) -> NDArray[np.void]:
    """All message records in the order in which they were recorded."""
    places, parts = [], []
    for number, (name, channel) in enumerate(motor.channels.items(), start=1):
        rows = np.flatnonzero(~np.isnan(recording.values[name]))
        part = np.zeros(rows.size, MESSAGE)
        part["opcode"], part["length"] = Opcode.MESSAGE, MESSAGE.itemsize - 9
        part["channel_id"], part["sequence"] = number, np.arange(rows.size)
        stamps = recording.time_us[rows] + recording.own_delay_us[name][rows]
        part["publish_time"] = 1000 * stamps
        part["log_time"] = 1000 * (stamps + RECORDING_DELAY_US)
        part["payload"] = _payloads(as_logged(name, recording.values[name][rows], channel))
        places.append(rows)
        parts.append(part)
    messages = np.concatenate(parts)
    return messages[np.lexsort((messages["publish_time"], np.concatenate(places)))]


def _payloads(values: FloatArray) -> NDArray[np.uint8]:
    """JSON of values with three decimals, |value| < 100 000, shape (n, bytes)."""
    short = np.rint(values * 1000.0) / 1000.0 + 0.0  # no -0.0
    texts = pl.Series(short).cast(pl.String).str.pad_start(WIDTH)
    codes = np.frombuffer("".join(texts).encode(), np.uint8).reshape(-1, WIDTH)
    before, after = (np.frombuffer(one, np.uint8) for one in (BEFORE, AFTER))
    return np.hstack([np.tile(before, (values.size, 1)), codes, np.tile(after, (values.size, 1))])


def _write_chunk(
    data: RecordBuilder, messages: NDArray[np.void], channels: Sequence[McapChannel]
) -> ChunkIndex:
    """A chunk, which declares the channels if they are given, and where messages lie in it."""
    declarations = RecordBuilder()
    for record in (SCHEMA, *channels) if channels else ():
        record.write(declarations)
    declared = _bytes_of(declarations)
    content = declared + messages.tobytes()
    compressed = zstandard.ZstdCompressor(level=1).compress(content)
    times = int(messages["log_time"].min()), int(messages["log_time"].max())
    start = data.count
    Chunk("zstd", compressed, times[1], times[0], zlib.crc32(content), len(content)).write(data)
    end = data.count
    offsets: dict[int, int] = {}
    for channel_id in np.unique(messages["channel_id"]).tolist():
        rows = np.flatnonzero(messages["channel_id"] == channel_id)
        entries = np.empty(rows.size, dtype=INDEX_ENTRY)
        entries["log_time"] = messages["log_time"][rows]
        entries["offset"] = len(declared) + rows * MESSAGE.itemsize
        offsets[channel_id] = data.count
        head = Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel_id, entries.nbytes
        data.write(struct.pack("<BQHI", *head) + entries.tobytes())
    return ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression="zstd",
        compressed_size=len(compressed),
        message_start_time=times[0],
        message_end_time=times[1],
        message_index_length=data.count - end,
        message_index_offsets=offsets,
        uncompressed_size=len(content),
    )

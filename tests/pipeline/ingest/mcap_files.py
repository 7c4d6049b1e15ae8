"""MCAP files by the official writer or laid out by hand, and what the official decoders read."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

from pipeline.config.logs import field_path
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log
from pipeline.ingest.conformance import T0_US
from pipeline.units import CHANNELS, canonical_unit

from .sources import Source, column

T0_NS = T0_US * 1000
TOPIC = "/hydraulics"
PUBLISHED_BEFORE_NS = 5_000_000_000
JSON = ("V", "jsonschema", b"{}")

Value = float | None
"""A reading; None where missing."""

# Definitions behind a message of ROS 2 with a header.
HEADER = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def mcap_bytes(
    messages: Sequence[tuple[str, int, bytes]],
    schema: tuple[str, str, bytes] | None = None,
    encoding: str = "json",
    topics: Sequence[str] = (),
    **options: Any,
) -> bytes:
    """A file of (topic, log time [ns], payload), and of more topics; publish time is 5 s before."""
    buffer = io.BytesIO()
    writer = Writer(buffer, **options)
    writer.start()
    number = 0 if schema is None else writer.register_schema(*schema)
    names = dict.fromkeys([*topics, *(topic for topic, _, _ in messages)])
    ids = {name: writer.register_channel(name, encoding, number) for name in names}
    for topic, time_ns, payload in messages:
        writer.add_message(ids[topic], time_ns, payload, max(time_ns - PUBLISHED_BEFORE_NS, 0))
    writer.finish()
    return buffer.getvalue()


def mcap_of(
    payloads: Sequence[bytes],
    schema: tuple[str, str, bytes] = JSON,
    encoding: str = "json",
    **options: Any,
) -> bytes:
    """A file of one topic, a message a millisecond."""
    messages = [(TOPIC, T0_NS + i * 1_000_000, payload) for i, payload in enumerate(payloads)]
    return mcap_bytes(messages, schema, encoding, (TOPIC,), **{"chunk_size": 3000} | options)


def source_of(*fields: str, topic: str = TOPIC, **options: Any) -> Source:
    """A source of up to eight fields of a topic."""
    channels = {
        name: column(topic, canonical_unit(name), field=field)
        for name, field in zip(CHANNELS, fields, strict=False)
    }
    return Source.of("mcap", channels, **options)


SOURCE = source_of("value")


def read(folder: Path, data: bytes, source: Source = SOURCE) -> RawLog:
    """Log as read from a file with these bytes."""
    path = folder / "log.mcap"
    path.write_bytes(data)
    return read_log(path, *source)


def all_values(path: Path, fields: Sequence[str], topic: str = TOPIC) -> dict[str, list[Value]]:
    """Readings of any number of fields, in as many reads as they take."""
    found: dict[str, list[Value]] = {}
    for start in range(0, len(fields), len(CHANNELS)):
        some = fields[start : start + len(CHANNELS)]
        channels = read_log(path, *source_of(*some, topic=topic)).channels
        for field, channel in zip(some, channels.values(), strict=True):
            pairs = zip(channel.value.tolist(), channel.missing.tolist(), strict=True)
            found[field] = [None if missing else value for value, missing in pairs]
    return found


def values(folder: Path, data: bytes, field: str) -> list[Value]:
    """Readings of one field."""
    path = folder / "log.mcap"
    path.write_bytes(data)
    return all_values(path, [field])[field]


def error_of(folder: Path, data: bytes, field: str = "value", **options: Any) -> LogError:
    """The error that reading a field ends in."""
    with pytest.raises(LogError) as raised:
        read(folder, data, source_of(field, **options))
    return raised.value


def official_messages(path: Path, topic: str = TOPIC) -> list[tuple[int, Any]]:
    """Log time [µs] and content of a topic's messages by the format's own reader, in file order."""
    factories = [ProtobufDecoderFactory(), Ros2DecoderFactory()]
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=factories)
        decoded = reader.iter_decoded_messages([topic], log_time_order=False)
        return [(record.log_time // 1000, message) for _, _, record, message in decoded]


def officially(path: Path, field: str, topic: str = TOPIC) -> list[Value]:
    """Readings of a field as the format's own reader gives them; None beyond an array's end."""
    return [followed(message, field) for _, message in official_messages(path, topic)]


def followed(message: Any, field: str) -> Value:
    """Value at a path in a decoded message."""
    for step in field_path(field):
        if isinstance(step, int) and step >= len(message):
            return None
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return float(message)


# Laid out by hand, as the specification says

MAGIC = b"\x89MCAP0\r\n"


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def channel_record(number: int, topic: str = TOPIC) -> bytes:
    content = struct.pack("<HH", number, 0) + text(topic) + text("json") + struct.pack("<I", 0)
    return record(0x04, content)


def message_record(number: int, time_ns: int, payload: bytes) -> bytes:
    return record(0x05, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + payload)


def chunk_record(records: bytes, packed: bytes, compression: str, **wrong: int) -> bytes:
    size = wrong.get("size", len(records))
    checksum = wrong.get("checksum", zlib.crc32(records))
    head = struct.pack("<QQQI", 0, 0, size, checksum) + text(compression)
    packed_size = wrong.get("packed_size", len(packed))
    return record(0x06, head + struct.pack("<Q", packed_size) + packed)


def file_of(
    *records: bytes,
    data_end: bytes | None = None,
    behind: bytes = b"",
    summary: bytes = b"",
    checksum: int = 0,
) -> bytes:
    """A file around some records of its data section, and of its summary."""
    end = record(0x0F, struct.pack("<I", 0)) if data_end is None else data_end
    data = MAGIC + record(0x01, text("") + text("by hand")) + b"".join(records) + end + behind
    footer = record(0x02, struct.pack("<QQI", len(data) if summary else 0, 0, checksum))
    return data + summary + footer + MAGIC


def statistics_record(counts: dict[int, int]) -> bytes:
    total = sum(counts.values())
    head = struct.pack("<QHIIIIQQI", total, 0, len(counts), 0, 0, 0, T0_NS, T0_NS, 10 * len(counts))
    return record(0x0B, head + b"".join(struct.pack("<HQ", *pair) for pair in counts.items()))


DP = channel_record(1)
ONE = message_record(1, T0_NS, b'{"value": 1}')

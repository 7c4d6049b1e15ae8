"""MCAP files of JSON messages, and records of such a file laid out by hand."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import pytest

from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.sources import Source, column
from tests.pipeline.ingest.writers import mcap_bytes

SOURCE = Source.of("mcap", {"pressure_difference": column("dp", "bar")})
T0_NS = T0_US * 1000
MAGIC = b"\x89MCAP0\r\n"

Message = tuple[str, int, bytes]


def messages(payloads: Sequence[bytes], topic: str = "dp") -> list[Message]:
    return [(topic, T0_NS + i * 1_000_000, payload) for i, payload in enumerate(payloads)]


def read(folder: Path, data: bytes, source: Source = SOURCE) -> RawLog:
    path = folder / "log.mcap"
    path.write_bytes(data)
    return read_log(path, *source)


def pressure(folder: Path, payloads: Sequence[bytes]) -> RawChannel:
    return read(folder, mcap_bytes(messages(payloads))).channels["pressure_difference"]


def error(folder: Path, data: bytes, source: Source = SOURCE) -> LogError:
    with pytest.raises(LogError) as raised:
        read(folder, data, source)
    return raised.value


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def channel_record(number: int, topic: str, encoding: str = "json") -> bytes:
    content = struct.pack("<HH", number, 0) + text(topic) + text(encoding) + struct.pack("<I", 0)
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


DP = channel_record(1, "dp")
ONE = message_record(1, T0_NS, b'{"value": 1}')

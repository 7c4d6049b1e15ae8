"""Damage in an MCAP file is refused, each kind of it by its code."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType

from pipeline.errors import LogError
from pipeline.ingest import read_log
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.mcap_files import mcap_bytes
from tests.pipeline.ingest.sources import Source, column

LOG = Source.of("mcap", {"pressure_difference": column("dp", "bar")})
PLAIN: dict[str, Any] = {"compression": CompressionType.NONE, "index_types": IndexType.NONE}
PACKED: dict[str, Any] = {"compression": CompressionType.ZSTD}
BARE: dict[str, Any] = {"use_chunking": False, "enable_data_crcs": True}


def made(**options: Any) -> bytes:
    messages = [("dp", (T0_US + i) * 1000, b'{"value": %d}' % i) for i in range(400)]
    return mcap_bytes(messages, **{"chunk_size": 1000} | options)


def last_chunk(data: bytes) -> int:
    """Begin of the last chunk."""
    at, start = 8, 0
    while at + 9 < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        start = at if opcode == 0x06 else start
        at += 9 + length
    return start


def in_chunk(place: int, form: str, value: int | bytes, **options: Any) -> bytes:
    """A file with another value at a place in its last chunk."""
    data = bytearray(made(**options))
    struct.pack_into(form, data, last_chunk(bytes(data)) + place, value)
    return bytes(data)


def flipped(**options: Any) -> bytes:
    data = bytearray(made(**options))
    data[data.index(b'{"value": 200}') + 10] ^= 1
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (made(**PACKED)[:-1000], "log_truncated"),
        (made(**BARE)[:-1], "log_truncated"),
        (in_chunk(120, "<B", 0, **PACKED), "log_damaged"),
        (in_chunk(1, "<Q", 2**50, **PLAIN), "log_damaged"),
        (in_chunk(25, "<Q", 2**40, **PLAIN), "log_too_large"),
        (in_chunk(41, "<3s", b"xyz", **PACKED), "log_compression"),
        (flipped(**PLAIN), "log_damaged"),
        (flipped(**BARE), "log_damaged"),
        (b"no magic" + made(), "log_not_mcap"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_kind_of_damage(tmp_path: Path, data: bytes, code: str) -> None:
    (tmp_path / "log.mcap").write_bytes(data)
    with pytest.raises(LogError) as raised:
        read_log(tmp_path / "log.mcap", *LOG)
    assert raised.value.code == code

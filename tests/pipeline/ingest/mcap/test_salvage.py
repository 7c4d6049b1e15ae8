"""Salvage of what precedes the damage in an MCAP file, if the source allows it."""

from __future__ import annotations

import io
import re
import struct
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType

from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.mcap_files import mcap_bytes
from tests.pipeline.ingest.sources import Source, column

COUNT = 400
STRICT = Source.of("mcap", {"pressure_difference": column("dp", "bar")})
SALVAGE = STRICT.but(salvage=True)
PLAIN: dict[str, Any] = {"compression": CompressionType.NONE, "index_types": IndexType.NONE}
IN_CHUNKS = [{"compression": CompressionType.ZSTD}, {"compression": CompressionType.LZ4}, PLAIN]
BARE: dict[str, Any] = {"use_chunking": False}
WITH_CHECKSUM: dict[str, Any] = {**BARE, "enable_data_crcs": True}


def made(**options: Any) -> bytes:
    """A file whose readings count up from 0."""
    messages = [("dp", (T0_US + i) * 1000, b'{"value": %d}' % i) for i in range(COUNT)]
    return mcap_bytes(messages, **{"chunk_size": 1000} | options)


def read(path: Path, data: bytes, source: Source = SALVAGE) -> RawLog:
    path.write_bytes(data)
    return read_log(path, *source)


def count_of(log: RawLog) -> int:
    """Number of readings, which are the first ones and in their order."""
    channel = log.channels["pressure_difference"]
    np.testing.assert_array_equal(channel.value, np.arange(channel.value.size))
    np.testing.assert_array_equal(channel.time_us, T0_US + np.arange(channel.value.size))
    return channel.value.size


def code_of(path: Path, data: bytes, source: Source) -> str:
    with pytest.raises(LogError) as raised:
        read(path, data, source)
    return raised.value.code


@pytest.mark.parametrize("options", [*IN_CHUNKS, BARE, WITH_CHECKSUM], ids=str)
def test_a_file_gives_the_messages_before_its_end(tmp_path: Path, options: dict[str, Any]) -> None:
    path, data = tmp_path / "log.mcap", made(**options)
    assert (count_of(read(path, data)), read(path, data).notes) == (COUNT, ())
    # The last ones cut the summary alone, or a part of it.
    for length in (*(int(len(data) * share) for share in (0.3, 0.7, 0.95)), -40, -30, -8, -1):
        cut = data[:length]
        assert code_of(path, cut, STRICT) == "log_truncated"
        log = read(path, cut)
        least = COUNT if length < 0 else COUNT * length / len(data) / 3
        assert count_of(log) >= least
        (note,) = log.notes
        assert note.startswith(f"salvaged: {count_of(log)} messages stand before the damage")
        assert f"of {len(cut)} bytes are not read" in note
        assert time_span(path, *SALVAGE) == log.ends()


def test_what_is_not_salvaged(tmp_path: Path) -> None:
    """Damage without a place, what is no MCAP, and what is packed in unknown ways."""
    flipped = bytearray(made(**WITH_CHECKSUM))
    flipped[flipped.index(b'{"value": 200}') + 10] ^= 1
    packed = made(compression=CompressionType.ZSTD).replace(b"zstd", b"gzip")
    for data, code in (
        (bytes(flipped), "log_damaged"),
        (b"no magic" + made(), "log_not_mcap"),
        (packed, "log_compression"),
    ):
        assert code_of(tmp_path / "log.mcap", data, SALVAGE) == code


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Begin of each chunk of a file, and messages before it as the official reader counts them."""
    at, starts = 8, []
    while at + 9 < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        starts += [at] if opcode == 0x06 else []
        at += 9 + length
    records = StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records
    inside = (breakup_chunk(record, True) for record in records if isinstance(record, Chunk))
    counts = [sum(isinstance(part, Message) for part in parts) for parts in islice(inside, 4)]
    return [(start, sum(counts[:i])) for i, start in enumerate(starts[:4])]


def damaged(data: bytes, kind: str, start: int) -> bytes:
    """A file with one kind of damage in the chunk that begins at a byte."""
    changed = bytearray(data)
    match kind:
        case "cut":
            return data[: start + 100]
        case "content":
            changed[start + 120] ^= 0x10
        case "length":
            struct.pack_into("<Q", changed, start + 1, 2**50)
        case "bomb":
            struct.pack_into("<Q", changed, start + 9 + 16, 2**40)
        case "compression":
            changed[start + 41 : start + 44] = b"xyz"
    return bytes(changed)


CODES = {
    "cut": "log_truncated",
    "content": "log_damaged",
    "length": "log_damaged",
    "bomb": "log_too_large",
    "compression": "log_compression",
}


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        pytest.param(options, kind, id=f"{options}-{kind}")
        for options, kind in product(IN_CHUNKS, CODES)
        # The name of no compression has no letters to change.
        if (options, kind) != (PLAIN, "compression")
    ],
)
@pytest.mark.parametrize("chunk", [0, 3])
def test_each_kind_of_damage_in_each_mode(
    tmp_path: Path, options: dict[str, Any], chunk: int, kind: str
) -> None:
    """What would fill the memory, or cannot be unpacked by anything we know, is always refused."""
    code = CODES[kind]
    whole, path = made(**options), tmp_path / "log.mcap"
    start, before = chunks(whole)[chunk]
    data = damaged(whole, kind, start)
    assert code_of(path, data, STRICT) == code
    if code in ("log_too_large", "log_compression"):
        assert code_of(path, data, SALVAGE) == code
    elif kind == "cut" and not before:
        assert code_of(path, data, SALVAGE) == "log_column_missing"
    else:
        log = read(path, data)
        assert count_of(log) == before
        stated = "" if code == "log_truncated" else f" of {COUNT}"
        assert log.notes[0].startswith(f"salvaged: {before}{stated} messages stand before the")
        assert kind != "content" or f"chunk at byte {start}" in log.notes[0]
        lost = int(re.findall(r"last (\d+) of \d+ bytes are not read", log.notes[0])[0])
        assert 0 <= lost <= len(data) - start

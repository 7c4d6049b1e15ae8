"""Records, chunks and damage of MCAP files, against the official reader and the specification."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

import pipeline.ingest.mcap.messages
from pipeline.ingest import time_span
from pipeline.ingest.conformance import T0_US
from pipeline.ingest.mcap.messages import offsets_in_chunk, record_offsets
from tests.pipeline.ingest.mcap_files import (
    DP,
    MAGIC,
    ONE,
    SOURCE,
    T0_NS,
    TOPIC,
    channel_record,
    chunk_record,
    error_of,
    file_of,
    mcap_of,
    message_record,
    read,
    record,
    statistics_record,
    text,
    values,
)


def test_files_laid_out_by_hand_as_the_specification_says_are_read(tmp_path: Path) -> None:
    """So that the damaged ones below are damaged in one place each."""
    summary = DP + statistics_record({1: 2})
    start = len(file_of(DP, ONE, ONE)) - 37
    footer = struct.pack("<BQQQ", 0x02, 20, start, 0)
    checksum = zlib.crc32(summary + footer)
    for data in (
        file_of(DP, ONE, ONE),
        file_of(DP, ONE, ONE, summary=summary),
        file_of(DP, ONE, ONE, summary=summary, checksum=checksum),
        file_of(chunk_record(DP + ONE + ONE, DP + ONE + ONE, ""), summary=summary),
    ):
        assert read(tmp_path, data).rows == 2
        assert time_span(tmp_path / "log.mcap", *SOURCE) == (T0_US, T0_US)


@pytest.mark.parametrize("block", [1, 9, 100, 1000])
def test_records_may_cross_the_blocks_in_which_a_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    monkeypatch.setattr(pipeline.ingest.mcap.messages, "_BLOCK", block)
    sent = [b'{"value": %d}' % i + b" " * (i % 3) for i in range(300)]
    for use_chunking in (True, False):
        log = read(tmp_path, mcap_of(sent, chunk_size=500, use_chunking=use_chunking))
        assert log.channels["pressure_difference"].value.tolist() == list(range(300))


def test_attachments_metadata_and_unknown_records_are_passed_over(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, chunk_size=50)
    writer.start()
    number = writer.register_channel(TOPIC, "json", 0)
    for i in range(20):
        writer.add_message(number, T0_NS + i, b'{"value": %d}' % i, 0)
        writer.add_attachment(T0_NS, T0_NS, "photo.jpg", "image/jpeg", bytes(5000))
        writer.add_metadata("shift", {"driver": "A"})
    writer.finish()
    unknown = record(0x80, b"private") + record(0x7F, b"")
    chunk = unknown + DP + unknown + ONE + unknown
    by_hand = file_of(unknown, chunk_record(chunk, chunk, ""), unknown)
    assert values(tmp_path, buffer.getvalue(), "value") == [float(i) for i in range(20)]
    assert values(tmp_path, by_hand, "value") == [1.0]


def test_bare_messages_and_chunks_keep_the_order_of_the_file(tmp_path: Path) -> None:
    two, three, four = (message_record(1, T0_NS, b'{"value": %d}' % i) for i in (2, 3, 4))
    chunk = chunk_record(two + three, zstandard.compress(two + three), "zstd")
    assert values(tmp_path, file_of(DP, ONE, chunk, four), "value") == [1.0, 2.0, 3.0, 4.0]


PACKERS = {"lz4": lz4.frame.compress, "zstd": zstandard.compress, "": bytes}


@pytest.mark.parametrize("compression", PACKERS)
@pytest.mark.parametrize("size", [0, 1, -1, 2**20, -(2**20)])
def test_a_chunk_that_unfolds_to_another_size_is_damage(
    tmp_path: Path, compression: str, size: int
) -> None:
    records = DP + ONE * 100
    packed, claimed = PACKERS[compression](records), max(len(records) + size, 0)
    data = file_of(chunk_record(records, packed, compression, size=claimed, checksum=0))
    if size == 0:
        assert read(tmp_path, data).rows == 100
    else:
        assert error_of(tmp_path, data).code == "log_damaged"


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_chunk_that_unfolds_without_end_is_stopped(tmp_path: Path, compression: str) -> None:
    bomb = bytes(2**26)
    other = chunk_record(DP + ONE, DP + ONE, "gzip")
    assert error_of(tmp_path, file_of(other)).code == "log_compression"
    for size, code in ((1000, "log_damaged"), (2**28 + 1, "log_too_large")):
        chunk = chunk_record(bomb, PACKERS[compression](bomb), compression, size=size)
        assert error_of(tmp_path, file_of(chunk)).code == code


@pytest.mark.parametrize(
    "data",
    [
        file_of(chunk_record(DP + ONE, DP + ONE, "", checksum=1)),
        file_of(chunk_record(DP + ONE, b"no frame", "zstd")),
        file_of(chunk_record(DP + ONE, b"no frame", "lz4")),
        file_of(chunk_record(DP + ONE, DP + ONE, "", packed_size=2**40)),
        file_of(chunk_record(DP + ONE[:-1], DP + ONE[:-1], "")),
        file_of(record(0x06, b"short")),
        file_of(record(0x06, struct.pack("<QQQI", 0, 0, 0, 0) + struct.pack("<I", 2**31))),
        file_of(record(0x06, struct.pack("<QQQI", 0, 0, 0, 0) + b"\x01\0\0\0\xff" + bytes(8))),
        file_of(DP, record(0x05, bytes(21))),
        file_of(DP, chunk_record(record(0x05, bytes(21)) * 2, record(0x05, bytes(21)) * 2, "")),
        file_of(ONE),
        file_of(DP, channel_record(1, "other"), ONE),
        file_of(record(0x04, b"\x01\0\0\0\xff\xff\xff\xff")),
        file_of(record(0x04, b"\x01\0\0\0\x01\0\0\0\xff\x00\0\0\0")),
        file_of(record(0x04, struct.pack("<HH", 1, 0) + text(TOPIC) + b"\x0a\0\0\0json"), ONE),
        file_of(DP, ONE, data_end=b""),
        file_of(DP, ONE, data_end=record(0x0F, struct.pack("<I", 1))),
        file_of(DP, ONE, struct.pack("<BQ", 0x05, 2**63)),
        file_of(DP, ONE, b"\x05"),
        file_of(DP, ONE, behind=b"\x05\x01"),
        file_of(DP, ONE)[:-8] + b"\0" + MAGIC,
        MAGIC + MAGIC + bytes(29) + MAGIC,
        file_of(DP, ONE)[:-37] + b"\x82" + file_of(DP, ONE)[-36:],
        file_of(DP, ONE, checksum=1),
        file_of(DP, ONE, summary=DP, checksum=1),
        file_of(DP, ONE, summary=DP[:-1]),
        file_of(DP, ONE, summary=record(0x0B, b"short")),
        file_of(DP, ONE, summary=record(0x04, b"short")),
        file_of(DP, ONE, summary=statistics_record({1: 2})),
        file_of(DP, channel_record(2, "dq"), ONE, ONE, summary=statistics_record({1: 1, 2: 1})),
        file_of(DP, ONE)[:-29] + struct.pack("<QQI", 2**40, 0, 0) + MAGIC,
        file_of(DP, ONE)[:-29] + struct.pack("<QQI", 3, 0, 0) + MAGIC,
    ],
    ids=range(32),
)
def test_damage_is_found(tmp_path: Path, data: bytes) -> None:
    assert error_of(tmp_path, data).code == "log_damaged"


def test_a_record_too_long_for_memory_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.ingest.mcap.messages, "LONGEST_RECORD", 1000)
    monkeypatch.setattr(pipeline.ingest.mcap.messages, "_BLOCK", 100)
    assert error_of(tmp_path, file_of(record(0x80, bytes(2000)))).code == "log_too_large"


@pytest.mark.parametrize("use_chunking", [True, False])
def test_a_file_cut_anywhere_is_truncated(tmp_path: Path, use_chunking: bool) -> None:
    data = mcap_of([b'{"value": 1}'] * 50, use_chunking=use_chunking)
    for length in range(8, len(data), 13):
        assert error_of(tmp_path, data[:length]).code == "log_truncated"
    # A record that ends as a file does: what is there is the start of another file's data.
    assert error_of(tmp_path, data[:-100] + data[-37:]).code == "log_damaged"
    assert error_of(tmp_path, data + b"\0").code == "log_truncated"
    assert error_of(tmp_path, data + data).code == "log_damaged"


@given(
    sizes=st.lists(st.integers(0, 40), max_size=12),
    lies=st.lists(st.tuples(st.integers(0, 12), st.integers(-40, 40)), max_size=3),
    data=st.data(),
)
def test_an_index_is_believed_only_as_far_as_it_is_true(
    sizes: list[int], lies: list[tuple[int, int]], data: st.DataObject
) -> None:
    """Payloads look like records, so that a wrong position leads to what looks like one."""
    inner = record(0x05, bytes(3))
    messages = [message_record(1, T0_NS, (inner * 4)[:size]) for size in sizes]
    records = memoryview(b"".join([DP, *messages, DP]))
    offsets, _ = record_offsets(records)
    positions = np.array(offsets[1:-1], np.int64)
    for which, step in lies:
        if which < positions.size:
            positions[which] += step
    some = data.draw(st.lists(st.booleans(), min_size=positions.size, max_size=positions.size))
    hint = np.sort(positions[np.array(some, np.bool_)])
    for cut in (len(records), data.draw(st.integers(0, len(records)))):
        found, found_end = offsets_in_chunk(records[:cut], hint)
        wanted, wanted_end = record_offsets(records[:cut])
        assert (found.tolist(), found_end) == (wanted, wanted_end)

"""MCAP files of others, and of our own where the official reader lets through what is refused."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span
from tests.pipeline.ingest.mcap_files import (
    DP,
    FACTORIES,
    SOURCE,
    T0_NS,
    all_values,
    chunk_record,
    file_of,
    followed,
    mcap_of,
    message_record,
    official_messages,
    officially,
    record,
    source_of,
    statistics_record,
)

# Recordings of others


def numbers_of(message: Any, before: str = "") -> Iterator[str]:
    """Paths to the numbers of a decoded message of ROS 2, the first three of an array."""
    if isinstance(message, bool | int | float):
        yield before.removeprefix(".")
    elif isinstance(message, list | bytes):
        for i, one in enumerate(message[:3]):
            yield from numbers_of(one, f"{before}[{i}]")
    elif not isinstance(message, str):
        for name in message.__slots__:
            yield from numbers_of(getattr(message, name), f"{before}.{name}")


def test_all_numbers_of_real_recordings_are_read_as_by_the_official_reader(
    foreign_files: Path,
) -> None:
    compared = 0
    for path in sorted((foreign_files / "mcap").glob("*.mcap")):
        if path.stem == "test_bag_for_seek_0":
            continue
        with path.open("rb") as file:
            reader = make_reader(
                file, validate_crcs=True, decoder_factories=[f() for f in FACTORIES]
            )
            messages = list(reader.iter_decoded_messages(log_time_order=False))
        for topic in {channel.topic for _, channel, *_ in messages}:
            decoded = [m for _, channel, _, m in messages if channel.topic == topic]
            times = [m.log_time // 1000 for _, channel, m, _ in messages if channel.topic == topic]
            paths = sorted({one for message in decoded for one in numbers_of(message)})
            for field, found in all_values(path, paths, topic).items():
                np.testing.assert_equal(found, [followed(message, field) for message in decoded])
                compared += len(found)
            if paths:
                channel = read_log(path, *source_of(paths[0], topic=topic)).channels
                assert channel["pressure_difference"].time_us.tolist() == times
    assert compared > 500


def test_the_clock_of_a_real_recording_from_before_1990_is_refused(foreign_files: Path) -> None:
    """Its log times are some milliseconds after 1970, as of a logger whose clock was never set."""
    path = foreign_files / "mcap" / "test_bag_for_seek_0.mcap"
    field = next(iter(numbers_of(official_messages(path, "topic1")[0])))
    source = source_of(field, topic="topic1")
    for reader in (read_log, time_span):
        with pytest.raises(LogError, match="before 1990") as raised:
            reader(path, *source)
        assert raised.value.code == "log_time"


# Where the two differ: nothing that is sound is refused, so that there is no second way to read it.
# What follows is all that the official reader lets through, each with what it makes of it.


def padded(payload: bytes) -> bytes:
    """A message of JSON as long as a changed one."""
    return payload.ljust(20)


SEVEN = message_record(1, T0_NS, padded(b'{"value": 7}'))
EIGHT = message_record(1, T0_NS, padded(b'{"value": 8}'))
STAND_IN = DP.replace(b"/hydraulics", b"/hydraulicz")


@pytest.mark.parametrize(
    ("data", "official", "code"),
    [
        # A compression that no one knows is taken for none.
        (file_of(chunk_record(DP + SEVEN, DP + SEVEN, "gzip")), [7.0], "log_compression"),
        # Without an index the checksums of chunks are not looked at, even where that is asked for.
        (
            file_of(chunk_record(DP + SEVEN, DP + EIGHT, "", checksum=zlib.crc32(DP + SEVEN))),
            [8.0],
            "log_damaged",
        ),
        # Nor, where the file can be read from its end, is that of the whole data section.
        (file_of(DP, EIGHT, data_end=record(0x0F, struct.pack("<I", 1))), [8.0], "log_damaged"),
        # The summary counts more messages than there are.
        (file_of(DP, SEVEN, summary=DP + statistics_record({1: 9})), [7.0], "log_damaged"),
        # The summary has another checksum.
        (file_of(DP, SEVEN, summary=DP, checksum=1), [7.0], "log_damaged"),
        # A channel changes its topic: the last declaration before a message holds.
        (file_of(STAND_IN, SEVEN, DP, EIGHT), [8.0], "log_damaged"),
    ],
    ids=["compression", "chunk", "data-section", "statistics", "summary", "channel"],
)
def test_files_that_only_the_official_reader_lets_through(
    tmp_path: Path, data: bytes, official: list[float], code: str
) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    assert [message["value"] for message in official_messages(path)] == official
    with pytest.raises(LogError) as raised:
        read_log(path, *SOURCE)
    assert raised.value.code == code


@pytest.mark.parametrize(
    ("definition", "payload", "official"),
    [
        # A text that is cut is read as far as it goes.
        ("float64 value\nstring name", struct.pack("<4sdI2s", b"\0\1\0\0", 7.0, 9, b"ab"), 7.0),
        # A list of parameters is read as if it were a plain message: the head of one is a reading.
        ("int32 value", struct.pack("<4sHHi", b"\0\3\0\0", 1, 4, 7), 4.0 * 2**16 + 1),
        # So is version 2 of the encoding, in which a number of eight bytes stands at four.
        ("int32 a\nint64 value", struct.pack("<4siqi", b"\0\7\0\0", 1, 7, 1), 2.0**32),
        # The first byte is not looked at.
        ("float64 value", struct.pack("<4sd", b"\7\1\0\0", 7.0), 7.0),
    ],
    ids=["cut", "parameter-list", "version-2", "unknown"],
)
def test_messages_of_ros_2_that_only_the_official_reader_lets_through(
    tmp_path: Path, definition: str, payload: bytes, official: float
) -> None:
    path = tmp_path / "log.mcap"
    schema = ("m/msg/M", "ros2msg", definition.encode())
    path.write_bytes(mcap_of([payload], schema, "cdr"))
    assert officially(path, "value") == [official]
    with pytest.raises(LogError) as raised:
        read_log(path, *source_of("value"))
    assert raised.value.code in ("log_type", "log_encoding")

"""Every way in which the same messages can stand in an MCAP file, read as officially."""

from __future__ import annotations

import json
import random
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span
from tests.pipeline.ingest.mcap.json_files import (
    DP,
    chunk_record,
    file_of,
    message_record,
    record,
    statistics_record,
)
from tests.pipeline.ingest.mcap_files import (
    FACTORIES,
    T0_NS,
    all_values,
    followed,
    mcap_of,
    official_messages,
    officially,
    source_of,
)

COUNT = 150
STAMP = "===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
WITHOUT_INDEX: dict[str, Any] = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}
CONTAINERS: dict[str, dict[str, Any]] = {
    **{f"chunks-{one.name}": {"compression": one} for one in CompressionType},
    "bare": {"use_chunking": False},
    "bare-data-crc": {"use_chunking": False, "enable_data_crcs": True},
}
TOPICS = ("/a", "/b", "/other")


@dataclass(frozen=True)
class Encoding:
    """A way to write seconds and nanoseconds that are both readings and a stamp."""

    message: str
    schema: tuple[str, str, bytes]
    fields: tuple[str, ...]
    stamp: str

    def payload(self, seconds: int, nanoseconds: int, rng: random.Random) -> bytes:
        """A message, of any length."""
        more = "x" * rng.randrange(9)
        if self.message == "json":
            stamp = {"sec": seconds, "nsec": nanoseconds}
            return json.dumps({"more": more, "at": stamp, "value": nanoseconds / 3}).encode()
        if self.message == "protobuf":
            return bytes(Timestamp(seconds=seconds, nanos=nanoseconds).SerializeToString())
        head = struct.pack("<4sI", b"\0\1\0\0", len(more) + 1) + more.encode() + b"\0"
        head += bytes(-len(head) % 4) + struct.pack("<iI", seconds, nanoseconds)
        return head + bytes((4 - len(head)) % 8) + struct.pack("<d", nanoseconds / 3)


def timestamp_descriptors() -> bytes:
    file = descriptor_pb2.FileDescriptorProto()
    Timestamp.DESCRIPTOR.file.CopyToProto(file)
    # Around it, as a stamp has a path: the message itself is none.
    outer = descriptor_pb2.FileDescriptorProto(
        name="m.proto", package="m", syntax="proto3", dependency=[file.name]
    )
    message = outer.message_type.add(name="M")
    message.field.add(name="at", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp")
    return bytes(descriptor_pb2.FileDescriptorSet(file=[file, outer]).SerializeToString())


ENCODINGS = {
    "json": Encoding("json", ("V", "jsonschema", b"{}"), ("at.sec", "at.nsec", "value"), "at"),
    "protobuf": Encoding(
        "protobuf",
        ("m.M", "protobuf", timestamp_descriptors()),
        ("at.seconds", "at.nanos"),
        "at",
    ),
    "cdr": Encoding(
        "cdr",
        (
            "m/msg/M",
            "ros2msg",
            f"string more\nbuiltin_interfaces/Time at\nfloat64 value\n{STAMP}".encode(),
        ),
        ("at.sec", "at.nanosec", "value"),
        "at",
    ),
}


def written(path: Path, encoding: Encoding, options: dict[str, Any]) -> None:
    """Three topics, of which one has no message that is wanted; times go back and forth."""
    rng = random.Random(12)  # noqa: S311
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1500, **options)
        writer.start()
        schema = writer.register_schema(*encoding.schema)
        ids = [writer.register_channel(topic, encoding.message, schema) for topic in TOPICS]
        for i in range(COUNT):
            seconds, nanoseconds = 1740808800 + i, rng.randrange(10**9)
            payload = encoding.payload(seconds, nanoseconds, rng)
            if encoding.message == "protobuf":
                payload = b"\x0a" + bytes([len(payload)]) + payload
            log_time = T0_NS + rng.randrange(10**12)
            writer.add_message(ids[rng.randrange(3)], log_time, payload, log_time - 10**9 - i)
        writer.finish()


def official_times(path: Path, topic: str, time_source: str) -> list[int]:
    with path.open("rb") as file:
        found = make_reader(file).iter_messages([topic], log_time_order=False)
        return [getattr(message, time_source) // 1000 for _, _, message in found]


@pytest.mark.parametrize("time", ["log_time", "publish_time", "stamp"])
@pytest.mark.parametrize("encoding", ENCODINGS.values(), ids=list(ENCODINGS))
@pytest.mark.parametrize("has_index", [True, False], ids=["indexed", "not-indexed"])
@pytest.mark.parametrize("container", CONTAINERS.values(), ids=list(CONTAINERS))
def test_every_combination_is_read_as_by_the_official_reader(
    tmp_path: Path, container: dict[str, Any], has_index: bool, encoding: Encoding, time: str
) -> None:
    path = tmp_path / "log.mcap"
    written(path, encoding, container | ({} if has_index else WITHOUT_INDEX))
    stamp = encoding.stamp if time == "stamp" else ""
    for topic in TOPICS[:2]:
        source = source_of(*encoding.fields, topic=topic, time=time, stamp=stamp)
        log = read_log(path, *source)
        decoded = official_messages(path, topic)
        assert log.rows == len(decoded) > 0
        assert (log.notes, log.refused_rows) == ((), 0)
        for field, channel in zip(encoding.fields, log.channels.values(), strict=True):
            assert channel.value.tolist() == [followed(one, field) for one in decoded]
            assert not channel.missing.any()
        seconds, parts = encoding.fields[:2]
        wanted = (
            [followed(m, seconds) * 10**6 + followed(m, parts) // 1000 for m in decoded]
            if stamp
            else official_times(path, topic, time)
        )
        assert channel.time_us.tolist() == wanted
        if stamp:
            assert time_span(path, *source) == (min(wanted), max(wanted))
    if not stamp:
        times = [one for topic in TOPICS for one in official_times(path, topic, time)]
        assert time_span(path, *source) == (min(times), max(times))


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
STAND_IN = DP.replace(b"dp", b"dq")


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
    assert [message["value"] for message in official_messages(path, "dp")] == official
    with pytest.raises(LogError) as raised:
        read_log(path, *source_of("value", topic="dp"))
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

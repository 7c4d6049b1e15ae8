"""Time stamps within MCAP messages, paths into them, and topics of two kinds."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from pipeline.errors import LogError
from pipeline.ingest import time_span
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.mcap_files import (
    JSON,
    TOPIC,
    error_of,
    mcap_of,
    read,
    source_of,
    values,
)

# Stamps within the messages


def stamped(folder: Path, data: bytes, stamp: str, time_format: str = "iso8601") -> list[int]:
    source = source_of("value", stamp=stamp, time_format=time_format, time_zone="Europe/Berlin")
    log = read(folder, data, source)
    times = log.channels["pressure_difference"].time_us
    assert time_span(folder / "log.mcap", *source) == (times.min(), times.max())
    assert log.rows == times.size
    return [int(time) - T0_US for time in times]


def json_mcap(*stamps: str) -> bytes:
    payloads = [b'{"value": 1, "head": {"t": %s}}' % stamp.encode() for stamp in stamps]
    return mcap_of(payloads, JSON, "json")


@pytest.mark.parametrize(
    ("stamps", "time_format", "wanted"),
    [
        (['"2025-03-01T06:00:00.5Z"', '"2025-03-01T06:00:01+00:00"'], "iso8601", [500_000, 10**6]),
        (['"2025-03-01T07:00:00"', '"2025-03-01T07:00:01"'], "iso8601", [0, 10**6]),
        (['"01.03.2025 07:00:02"'], "%d.%m.%Y %H:%M:%S", [2_000_000]),
        (["1740808800", "1740808801"], "epoch_s", [0, 10**6]),
        (["1740808800.25", "1740808801"], "epoch_s", [250_000, 10**6]),
        (["1740808800", "1740808801.5"], "epoch_s", [0, 1_500_000]),
        (["1740808800000000999", "1740808800000001000"], "epoch_ns", [0, 1]),
        (['"1740808800500"'], "epoch_ms", [500_000]),
        (['{"sec": 1740808800, "nsec": 1999}'], "iso8601", [1]),
        (['{"seconds": 1740808801, "nanos": 5000}'], "iso8601", [1_000_005]),
        (['{"sec": 1740808800, "nanosec": 0}', '"2025-03-01T06:00:01Z"'], "iso8601", [0, 10**6]),
    ],
)
def test_stamps_in_json_messages(
    tmp_path: Path, stamps: list[str], time_format: str, wanted: list[int]
) -> None:
    assert stamped(tmp_path, json_mcap(*stamps), "head.t", time_format) == wanted
    # One that does not parse sends the piece the slow way.
    slow = json_mcap(*stamps, *stamps, "true")
    assert stamped(tmp_path, slow, "/head.t", time_format) == [*wanted, *wanted]


def test_stamps_that_cannot_be_read_are_refused_and_most_of_them_an_error(tmp_path: Path) -> None:
    good = '{"sec": 1740808800, "nsec": 0}'
    bad = '{"sec": 1740808800, "nsec": 1000000000}'
    log = read(tmp_path, json_mcap(good, bad, good), source_of("value", stamp="head.t"))
    assert log.rows == 2
    assert log.notes == ("1 message without a readable time",)
    for stamps, name in (([bad], "head.t"), ([good], "head.none"), (["1740808800"], "head.t")):
        with pytest.raises(LogError, match=name) as raised:
            read(tmp_path, json_mcap(*stamps), source_of("value", stamp=name))
        assert raised.value.code == "log_time"


def test_a_stamp_may_be_a_reading_too(tmp_path: Path) -> None:
    numbers = mcap_of([b'{"t": 1740808800123}', b'{"t": 1740808801123}'], JSON, "json")
    log = read(tmp_path, numbers, source_of("t", stamp="t", time_format="epoch_ms"))
    channel = log.channels["pressure_difference"]
    assert channel.value.tolist() == [1740808800123.0, 1740808801123.0]
    assert (channel.time_us - T0_US).tolist() == [123_000, 1_123_000]
    text = mcap_of([b'{"t": "2025-03-01T06:00:00Z"}'], JSON, "json")
    with pytest.raises(LogError, match="2025-03-01T06:00:00Z") as raised:
        read(tmp_path, text, source_of("t", stamp="t"))
    assert raised.value.code == "log_type"


def test_stamps_in_ros_2_messages(tmp_path: Path) -> None:
    stamp = "===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    definition = f"string name\nbuiltin_interfaces/Time stamp\nfloat64 at\nint64 value\n{stamp}"
    payloads = [
        struct.pack("<4sI4siIdq", b"\0\1\0\0", 3, b"ab\0", 1740808800 + i, 999, 1740808800.25, i)
        for i in range(3)
    ]
    data = mcap_of(payloads, ("m/msg/M", "ros2msg", definition.encode()), "cdr")
    assert stamped(tmp_path, data, "stamp") == [0, 1_000_000, 2_000_000]
    assert stamped(tmp_path, data, "at", "epoch_s") == [250_000] * 3


# Paths, and topics of two kinds


def nested_json() -> Iterator[tuple[str, list[bytes], list[float | None]]]:
    yield "hydraulics.pressure.a", [b'{"hydraulics": {"pressure": {"a": 1, "b": 2}}}'], [1]
    yield "/hydraulics.pressure.a", [b'{"pressure": {"a": 3}}'], [3]
    yield "p[1]", [b'{"p": [1, 2]}', b'{"p": [5]}', b'{"p": null}', b"{}"], [2, None, None, None]
    yield "p[0].x", [b'{"p": [{"x": 1, "y": []}, 7]}', b'{"p": [{"x": 2}]}'], [1, 2]
    yield "p[1][0]", [b'{"p": [[1], [2, 3]]}', b'{"p": [[], []]}'], [2, None]
    yield r"engine\.rpm", [b'{"engine.rpm": 30, "engine": {"rpm": 4}}'], [30]
    yield "a.b", [b'{"a": {"b": 1}}', b'{"a": 5}', b'{"a": null}', b'{"a": {}}'], [1, *[None] * 3]
    yield "a.b", [b'{"a": {"b": 1, "b": 2}}', b'{"a": {"b": 1}, "a": {"b": 3}}'], [2, 3]


@pytest.mark.parametrize(("field", "payloads", "wanted"), list(nested_json()))
def test_paths_into_json_messages(
    tmp_path: Path, field: str, payloads: list[bytes], wanted: list[float | None]
) -> None:
    for beside, more in (([], []), ([b"?"], [None])):
        data = mcap_of([*payloads, *beside], JSON, "json")
        assert values(tmp_path, data, field) == [*wanted, *more]


def test_a_path_that_no_json_message_has_is_told_with_those_there_are(tmp_path: Path) -> None:
    data = mcap_of([b'{"p": {"a": 1, "b": [2, {"c": 3}]}}'], JSON, "json")
    with pytest.raises(LogError, match=r"'p\.a', 'p\.b\[0\]', 'p\.b\[1\]\.c'") as raised:
        read(tmp_path, data, source_of("p.c"))
    assert raised.value.code == "log_column_missing"


def test_a_value_and_a_part_of_it_are_both_read_where_they_are(tmp_path: Path) -> None:
    data = mcap_of([b'{"a": 1}', b'{"a": {"b": 2}}'], JSON, "json")
    log = read(tmp_path, data, source_of("a", "a.b"))
    np.testing.assert_array_equal(log.channels["pressure_difference"].value, [1.0, np.nan])
    np.testing.assert_array_equal(log.channels["high_port_pressure"].value, [np.nan, 2.0])


def test_encodings_that_are_not_read_are_told_with_their_topic(tmp_path: Path) -> None:
    for schema, encoding in (
        (("H", "omgidl", b"struct H {}"), "cdr"),
        (("H", "ros1msg", b"float64 value"), "ros1"),
        (("H", "flatbuffer", b""), "flatbuffer"),
        (("H", "", b""), "protobuf"),
        (("H", "protobuf", b""), "cdr"),
        (("", "", b""), "cbor"),
        (("", "", b""), ""),
    ):
        wrong = error_of(tmp_path, mcap_of([b""], schema, encoding), "value")
        assert wrong.code == "log_encoding"
        for named in (TOPIC, encoding, schema[1]):
            assert repr(named) in wrong.message


def test_a_topic_of_two_kinds_of_messages_is_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    number = writer.register_schema("m/H", "ros2msg", b"float64 seconds")
    writer.register_channel(TOPIC, "json", 0)
    writer.register_channel(TOPIC, "cdr", number)
    writer.finish()
    wrong = error_of(tmp_path, buffer.getvalue(), "seconds")
    assert (wrong.code, wrong.place) == ("log_encoding", TOPIC)
    assert "two kinds" in wrong.message

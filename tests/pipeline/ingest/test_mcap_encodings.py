"""Protobuf and ROS 2 messages in MCAP, against the format's own decoders."""

from __future__ import annotations

import io
import math
import random
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

import pipeline.ingest.mcap_log
from pipeline.errors import LogError
from pipeline.ingest import ChannelSource, LogSource, RawLog, read_log, time_span
from pipeline.ingest.mcap_paths import field_path

from .writers import T0_US

T0_NS = T0_US * 1000
FACTORIES = (ProtobufDecoderFactory, Ros2DecoderFactory)
CHANNELS = ("pressure_difference", "high_port_pressure", "low_port_pressure", "case_pressure")

HYDRAULICS = """\
# A motor's sensors.
uint8 STATE_OK=0
std_msgs/Header header
string<=20 sensor "none"  # bounded, with a default
bool running
uint8[] raw
float32 temperature 20.0
Port[2] ports
float64[3] pressures
Port[] more
int16[<=4] counts
string[] names
int64 total
builtin_interfaces/Duration since
================================================================================
MSG: motor_msgs/Port
char side
float64 pressure
Empty nothing
================================================================================
MSG: motor_msgs/Empty
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
FIELDS = (
    "header.stamp.sec",
    "temperature",
    "raw[1]",
    "ports[0].pressure",
    "ports[1].side",
    "pressures[2]",
    "more[1].pressure",
    "more[0].side",
    "counts[1]",
    "total",
    "since.nanosec",
)


def message(rng: random.Random, i: int) -> dict[str, Any]:
    """A message of HYDRAULICS whose texts and sequences have any length."""

    def port() -> dict[str, Any]:
        return {"side": rng.randrange(-128, 128), "pressure": rng.gauss(100, 20)}

    return {
        "header": {"stamp": {"sec": 1740808800 + i, "nanosec": 999}, "frame_id": "x" * (i % 7)},
        "sensor": "s" * rng.randrange(9),
        "running": bool(i % 2),
        "raw": bytes(rng.randrange(256) for _ in range(rng.randrange(4))),
        "temperature": rng.gauss(50, 1),
        "ports": [port(), port()],
        "pressures": [rng.gauss(100, 20) for _ in range(3)],
        "more": [port() for _ in range(rng.randrange(3))],
        "counts": [rng.randrange(-(2**15), 2**15) for _ in range(rng.randrange(4))],
        "names": ["n" * rng.randrange(5) for _ in range(rng.randrange(3))],
        "total": rng.randrange(-(2**63), 2**63),
        "since": {"sec": 1, "nanosec": rng.randrange(10**9)},
    }


def mcap_of(
    payloads: Sequence[bytes], schema: tuple[str, str, bytes], encoding: str, **options: Any
) -> bytes:
    buffer = io.BytesIO()
    writer = Writer(buffer, **{"chunk_size": 3000} | options)
    writer.start()
    number = writer.register_channel("/hydraulics", encoding, writer.register_schema(*schema))
    for i, payload in enumerate(payloads):
        writer.add_message(number, T0_NS + i * 1_000_000, payload, T0_NS)
    writer.finish()
    return buffer.getvalue()


def ros2(definition: str, messages: Sequence[Any], **options: Any) -> bytes:
    encode = serialize_dynamic("motor_msgs/msg/Hydraulics", definition)
    payloads = [encode["motor_msgs/msg/Hydraulics"](one) for one in messages]
    return ros2_of(definition, payloads, **options)


def ros2_of(definition: str, payloads: Sequence[bytes], **options: Any) -> bytes:
    schema = ("motor_msgs/msg/Hydraulics", "ros2msg", definition.encode())
    return mcap_of(payloads, schema, "cdr", **options)


def source_of(*fields: str, **options: Any) -> LogSource:
    channels = tuple(
        ChannelSource(name, "/hydraulics", "bar", field=field)
        for name, field in zip(CHANNELS, fields, strict=False)
    )
    return LogSource("mcap", channels, **options)


def read(folder: Path, data: bytes, source: LogSource) -> RawLog:
    path = folder / "log.mcap"
    path.write_bytes(data)
    return read_log(path, source)


def values(folder: Path, data: bytes, field: str) -> list[float | None]:
    """Readings of one field; None where missing."""
    channel = read(folder, data, source_of(field)).channels["pressure_difference"]
    pairs = zip(channel.value, channel.missing, strict=True)
    return [None if missing else float(value) for value, missing in pairs]


def code(folder: Path, data: bytes, field: str) -> str:
    with pytest.raises(LogError) as raised:
        read(folder, data, source_of(field))
    return raised.value.code


def officially(path: Path, topic: str, field: str) -> list[float | None]:
    """Readings of a field by the format's own reader; None beyond an array's end."""

    def follow(message: Any) -> float | None:
        for step in field_path(field):
            if isinstance(step, int):
                if step >= len(message):
                    return None
                message = message[step]
            else:
                message = getattr(message, step)
        return float(message)

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[factory() for factory in FACTORIES])
        decoded = reader.iter_decoded_messages([topic], log_time_order=False)
        return [follow(message) for *_, message in decoded]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_ros_2_messages_of_any_layout_are_read_as_by_the_official_reader(
    tmp_path: Path, compression: CompressionType, use_chunking: bool
) -> None:
    rng = random.Random(3)  # noqa: S311
    messages = [message(rng, i) for i in range(150)]
    data = ros2(HYDRAULICS, messages, compression=compression, use_chunking=use_chunking)
    for field in FIELDS:
        found = values(tmp_path, data, field)
        assert found == officially(tmp_path / "log.mcap", "/hydraulics", field)
        assert any(value is not None for value in found)


@given(seed=st.integers(0, 2**32), count=st.integers(1, 12))
def test_ros_2_messages_of_random_content(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    rng = random.Random(seed)  # noqa: S311
    folder = tmp_path_factory.mktemp("ros2")
    data = ros2(HYDRAULICS, [message(rng, i) for i in range(count)])
    for field in ("more[1].pressure", "counts[1]", "since.nanosec"):
        found = values(folder, data, field) if _has_any(field, data, folder) else []
        assert found in ([], officially(folder / "log.mcap", "/hydraulics", field))


def _has_any(field: str, data: bytes, folder: Path) -> bool:
    (folder / "log.mcap").write_bytes(data)
    return bool(officially(folder / "log.mcap", "/hydraulics", field))


def test_real_ros_2_recordings_are_read_as_by_the_official_reader(foreign_files: Path) -> None:
    for name, topic, fields in (
        ("cdr_test_0", "/test_topic", ("float32_value", "float64_value", "int64_value")),
        (
            "cdr_test_0",
            "/array_topic",
            ("float64_values[2]", "basic_types_values[1].int16_value", "char_values[0]"),
        ),
        ("talker", "/rosout", ("stamp.sec", "stamp.nanosec", "level", "line")),
    ):
        path = foreign_files / "mcap" / f"{name}.mcap"
        with path.open("rb") as file:
            times = [m.log_time // 1000 for _, _, m in make_reader(file).iter_messages([topic])]
        for field in fields:
            channel = ChannelSource("pressure_difference", topic, "bar", field=field)
            raw = read_log(path, LogSource("mcap", (channel,))).channels["pressure_difference"]
            assert raw.value.tolist() == officially(path, topic, field)
            assert sorted(raw.time_us.tolist()) == sorted(times)
            assert not raw.missing.any()


def test_a_real_recording_from_before_1990_is_refused(foreign_files: Path) -> None:
    """Its log times are some milliseconds after 1970."""
    channel = ChannelSource("pressure_difference", "topic1", "bar", field="int32_value")
    with pytest.raises(LogError, match="before 1990") as raised:
        read_log(foreign_files / "mcap" / "test_bag_for_seek_0.mcap", LogSource("mcap", (channel,)))
    assert raised.value.code == "log_time"


def test_both_byte_orders_in_one_file(tmp_path: Path) -> None:
    definition = "uint8 a\nfloat64 value\nstring text\nint16 last\n"

    def payload(order: str, mark: int, value: float) -> bytes:
        head = struct.pack("<BBBB", 0, mark, 0, 0)
        body = struct.pack(order + "B7xdI3s", 1, value, 3, b"ab\0")
        return head + body + struct.pack(order + "xh", int(value))

    data = ros2_of(definition, [payload("<", 1, 1.5), payload(">", 0, 2.5), payload("<", 1, 3.5)])
    assert values(tmp_path, data, "value") == [1.5, 2.5, 3.5]
    assert values(tmp_path, data, "last") == [1, 2, 3]
    assert officially(tmp_path / "log.mcap", "/hydraulics", "last") == [1, 2, 3]


def test_a_ros_2_message_that_is_cut_is_missing_and_counted(tmp_path: Path) -> None:
    definition = "float64 value\nPoint[] points\n===\nMSG: motor_msgs/Point\nfloat64 x\nstring s\n"
    good = struct.pack("<4sdI", b"\0\1\0\0", 7.0, 0)
    endless = struct.pack("<4sdI", b"\0\1\0\0", 7.0, 2**32 - 1)
    other = struct.pack("<4sdI", b"\0\7\0\0", 7.0, 0)
    data = ros2_of(definition, [good, b"", good[:3], good[:10], good[:-1], endless, other, good])
    channel = read(tmp_path, data, source_of("value")).channels["pressure_difference"]
    assert channel.missing.tolist() == [False, *[True] * 6, False]
    assert channel.unparsed == 6
    assert code(tmp_path, ros2_of(definition, [b"", endless]), "value") == "log_type"


@given(payload=st.binary(max_size=120), cut=st.integers(0, 400))
def test_any_bytes_for_a_ros_2_message_do_no_harm(
    tmp_path_factory: pytest.TempPathFactory, payload: bytes, cut: int
) -> None:
    rng = random.Random(cut)  # noqa: S311
    encode = serialize_dynamic("m/msg/H", HYDRAULICS.replace("Port[", "motor_msgs/Port["))
    good = encode["m/msg/H"](message(rng, cut))
    flipped = bytearray(good)
    flipped[4 + cut % (len(good) - 4)] ^= 0x80
    payloads = [good, b"\0\1\0\0" + payload, b"\0\0\0\0" + payload, good[:cut], bytes(flipped)]
    found = values(tmp_path_factory.mktemp("any"), ros2_of(HYDRAULICS, payloads), "total")
    assert len(found) == 5
    assert found[0] is not None


@pytest.mark.parametrize(
    ("definition", "field", "wrong"),
    [
        ("float64 value", "pressure", "log_column_missing"),
        ("float64 value", "value.a", "log_column_missing"),
        ("float64[2] value", "value[2]", "log_column_missing"),
        ("float64 value", "value[0]", "log_column_missing"),
        ("float64[2] value", "value", "log_type"),
        ("string value", "value", "log_type"),
        ("Port value\n===\nMSG: motor_msgs/Port\nint8 a", "value", "log_type"),
        ("Port value", "value.a", "log_damaged"),
        ("Hydraulics value", "value", "log_damaged"),
        ("float64", "value", "log_damaged"),
        ("float64[0] value", "value[0]", "log_damaged"),
        ("float64[ value", "value", "log_damaged"),
        ("float64 value\nfloat32 value", "value", "log_damaged"),
        ("float64[99999999999999999999] value", "value[1]", "log_damaged"),
        ("time at\nfloat64 value", "value", "log_encoding"),
    ],
)
def test_definitions_and_fields_that_do_not_serve_are_told(
    tmp_path: Path, definition: str, field: str, wrong: str
) -> None:
    assert code(tmp_path, ros2_of(definition, [bytes(12)]), field) == wrong


def test_arrays_too_large_for_any_message_are_not_walked(tmp_path: Path) -> None:
    inner = "===\nMSG: motor_msgs/A\nB[1000000000] b\n===\nMSG: motor_msgs/B\nstring s\n"
    payload = b"\0\1\0\0" + bytes(100)
    assert code(tmp_path, ros2_of("float64 value\nA[100000000] a\n" + inner, [payload]), "value")


def test_schemas_in_other_languages_are_told(tmp_path: Path) -> None:
    for schema, encoding in (
        (("H", "omgidl", b"struct H {}"), "cdr"),
        (("H", "ros1msg", b"float64 value"), "ros1"),
        (("H", "", b""), "protobuf"),
    ):
        assert code(tmp_path, mcap_of([b""], schema, encoding), "value") == "log_encoding"


# Protobuf

Descriptor = descriptor_pb2.FieldDescriptorProto


def _message(name: str, fields: Sequence[tuple[str, int, str, bool]]) -> Any:
    made = descriptor_pb2.DescriptorProto(name=name)
    for number, (field, kind, type_name, repeated) in enumerate(fields, 1):
        label = Descriptor.LABEL_REPEATED if repeated else Descriptor.LABEL_OPTIONAL
        made.field.add(
            name=field, number=number, type=kind, type_name=type_name or None, label=label
        )
    return made


def descriptors() -> Any:
    """Motor messages in two files, the one that imports first."""
    port = _message("Port", [("pressure", 1, "", False), ("side", 13, "", False)])
    motor = _message(
        "Hydraulics",
        [
            ("stamp", 11, ".google.protobuf.Timestamp", False),
            ("port", 11, ".motor.Port", False),
            ("ports", 11, ".motor.Port", True),
            ("values", 2, "", True),
            ("total", 3, "", False),
            ("running", 8, "", False),
            ("name", 9, "", False),
            ("maybe", 1, "", False),
            ("count", 18, "", False),
            ("mode", 14, ".motor.Mode", False),
        ],
    )
    motor.oneof_decl.add(name="_maybe")
    motor.field[7].oneof_index = 0
    motor.field[7].proto3_optional = True
    mode = descriptor_pb2.EnumDescriptorProto(name="Mode")
    mode.value.add(name="OFF", number=0)
    stamp = descriptor_pb2.FileDescriptorProto()
    Timestamp.DESCRIPTOR.file.CopyToProto(stamp)
    ports = descriptor_pb2.FileDescriptorProto(
        name="port.proto", package="motor", syntax="proto3", message_type=[port]
    )
    main = descriptor_pb2.FileDescriptorProto(
        name="motor.proto",
        package="motor",
        syntax="proto3",
        dependency=["port.proto", stamp.name],
        message_type=[motor],
        enum_type=[mode],
    )
    return descriptor_pb2.FileDescriptorSet(file=[main, ports, stamp])


DESCRIPTORS = descriptors()
SCHEMA = ("motor.Hydraulics", "protobuf", DESCRIPTORS.SerializeToString())


@pytest.fixture(scope="module")
def hydraulics() -> Callable[..., bytes]:
    """Maker of payloads."""
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(DESCRIPTORS.file):
        pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName("motor.Hydraulics"))
    return lambda **fields: made(**fields).SerializeToString()


def protobuf(payloads: Sequence[bytes], **options: Any) -> bytes:
    return mcap_of(payloads, SCHEMA, "protobuf", **options)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_protobuf_messages_are_read_as_by_the_official_reader(
    tmp_path: Path, hydraulics: Callable[..., bytes], compression: CompressionType
) -> None:
    rng = random.Random(5)  # noqa: S311
    payloads = [
        hydraulics(
            port={"pressure": rng.gauss(100, 20), "side": i % 2},
            ports=[{"pressure": rng.random()} for _ in range(rng.randrange(4))],
            values=[rng.random() for _ in range(rng.randrange(4))],
            total=rng.randrange(-(2**63), 2**63),
            count=-i,
            name="x" * (i % 5),
        )
        for i in range(200)
    ]
    data = protobuf(payloads, compression=compression)
    for field in ("port.pressure", "port.side", "ports[2].pressure", "values[0]", "total", "count"):
        found = values(tmp_path, data, field)
        assert found == officially(tmp_path / "log.mcap", "/hydraulics", field)
        assert any(value is not None for value in found)


def test_a_protobuf_field_that_is_not_set_is_missing_where_that_can_be_told(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    data = protobuf([hydraulics(), hydraulics(port={}, maybe=0.0, values=[1.0])])
    assert values(tmp_path, data, "total") == [0.0, 0.0]
    assert values(tmp_path, data, "port.pressure") == [None, 0.0]
    assert values(tmp_path, data, "maybe") == [None, 0.0]
    assert values(tmp_path, data, "values[0]") == [None, 1.0]


def test_payloads_that_are_no_protobuf_are_missing_and_counted(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    data = protobuf([hydraulics(total=5), b"\xff\xff", hydraulics(port={"pressure": 1})[:-1]])
    channel = read(tmp_path, data, source_of("total")).channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, True]
    assert channel.unparsed == 2


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("pressure", "log_column_missing"),
        ("port.bar", "log_column_missing"),
        ("total.a", "log_column_missing"),
        ("total[0]", "log_column_missing"),
        ("ports.pressure", "log_column_missing"),
        ("values", "log_type"),
        ("port", "log_type"),
        ("name", "log_type"),
        ("running", "log_type"),
        ("mode", "log_type"),
    ],
)
def test_protobuf_fields_that_do_not_serve_are_told(
    tmp_path: Path, hydraulics: Callable[..., bytes], field: str, wrong: str
) -> None:
    assert code(tmp_path, protobuf([hydraulics(total=1)]), field) == wrong


def test_descriptors_that_contradict_themselves_are_damage(tmp_path: Path) -> None:
    one_missing = descriptor_pb2.FileDescriptorSet(file=DESCRIPTORS.file[:1]).SerializeToString()
    for name, data in (
        ("motor.Hydraulics", b"\xff"),
        ("motor.Hydraulics", b""),
        ("motor.Hydraulics", one_missing),
        ("motor.Unknown", SCHEMA[2]),
    ):
        broken = mcap_of([b""], (name, "protobuf", data), "protobuf")
        assert code(tmp_path, broken, "total") == "log_damaged"


def test_without_the_extra_the_error_says_which(
    tmp_path: Path, hydraulics: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    with pytest.raises(LogError, match=r"motor-leakage\[protobuf\]") as raised:
        read(tmp_path, protobuf([hydraulics(total=1)]), source_of("total"))
    assert raised.value.code == "log_extra_missing"


# Stamps within the messages


def stamped(folder: Path, data: bytes, stamp: str, time_format: str = "iso8601") -> list[int]:
    source = source_of("value", stamp=stamp, time_format=time_format, time_zone="Europe/Berlin")
    log = read(folder, data, source)
    times = log.channels["pressure_difference"].time_us
    assert time_span(folder / "log.mcap", source) == (times.min(), times.max())
    assert log.rows == times.size
    return [int(time) - T0_US for time in times]


def json_mcap(*stamps: str) -> bytes:
    payloads = [b'{"value": 1, "head": {"t": %s}}' % stamp.encode() for stamp in stamps]
    return mcap_of(payloads, ("V", "jsonschema", b"{}"), "json")


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
    assert (log.rows, log.refused_rows) == (2, 1)
    assert log.notes == ("1 messages without a readable time",)
    for stamps, name in (([bad], "head.t"), ([good], "head.none"), (["1740808800"], "head.t")):
        with pytest.raises(LogError, match=name) as raised:
            read(tmp_path, json_mcap(*stamps), source_of("value", stamp=name))
        assert raised.value.code == "log_time"


def test_stamps_in_ros_2_and_protobuf_messages(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    definition = HYDRAULICS.replace("int64 total", "int64 value")
    rng = random.Random(1)  # noqa: S311
    messages = [message(rng, i) for i in range(3)]
    expected = [0, 1_000_000, 2_000_000]
    assert stamped(tmp_path, ros2(definition, messages), "header.stamp") == expected
    numbered = "int64 value\nfloat64 at\n"
    moments = [{"value": 1, "at": 1740808800.25 + i} for i in range(2)]
    assert stamped(tmp_path, ros2(numbered, moments), "at", "epoch_s") == [250_000, 1_250_000]
    payloads = [hydraulics(total=i, stamp={"seconds": 1740808800 + i}) for i in range(3)]
    source = source_of("total", stamp="stamp")
    log = read(tmp_path, protobuf([*payloads, hydraulics(total=9)]), source)
    times = log.channels["pressure_difference"].time_us - T0_US
    assert times.tolist() == expected
    assert log.refused_rows == 1


# Paths, and topics of more than one encoding


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
    schema = ("V", "jsonschema", b"{}")
    for beside, more in (([], []), ([b"?"], [None])):
        data = mcap_of([*payloads, *beside], schema, "json")
        assert values(tmp_path, data, field) == [*wanted, *more]


def test_a_path_that_no_json_message_has_is_told_with_those_there_are(tmp_path: Path) -> None:
    data = mcap_of([b'{"p": {"a": 1, "b": [2, {"c": 3}]}}'], ("V", "jsonschema", b"{}"), "json")
    with pytest.raises(LogError, match=r"'p\.a', 'p\.b\[0\]', 'p\.b\[1\]\.c'") as raised:
        read(tmp_path, data, source_of("p.c"))
    assert raised.value.code == "log_column_missing"


def test_a_value_and_a_part_of_it_are_both_read_where_they_are(tmp_path: Path) -> None:
    data = mcap_of([b'{"a": 1}', b'{"a": {"b": 2}}'], ("V", "jsonschema", b"{}"), "json")
    log = read(tmp_path, data, source_of("a", "a.b"))
    np.testing.assert_array_equal(log.channels["pressure_difference"].value, [1.0, np.nan])
    np.testing.assert_array_equal(log.channels["high_port_pressure"].value, [np.nan, 2.0])


def test_a_topic_whose_encoding_changes_keeps_its_order(
    tmp_path: Path, hydraulics: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, chunk_size=200)
    writer.start()
    ids = {
        "json": writer.register_channel("/hydraulics", "json", 0),
        "protobuf": writer.register_channel(
            "/hydraulics", "protobuf", writer.register_schema(*SCHEMA)
        ),
        "cdr": writer.register_channel(
            "/hydraulics", "cdr", writer.register_schema("m/H", "ros2msg", b"float64 total")
        ),
    }
    rng = random.Random(4)  # noqa: S311
    for i in range(100):
        encoding = rng.choice(list(ids))
        payload = {
            "json": b'{"total": %d}' % i,
            "protobuf": hydraulics(total=i),
            "cdr": struct.pack("<4sd", b"\0\1\0\0", i),
        }[encoding]
        writer.add_message(ids[encoding], T0_NS + i, payload, T0_NS)
    writer.finish()
    for size in (1, 50, 2**20):
        monkeypatch.setattr(pipeline.ingest.mcap_log, "_PIECE", size)
        assert values(tmp_path, buffer.getvalue(), "total") == [float(i) for i in range(100)]


def test_long_logs_are_read_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(8)  # noqa: S311
    data = ros2(HYDRAULICS, [message(rng, i) for i in range(300)], chunk_size=2000)
    whole = read(tmp_path, data, source_of("total", "more[0].pressure", "temperature"))
    monkeypatch.setattr(pipeline.ingest.mcap_log, "_PIECE", 5000)
    parts = read(tmp_path, data, source_of("total", "more[0].pressure", "temperature"))
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(channel.value, parts.channels[name].value)
        np.testing.assert_array_equal(channel.time_us, parts.channels[name].time_us)


def test_nan_in_a_message_is_no_missing_sample(tmp_path: Path) -> None:
    data = ros2("float32 value", [{"value": math.nan}, {"value": math.inf}])
    channel = read(tmp_path, data, source_of("value")).channels["pressure_difference"]
    assert not channel.missing.any()
    np.testing.assert_array_equal(channel.value, [np.nan, np.inf])
    assert replace(source_of("value"), salvage=True).salvage

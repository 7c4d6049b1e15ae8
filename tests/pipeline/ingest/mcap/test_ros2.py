"""ROS 2 messages in MCAP, made and recorded by others, against the format's own decoder."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2._dynamic import serialize_dynamic

from pipeline.ingest import read_log
from tests.pipeline.ingest.mcap_files import (
    HEADER,
    all_values,
    error_of,
    followed,
    mcap_of,
    official_messages,
    officially,
    read,
    source_of,
    values,
)

NAME = "motor_msgs/msg/Hydraulics"
HYDRAULICS = f"""\
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
string<=5[<=3] names
int64 total
builtin_interfaces/Duration since
================================================================================
MSG: motor_msgs/Port
char side
float64 pressure
Empty nothing
================================================================================
MSG: motor_msgs/Empty
{HEADER}"""
FIELDS = (
    "header.stamp.sec",
    "running",
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


def encoded(messages: Sequence[Any]) -> list[bytes]:
    """Payloads of HYDRAULICS as the format's own writer makes them."""
    return list(map(serialize_dynamic(NAME, HYDRAULICS)[NAME], messages))


def ros2_of(definition: str, payloads: Sequence[bytes]) -> bytes:
    return mcap_of(payloads, (NAME, "ros2msg", definition.encode()), "cdr")


def message(rng: random.Random, i: int, shape: random.Random | None = None) -> dict[str, Any]:
    """A message of HYDRAULICS whose texts and sequences have any length, or that of a shape."""
    shape = shape or rng

    def port() -> dict[str, Any]:
        return {"side": rng.randrange(-128, 128), "pressure": rng.gauss(100, 20)}

    return {
        "header": {
            "stamp": {"sec": 1740808800 + i, "nanosec": 999},
            "frame_id": "x" * shape.randrange(7),
        },
        "sensor": "s" * shape.randrange(9),
        "running": bool(i % 2),
        "raw": bytes(rng.randrange(256) for _ in range(shape.randrange(4))),
        "temperature": rng.gauss(50, 1),
        "ports": [port(), port()],
        "pressures": [rng.gauss(100, 20) for _ in range(3)],
        "more": [port() for _ in range(shape.randrange(3))],
        "counts": [rng.randrange(-(2**15), 2**15) for _ in range(shape.randrange(4))],
        "names": ["n" * shape.randrange(5) for _ in range(shape.randrange(3))],
        "total": rng.randrange(-(2**63), 2**63),
        "since": {"sec": 1, "nanosec": rng.randrange(10**9)},
    }


@pytest.mark.parametrize("n_shapes", [1, 2, 150])
def test_messages_of_any_layout_are_read_as_by_the_official_reader(
    tmp_path: Path, n_shapes: int
) -> None:
    rng = random.Random(3)  # noqa: S311
    shapes = [random.Random(453 + i % n_shapes) for i in range(150)]  # noqa: S311
    messages = [message(rng, i, shape) for i, shape in enumerate(shapes)]
    path = tmp_path / "log.mcap"
    path.write_bytes(ros2_of(HYDRAULICS, encoded(messages)))
    for field in FIELDS:  # one at a time: bytes are read message by message
        found = all_values(path, [field])[field]
        assert found == officially(path, field)
        assert any(value is not None for value in found)


def test_both_byte_orders_in_one_file(tmp_path: Path) -> None:
    definition = "uint8 a\nfloat64 value\nstring text\nint16 last\n"

    def payload(order: str, mark: int, value: float) -> bytes:
        head = struct.pack("<BBBB", 0, mark, 0, 0)
        body = struct.pack(order + "B7xdI3s", 1, value, 3, b"ab\0")
        return head + body + struct.pack(order + "xh", int(value))

    data = ros2_of(definition, [payload("<", 1, 1.5), payload(">", 0, 2.5), payload("<", 1, 3.5)])
    assert values(tmp_path, data, "value") == [1.5, 2.5, 3.5]
    assert values(tmp_path, data, "last") == [1, 2, 3]
    assert officially(tmp_path / "log.mcap", "last") == [1, 2, 3]


@pytest.mark.parametrize("second", [2, 3, 6, 7, 9, 11])
def test_other_representations_are_refused(tmp_path: Path, second: int) -> None:
    good, other = (struct.pack("<BBBBd", 0, mark, 0, 0, 7.0) for mark in (1, second))
    wrong = error_of(tmp_path, ros2_of("float64 value", [other, b"", other]), "value")
    assert wrong.code == "log_encoding"
    assert "representation of DDS" in wrong.message
    # A stray one is a message that cannot be read, as damage may have made it so.
    data = ros2_of("float64 value", [good, other, good])
    channel = read(tmp_path, data, source_of("value")).channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, False]
    assert channel.unparsed == 1


CDR = b"\0\1\0\0"
POINTS = "float64 value\nPoint[] points\n===\nMSG: motor_msgs/Point\nfloat64 x\nstring s\n"
WHOLE = struct.pack("<4sdI", CDR, 7.0, 0)
WITH_RAW = struct.pack("<4sdIB3xI5s", CDR, 7.0, 1, 1, 5, b"text\0")
LAST = struct.pack("<4sdi", CDR, 7.0, 1)


@pytest.mark.parametrize(
    ("definition", "payloads", "wanted"),
    [
        (POINTS, [WHOLE, b"", WHOLE[:3], WHOLE[:10], WHOLE[:-1], WHOLE], [7, *[None] * 4, 7]),
        # Of a sequence without an end, and of another length than it says.
        (
            POINTS,
            [
                WHOLE,
                struct.pack("<4sdI", CDR, 7.0, 2**32 - 1),
                struct.pack("<4sdI4xdI", CDR, 7.0, 1, 1.0, 9),
            ],
            [7, None, None],
        ),
        # In other representations.
        (POINTS, [WHOLE, b"\0\x33" + WHOLE[2:], b"\7" + WHOLE[1:]], [7, None, None]),
        ("float64 value\nint32 last", [LAST, LAST[:-1], LAST[:-4]], [7, None, None]),
        (
            "float64 value\nuint8[] raw\nstring s",
            [
                WITH_RAW,
                struct.pack("<4sdIB", CDR, 7.0, 9, 1),
                struct.pack("<4sdII", CDR, 7.0, 0, 1),
                WITH_RAW[:-3],
            ],
            [7, None, None, None],
        ),
        ("bool value", [CDR + bytes([byte]) for byte in (0, 1, 2)], [0, 1, 1]),
    ],
)
def test_a_message_that_is_cut_is_missing_and_counted(
    tmp_path: Path, definition: str, payloads: list[bytes], wanted: list[float | None]
) -> None:
    channel = read(tmp_path, ros2_of(definition, payloads)).channels["pressure_difference"]
    assert channel.missing.tolist() == [value is None for value in wanted]
    assert channel.value[~channel.missing].tolist() == [v for v in wanted if v is not None]
    assert channel.unparsed == wanted.count(None)


@given(payload=st.binary(max_size=120), cut=st.integers(0, 400))
def test_any_bytes_for_a_message_do_no_harm(
    tmp_path_factory: pytest.TempPathFactory, payload: bytes, cut: int
) -> None:
    rng = random.Random(cut)  # noqa: S311
    (good,) = encoded([message(rng, cut)])
    flipped = bytearray(good)
    flipped[4 + cut % (len(good) - 4)] ^= 0x80
    payloads = [good, b"\0\1\0\0" + payload, b"\0\0\0\0" + payload, good[:cut], bytes(flipped)]
    found = values(tmp_path_factory.mktemp("any"), ros2_of(HYDRAULICS, payloads), "total")
    assert len(found) == 5
    assert found[0] is not None


SERVICE = f"{'=' * 80}\nSRV: motor_msgs/srv/Measure_Event\nuint8 a\n---\nfloat64 b\n"


@pytest.mark.parametrize(
    ("definition", "field", "wrong"),
    [
        # Of a service as rosbag2 records it (its issue 2365), and what is not read.
        (SERVICE, "b", "log_encoding"),
        ("wstring name\nfloat64 value\n", "value", "log_encoding"),
        ("float64 value", "pressure", "log_column_missing"),
        ("float64 value", "value.a", "log_column_missing"),
        ("float64[2] value", "value[2]", "log_column_missing"),
        ("float64[2] value", "value.a", "log_column_missing"),
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
        ("time at\nfloat64 value", "value", "log_encoding"),
        ("float64[300000] many\nfloat64 value", "value", "log_too_large"),
    ],
)
def test_definitions_and_fields_that_do_not_serve_are_refused(
    tmp_path: Path, definition: str, field: str, wrong: str
) -> None:
    assert error_of(tmp_path, ros2_of(definition, [bytes(12)]), field).code == wrong


def test_a_field_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    wrong = error_of(tmp_path, ros2_of(HYDRAULICS, []), "pressure")
    for there in ("'header.stamp.sec'", "'ports[0].pressure'", "'more[0].side'", "'raw[0]'"):
        assert there in wrong.message
    assert "frame_id" not in wrong.message


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
            topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
        for topic in topics:
            times, messages = zip(*official_messages(path, topic), strict=True)
            paths = sorted({one for message in messages for one in numbers_of(message)})
            for field, found in all_values(path, paths, topic).items():
                np.testing.assert_equal(found, [followed(message, field) for message in messages])
                compared += len(found)
            if paths:
                channel = read_log(path, *source_of(paths[0], topic=topic)).channels
                assert channel["pressure_difference"].time_us.tolist() == list(times)
    assert compared > 500

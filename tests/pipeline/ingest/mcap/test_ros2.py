"""ROS 2 messages in MCAP, against the format's own decoder."""

from __future__ import annotations

import functools
import math
import random
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mcap_ros2._dynamic
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap_ros2._cdr import CdrWriter, EncapsulationKind
from mcap_ros2._dynamic import serialize_dynamic

import pipeline.ingest.mcap.log
from pipeline.errors import LogError
from pipeline.ingest.mcap.topics import read_topics
from tests.pipeline.ingest.mcap_files import (
    Value,
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


def encoded(
    definition: str, messages: Sequence[Any], kind: EncapsulationKind = EncapsulationKind.CDR_LE
) -> list[bytes]:
    """Payloads as the format's own writer makes them, in either byte order."""
    in_order = functools.partial(CdrWriter, kind=kind)
    encode = serialize_dynamic(NAME, definition)[NAME]
    with patch.object(mcap_ros2._dynamic, "CdrWriter", in_order):
        return [encode(one) for one in messages]


def ros2(definition: str, messages: Sequence[Any], **options: Any) -> bytes:
    return ros2_of(definition, encoded(definition, messages), **options)


def ros2_of(
    definition: str, payloads: Sequence[bytes], language: str = "ros2msg", **options: Any
) -> bytes:
    return mcap_of(payloads, (NAME, language, definition.encode()), "cdr", **options)


def code(folder: Path, data: bytes, field: str) -> str:
    return error_of(folder, data, field).code


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_messages_of_any_layout_are_read_as_by_the_official_reader(
    tmp_path: Path, compression: CompressionType, use_chunking: bool
) -> None:
    rng = random.Random(3)  # noqa: S311
    messages = [message(rng, i) for i in range(150)]
    data = ros2(HYDRAULICS, messages, compression=compression, use_chunking=use_chunking)
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    for field, found in all_values(path, FIELDS).items():
        assert found == officially(path, field)
        assert any(value is not None for value in found)


# Events of services

SERVICE = "motor_msgs/srv/Measure"
MEASURE = """\
uint8 CHANNEL_A=0
uint8[] channels
---
Port[] ports  # as they are
float64 total
"""
PORT = """\
================================================================================
MSG: motor_msgs/Port
float64 pressure
"""
# As rosbag2 records them, and in whole, as other tools want them (ros2/rosbag2, issue 2365).
AS_RECORDED = f"{'=' * 80}\nSRV: {SERVICE}\n{MEASURE}\n{PORT}"
AS_A_MESSAGE = f"""\
service_msgs/ServiceEventInfo info
motor_msgs/Measure_Request[<=1] request
motor_msgs/Measure_Response[<=1] response
================================================================================
MSG: motor_msgs/Measure_Request
{MEASURE.partition("---")[0]}
================================================================================
MSG: motor_msgs/Measure_Response
{MEASURE.partition("---")[2]}
================================================================================
MSG: service_msgs/ServiceEventInfo
uint8 REQUEST_SENT = 0
uint8 event_type
builtin_interfaces/Time stamp
char[16] client_gid
int64 sequence_number
{PORT}"""


def service_event(i: int) -> dict[str, Any]:
    """Requests and responses in turn; a response has any number of ports."""
    info = {
        "event_type": i % 4,
        "stamp": {"sec": 1740808800 + i, "nanosec": 9},
        "client_gid": [-1] * 16,
        "sequence_number": i,
    }
    ports = [{"pressure": 100.0 + i + port} for port in range(i % 3)]
    asked, answered = [{"channels": bytes(i % 5)}], [{"ports": ports, "total": 1.5 * i}]
    return {
        "info": info,
        "request": [] if i % 2 else asked,
        "response": answered if i % 2 else [],
    }


@pytest.mark.parametrize(
    "definition",
    [AS_RECORDED, AS_A_MESSAGE, f"{MEASURE}\n{PORT}"],
    ids=["recorded", "message", "without heading"],
)
def test_events_of_a_service_are_read(tmp_path: Path, definition: str) -> None:
    name, events = f"{SERVICE}_Event", [service_event(i) for i in range(40)]
    # The format's own writer knows no names of services' messages.
    encode = serialize_dynamic(NAME, AS_A_MESSAGE.replace("Measure_", "Measure"))[NAME]
    data = mcap_of([encode(one) for one in events], (name, "ros2msg", definition.encode()), "cdr")
    assert values(tmp_path, data, "info.sequence_number") == list(range(40))
    totals = [1.5 * i if i % 2 else None for i in range(40)]
    assert values(tmp_path, data, "response[0].total") == totals
    pressures = [100.0 + i if i % 2 and i % 3 else None for i in range(40)]
    assert values(tmp_path, data, "response[0].ports[0].pressure") == pressures
    (topic,) = read_topics(tmp_path / "log.mcap")
    assert not topic.fault


def test_events_of_a_service_that_is_not_read_are_no_damage(tmp_path: Path) -> None:
    """Messages of IDL within a service: rosbag2 mixes both languages."""
    mixed = f"{AS_RECORDED}\n{'=' * 80}\nIDL: motor_msgs/Port\nmodule motor_msgs {{}};"
    data = mcap_of([bytes(8)], (f"{SERVICE}_Event", "ros2idl", mixed.encode()), "cdr")
    assert code(tmp_path, data, "info.sequence_number") == "log_encoding"


# Any definition, in both languages, and any content


@dataclass(frozen=True)
class Member:
    """A field of a generated definition."""

    name: str
    base: str
    many: str

    @property
    def count(self) -> int | None:
        """Length of an array; None: a sequence."""
        return int(self.many[1:-1]) if self.many[1:-1].isdigit() else None

    @property
    def in_idl(self) -> str:
        """Declaration of the field in IDL, as ROS 2's adapter writes it."""
        base = IDL_NAMES.get(self.base, f"motor_msgs::msg::{self.base}")
        if self.count is not None:
            return f"{self.typedef[1]} {self.name};"
        return f"{f'sequence<{base}>' if self.many else base} {self.name};"

    @property
    def typedef(self) -> tuple[str, str]:
        """Declaration of an array's type, and its name."""
        base = IDL_NAMES.get(self.base, f"motor_msgs::msg::{self.base}")
        name = base.replace("::", "__").replace(" ", "_").replace("<", "__").replace(">", "")
        return f"typedef {base} {name}__{self.count}[{self.count}];", f"{name}__{self.count}"


Definition = Mapping[str, Sequence[Member]]
"""Members by name of the message, the root first."""

IDL_NAMES = {
    "bool": "boolean",
    "byte": "octet",
    # The adapter makes it unsigned, where the format's own decoder reads it as signed.
    "char": "int8",
    "float32": "float",
    "float64": "double",
    "string": "string",
    "string<=9": "string<9>",
    "int8": "int8",
    "uint8": "uint8",
    "int16": "short",
    "uint16": "unsigned short",
    "int32": "long",
    "uint32": "unsigned long",
    "int64": "long long",
    "uint64": "unsigned long long",
}


def in_msg(definition: Definition) -> str:
    parts = []
    for name, members in definition.items():
        heading = "" if name == "Hydraulics" else f"{'=' * 80}\nMSG: motor_msgs/{name}\n"
        lines = "".join(f"{one.base}{one.many} {one.name}\n" for one in members)
        parts.append(f"{heading}{lines}")
    return "\n".join(parts)


def in_idl(definition: Definition) -> str:
    parts = []
    for name, members in definition.items():
        typedefs = dict.fromkeys(one.typedef[0] for one in members if one.count is not None)
        fields = [one.in_idl for one in members] or ["uint8 structure_needs_at_least_one_member;"]
        parts.append(
            f"{'=' * 80}\nIDL: motor_msgs/msg/{name}\n// as an adapter writes it\n\n"
            "module motor_msgs {\n  module msg {\n"
            + "".join(f"    {one}\n" for one in typedefs)
            + f"    struct {name} {{\n"
            + "".join(
                f'      @verbatim (language="comment", text="}};")\n{one}\n' for one in fields
            )
            + "    };\n  };\n};\n"
        )
    return "\n".join(parts)


@st.composite
def definitions(draw: st.DrawFn) -> Definition:
    names = ["Hydraulics", "Port", "Sensor"][: draw(st.integers(1, 3))]
    drawn: dict[str, list[Member]] = {}
    for i, name in enumerate(names):
        bases = st.sampled_from([*IDL_NAMES, *names[i + 1 :] * 4])
        many = st.sampled_from(["", "", "", "[1]", "[3]", "[]", "[<=3]"])
        members = draw(st.lists(st.tuples(bases, many), min_size=1 - bool(i), max_size=5))
        drawn[name] = [Member(f"f{k}", *one) for k, one in enumerate(members)]
    return drawn


NUMBERS: dict[str, st.SearchStrategy[Any]] = {
    "bool": st.booleans(),
    "byte": st.integers(0, 255),
    "char": st.integers(-128, 127),
    "float32": st.floats(width=32),
    "float64": st.floats(),
    **{
        f"int{bits}": st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        for bits in (8, 16, 32, 64)
    },
    **{f"uint{bits}": st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}


def content(definition: Definition, name: str) -> st.SearchStrategy[dict[str, Any]]:
    """Messages of a definition."""

    def of(member: Member) -> st.SearchStrategy[Any]:
        if member.base.startswith("string"):
            one: st.SearchStrategy[Any] = st.text(max_size=4)
        elif member.base in NUMBERS:
            one = NUMBERS[member.base]
        else:
            one = content(definition, member.base)
        count = member.count
        if count is not None:
            return st.lists(one, min_size=count, max_size=count)
        return st.lists(one, max_size=3) if member.many else one

    return st.fixed_dictionaries({member.name: of(member) for member in definition[name]})


def paths_of(definition: Definition, name: str) -> list[str]:
    """Paths to all numbers, in arrays the first, and one that sequences may not have."""
    paths = []
    for member in definition[name]:
        at = [f"{member.name}[0]", f"{member.name}[2]"] if member.many else [member.name]
        at = at[:1] if member.count == 1 else at
        if member.base in NUMBERS:
            paths += at
        elif member.base in definition:
            paths += [f"{one}.{two}" for one in at for two in paths_of(definition, member.base)]
    return paths


@settings(max_examples=60)
@given(data=st.data(), definition=definitions())
def test_any_definition_in_either_language_is_read_as_by_the_official_reader(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, definition: Definition
) -> None:
    messages = data.draw(st.lists(content(definition, "Hydraulics"), min_size=1, max_size=4))
    payloads = [
        *encoded(in_msg(definition), messages),
        *encoded(in_msg(definition), messages, EncapsulationKind.CDR_BE),
    ]
    paths = paths_of(definition, "Hydraulics")[:24]
    folder = tmp_path_factory.mktemp("ros2")
    path = folder / "log.mcap"
    path.write_bytes(ros2_of(in_msg(definition), payloads))
    decoded = official_messages(path)
    for language, text in (("ros2msg", in_msg(definition)), ("ros2idl", in_idl(definition))):
        path.write_bytes(ros2_of(text, payloads, language))
        for field, found in all_values(path, paths).items():
            wanted = [followed(one, field) for one in decoded]
            np.testing.assert_equal(found, wanted)


# What ROS 2's own parser takes of IDL


IDL = """\
================================================================================
IDL: motor_msgs/msg/Hydraulics
#include "motor_msgs/msg/Port.idl"
#include <builtin_interfaces/msg/Time.idl>

/* struct Hydraulics { octet wrong; }; */
module motor_msgs {
  module msg {
    @verbatim (language="comment", text="Ports (of a motor); those in use" "\\n" "have a flag")
    module Hydraulics_Constants {
      const unsigned long PORTS = 2;
      const string NOTE = "}; struct Hydraulics { octet wrong; };" "\\"";
      @optional
      const double HALF = 5e-1;
      const char END = '}';
    };
    typedef sequence<double, 4> Row;
    typedef Row Rows;
    typedef motor_msgs::msg::Port motor_msgs__msg__Port__2[2];
    typedef short short__6[6];
    @verbatim (language="comment", text="What a motor's sensors say." "(all of them)")
    struct Hydraulics
    {
      builtin_interfaces::msg::Time stamp;
      @unit(value="bar") @range(min=-1.0, max=1e3)
      double high;
      double low;
      short__6 grid;
      sequence<sequence<double> > rows;
      Rows row;
      motor_msgs__msg__Port__2 ports;
      @default (value=123)
      octet side;
      octet after;  // as a number
      sequence<string<16>, Hydraulics_Constants::PORTS> names;
      boolean running;
      char letter;
      unsigned  long long total;
      ::builtin_interfaces::msg::Time since[2];
    };
  };
};
================================================================================
IDL: motor_msgs/msg/Port
module motor_msgs { module msg {
  typedef float Row;
  struct Port { Row pressure; octet flags; };
}; };
================================================================================
IDL: motor_msgs/msg/Unused
module motor_msgs { module msg { struct Unused { wchar letter; @optional long double a; }; }; };
================================================================================
IDL: builtin_interfaces/msg/Time
module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };
"""


def test_what_ros_2_takes_of_idl_is_read(tmp_path: Path) -> None:
    """Laid out by hand, by the rules of CDR."""
    body = struct.pack("<iI", 1740808800, 5)
    body += struct.pack("<dd", 200.5, 3.5)
    body += struct.pack("<6h", 1, 2, 3, 4, 5, 6)
    body += struct.pack("<II", 2, 1)
    body += bytes(-len(body) % 8) + struct.pack("<d", 7.25)
    body += struct.pack("<I", 2)
    body += bytes(-len(body) % 8) + struct.pack("<dd", 8.25, 9.25)
    # An empty row, behind which nothing is aligned to a number that is not there.
    body += struct.pack("<I", 0)
    body += struct.pack("<fB3xfB", 1.5, 1, 2.5, 2)
    body += struct.pack("<BB", 1, 9)
    body += bytes(-len(body) % 4) + struct.pack("<II3s", 1, 3, b"ab\0")
    body += struct.pack("<BB", 1, 65)
    body += bytes(-len(body) % 8) + struct.pack("<Q", 2**63)
    body += struct.pack("<iIiI", 1, 2, 3, 4)
    data = ros2_of(IDL, [b"\0\1\0\0" + body], "ros2idl")
    wanted: dict[str, Value] = {
        "stamp.nanosec": 5.0,
        "high": 200.5,
        "low": 3.5,
        "grid[2]": 3.0,
        "rows[0][0]": 7.25,
        "rows[0][1]": None,
        "rows[1][1]": 9.25,
        "row[0]": None,
        "ports[0].pressure": 1.5,
        "ports[1].flags": 2.0,
        "side": 1.0,
        "after": 9.0,
        "running": 1.0,
        "letter": 65.0,
        "total": 2.0**63,
        "since[1].sec": 3.0,
    }
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    assert all_values(path, list(wanted)) == {field: [value] for field, value in wanted.items()}
    log = read(tmp_path, data, source_of("high", stamp="stamp"))
    assert log.first_us == 1740808800 * 10**6


def idl_of(members: str, others: str = "") -> str:
    return f"module motor_msgs {{ module msg {{ {others} struct Hydraulics {{ {members} }}; }}; }};"


@pytest.mark.parametrize(
    ("definition", "field", "wrong"),
    [
        (idl_of("double value;"), "pressure", "log_column_missing"),
        (idl_of("double value[2];"), "value[2]", "log_column_missing"),
        (idl_of("double value[2];"), "value", "log_type"),
        (idl_of("string value;"), "value", "log_type"),
        (idl_of("double value; wchar letter;"), "value", "log_encoding"),
        (idl_of("double value; long double more;"), "value", "log_encoding"),
        (idl_of("double value; @optional long more;"), "value", "log_encoding"),
        (idl_of("double value; long more[2 + 2];"), "value", "log_encoding"),
        (idl_of("double value; long more[SIZE];", "const long SIZE = 2;"), "value", "log_encoding"),
        (idl_of("double value; long more[2][2];"), "value", "log_encoding"),
        (idl_of("double value; long one, two;"), "value", "log_encoding"),
        (idl_of("double value; map<string> more;"), "value", "log_damaged"),
        (idl_of("double value; U more;", "union U switch (long) { };"), "value", "log_damaged"),
        (idl_of("double value; E more;", "enum E { A, C };"), "value", "log_damaged"),
        (idl_of("double value; S more;", "struct S : T { long a; };"), "value", "log_damaged"),
        (idl_of("double value; double value;"), "value", "log_damaged"),
        (idl_of("double value; Port more;"), "value", "log_damaged"),
        (idl_of("double value; Hydraulics more;"), "value", "log_damaged"),
        (idl_of("double value; A more;", "typedef B A; typedef A B;"), "value", "log_damaged"),
        (idl_of("double value; long more[0];"), "value", "log_damaged"),
        (idl_of("double value[99999999999999999999];"), "value[0]", "log_damaged"),
        (idl_of("double value"), "value", "log_damaged"),
        (idl_of("double 2;"), "value", "log_damaged"),
        (idl_of("double value;")[:-6], "value", "log_damaged"),
        ("module motor_msgs {};", "value", "log_damaged"),
        ("double value;", "value", "log_damaged"),
        ("@unit(" * 5000, "value", "log_damaged"),
        ("", "value", "log_damaged"),
    ],
)
def test_idl_that_does_not_serve_is_told(
    tmp_path: Path, definition: str, field: str, wrong: str
) -> None:
    assert code(tmp_path, ros2_of(definition, [bytes(12)], "ros2idl"), field) == wrong


@given(
    place=st.integers(0, len(IDL)), put=st.sampled_from(["", "}", "{", ";", "<", "@", "::", "("])
)
def test_any_damage_to_idl_is_a_coded_error_or_does_no_harm(
    tmp_path_factory: pytest.TempPathFactory, place: int, put: str
) -> None:
    text = IDL[:place] + put + IDL[place + 1 :]
    data = ros2_of(text, [b"\0\1\0\0" + bytes(300)], "ros2idl")
    with suppress(LogError):
        read(tmp_path_factory.mktemp("idl"), data, source_of("high"))


# Byte orders, wide characters, other representations


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


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("wide", ["I", "H"])
def test_wide_characters_of_two_and_of_four_bytes(tmp_path: Path, order: str, wide: str) -> None:
    """As Fast CDR 1 writes them ("I"), and as 2 does: their number, then their UTF-16, no end."""
    rng = random.Random(6)  # noqa: S311

    def wide_text(at: int, text: str) -> bytes:
        units = np.frombuffer(text.encode("utf-16-le"), "<u2").tolist()
        head = bytes(-at % 4) + struct.pack(f"{order}I", len(units))
        return head + struct.pack(f"{order}{len(units)}{wide}", *units)

    def payload(value: float, texts: Sequence[str], padding: int) -> bytes:
        body = wide_text(0, texts[0])
        body += bytes(-len(body) % 8) + struct.pack(f"{order}dI", value, len(texts) - 1)
        for text in texts[1:]:
            body += wide_text(len(body), text)
        body += struct.pack("B", int(value))
        return bytes([0, int(order == "<"), 0, 0]) + body + bytes(padding)

    words = ["", "a", "öl", "Druck", "\U0001f6e2", "a" * 9]
    payloads = [
        payload(float(i), rng.choices(words, k=rng.randrange(1, 5)), rng.randrange(4))
        for i in range(60)
    ]
    definition = "wstring name\nfloat64 value\nwstring<=9[] more\nuint8 last\n"
    for text, language in (
        (definition, "ros2msg"),
        (
            idl_of("wstring name; double value; sequence<wstring<9>> more; octet last;"),
            "ros2idl",
        ),
    ):
        data = ros2_of(text, payloads, language)
        assert values(tmp_path, data, "value") == list(range(60))
        assert values(tmp_path, data, "last") == list(range(60))
    cut = ros2_of(definition, [*payloads, payloads[0][:-8]])
    assert values(tmp_path, cut, "last") == [*range(60), None]


def test_the_width_of_wide_characters_where_both_would_do(tmp_path: Path) -> None:
    """A single message, and a width with which it would end, though not where it ends."""
    of_four = struct.pack("<4sII", b"\0\1\0\0", 1, ord("a")) + b"\x07"
    data = ros2_of("wstring name\nuint8 last", [of_four])
    assert values(tmp_path, data, "last") == [7]
    rest = bytes([0, 0, 0, 0, 5, *range(40)])
    of_two = struct.pack("<4sI2HI", b"\0\1\0\0", 2, *b"ab", len(rest)) + rest
    data = ros2_of("wstring name\nuint8[] rest", [of_two])
    assert values(tmp_path, data, "rest[4]") == [5]


@pytest.mark.parametrize(
    ("second", "name"),
    [(2, "PL_CDR"), (3, "PL_CDR"), (6, "CDR2"), (7, "CDR2"), (9, "D_CDR2"), (11, "PL_CDR2")],
)
def test_other_representations_are_refused_by_name(tmp_path: Path, second: int, name: str) -> None:
    good, other = (struct.pack("<BBBBd", 0, mark, 0, 0, 7.0) for mark in (1, second))
    wrong = error_of(tmp_path, ros2_of("float64 value", [other, b"", other]), "value")
    assert wrong.code == "log_encoding"
    assert f"'/hydraulics' are in {name}," in wrong.message
    # A stray one is a message that cannot be read, as damage may have made it so.
    data = ros2_of("float64 value", [good, other, good])
    channel = read(tmp_path, data, source_of("value")).channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, False]
    assert channel.unparsed == 1


# Damage


def test_a_message_that_is_cut_is_missing_and_counted(tmp_path: Path) -> None:
    definition = "float64 value\nPoint[] points\n===\nMSG: motor_msgs/Point\nfloat64 x\nstring s\n"
    good = struct.pack("<4sdI", b"\0\1\0\0", 7.0, 0)
    endless = struct.pack("<4sdI", b"\0\1\0\0", 7.0, 2**32 - 1)
    other = struct.pack("<4sdI", b"\0\x33\0\0", 7.0, 0)
    lying = struct.pack("<4sdI4xdI", b"\0\1\0\0", 7.0, 1, 1.0, 9)
    bad = [b"", good[:3], good[:10], good[:-1], endless, other, lying]
    channel = read(tmp_path, ros2_of(definition, [good, *bad, good]), source_of("value")).channels[
        "pressure_difference"
    ]
    assert channel.missing.tolist() == [False, *[True] * 7, False]
    assert channel.unparsed == 7
    last = struct.pack("<4sdi", b"\0\1\0\0", 7.0, 1)
    cut = ros2_of("float64 value\nint32 last", [last, last[:-1], last[:-4]])
    assert values(tmp_path, cut, "value") == [7.0, None, None]
    assert code(tmp_path, ros2_of(definition, [b"", endless]), "value") == "log_type"


@given(payload=st.binary(max_size=120), cut=st.integers(0, 400))
def test_any_bytes_for_a_message_do_no_harm(
    tmp_path_factory: pytest.TempPathFactory, payload: bytes, cut: int
) -> None:
    rng = random.Random(cut)  # noqa: S311
    (good,) = encoded(HYDRAULICS, [message(rng, cut)])
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
        ("float64[99999999999999999999] value", "value[1]", "log_damaged"),
        ("time at\nfloat64 value", "value", "log_encoding"),
    ],
)
def test_definitions_and_fields_that_do_not_serve_are_told(
    tmp_path: Path, definition: str, field: str, wrong: str
) -> None:
    assert code(tmp_path, ros2_of(definition, [bytes(12)]), field) == wrong


def test_a_field_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    wrong = error_of(tmp_path, ros2_of(HYDRAULICS, []), "pressure")
    for there in ("'header.stamp.sec'", "'ports[0].pressure'", "'more[0].side'", "'raw[0]'"):
        assert there in wrong.message
    assert "frame_id" not in wrong.message


def test_arrays_too_large_for_any_message_are_not_walked(tmp_path: Path) -> None:
    inner = "===\nMSG: motor_msgs/A\nB[10000] b\n===\nMSG: motor_msgs/B\nstring s\n"
    definition = "float64 value\nA[1000] a\n" + inner
    data = ros2_of(definition, [b"\0\1\0\0" + bytes(100)])
    assert code(tmp_path, data, "value") == "log_type"
    longer = definition.replace("A[1000]", "A[100000000]")
    assert code(tmp_path, ros2_of(longer, [b"\0\1\0\0" + bytes(100)]), "value") == "log_damaged"


# Long logs, and figures that are not finite


def test_long_logs_are_read_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(8)  # noqa: S311
    data = ros2(HYDRAULICS, [message(rng, i) for i in range(300)], chunk_size=2000)
    whole = read(tmp_path, data, source_of("total", "more[0].pressure", "temperature"))
    monkeypatch.setattr(pipeline.ingest.mcap.log, "_PIECE", 5000)
    parts = read(tmp_path, data, source_of("total", "more[0].pressure", "temperature"))
    for name, channel in whole.channels.items():
        np.testing.assert_array_equal(channel.value, parts.channels[name].value)
        np.testing.assert_array_equal(channel.time_us, parts.channels[name].time_us)


def test_nan_in_a_message_is_no_missing_sample(tmp_path: Path) -> None:
    data = ros2("float32 value", [{"value": math.nan}, {"value": math.inf}])
    channel = read(tmp_path, data, source_of("value")).channels["pressure_difference"]
    assert not channel.missing.any()
    np.testing.assert_array_equal(channel.value, [np.nan, np.inf])

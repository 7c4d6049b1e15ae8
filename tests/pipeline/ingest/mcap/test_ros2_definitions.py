"""Definitions of ROS 2 messages in both languages, against the format's own decoder."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._cdr import EncapsulationKind

from pipeline.errors import LogError
from tests.pipeline.ingest.mcap.ros2_files import code, encoded, idl_of, ros2_of
from tests.pipeline.ingest.mcap_files import (
    Value,
    all_values,
    followed,
    official_messages,
    read,
    source_of,
)


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

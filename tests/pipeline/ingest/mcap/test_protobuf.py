"""Protobuf messages in MCAP, against the format's own decoder."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, wrappers_pb2
from google.protobuf.json_format import MessageToDict
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from pipeline.config.field_paths import field_path
from tests.pipeline.ingest.mcap_files import (
    Value,
    all_values,
    error_of,
    mcap_of,
    official_messages,
    officially,
    read,
    source_of,
    values,
)

Field = descriptor_pb2.FieldDescriptorProto
NAME = "motor.Hydraulics"

NUMBERS: Mapping[int, st.SearchStrategy[Any]] = {
    Field.TYPE_DOUBLE: st.floats(allow_nan=False, allow_infinity=False),
    # Numbers that a float32 and the shortest text for it have in common.
    Field.TYPE_FLOAT: st.integers(-(2**20), 2**20).map(lambda i: i / 8),
    Field.TYPE_INT64: st.integers(-(2**63), 2**63 - 1),
    Field.TYPE_SFIXED64: st.integers(-(2**63), 2**63 - 1),
    Field.TYPE_SINT64: st.integers(-(2**63), 2**63 - 1),
    Field.TYPE_UINT64: st.integers(0, 2**64 - 1),
    Field.TYPE_FIXED64: st.integers(0, 2**64 - 1),
    Field.TYPE_INT32: st.integers(-(2**31), 2**31 - 1),
    Field.TYPE_SFIXED32: st.integers(-(2**31), 2**31 - 1),
    Field.TYPE_SINT32: st.integers(-(2**31), 2**31 - 1),
    Field.TYPE_UINT32: st.integers(0, 2**32 - 1),
    Field.TYPE_FIXED32: st.integers(0, 2**32 - 1),
    Field.TYPE_BOOL: st.booleans(),
    Field.TYPE_ENUM: st.sampled_from([0, 1, 7]),
}
KEYS: Mapping[int, st.SearchStrategy[Any]] = {
    **{kind: NUMBERS[kind] for kind in (Field.TYPE_INT32, Field.TYPE_SINT64, Field.TYPE_FIXED64)},
    Field.TYPE_BOOL: st.booleans(),
    Field.TYPE_STRING: st.sampled_from(["oil", "Öl", "a.b", "[1]", "7"]),
}
WRAPPERS = {
    "DoubleValue": Field.TYPE_DOUBLE,
    "FloatValue": Field.TYPE_FLOAT,
    "Int64Value": Field.TYPE_INT64,
    "UInt32Value": Field.TYPE_UINT32,
    "BoolValue": Field.TYPE_BOOL,
}


def imported(message: Any) -> Any:
    """The file in which a message of Protobuf's own is declared."""
    file = descriptor_pb2.FileDescriptorProto()
    message.DESCRIPTOR.file.CopyToProto(file)
    return file


STAMP, WRAPPED = imported(Timestamp), imported(wrappers_pb2.DoubleValue)


def set_of(syntax: str, *messages: Any) -> Any:
    """Descriptors of messages, the file that imports before those that it imports."""
    mode = descriptor_pb2.EnumDescriptorProto(name="Mode")
    for name, number in (("OFF", 0), ("ON", 1), ("FAST", 7)):
        mode.value.add(name=name, number=number)
    main = descriptor_pb2.FileDescriptorProto(
        name="motor.proto",
        package="motor",
        syntax=syntax,
        dependency=[STAMP.name, WRAPPED.name],
        message_type=messages,
        enum_type=[mode],
    )
    return descriptor_pb2.FileDescriptorSet(file=[main, STAMP, WRAPPED])


def class_of(descriptors: Any) -> Any:
    """Class of the root message, to make payloads with."""
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(descriptors.file):
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(NAME))


def protobuf(payloads: Sequence[bytes], descriptors: Any, **options: Any) -> bytes:
    return mcap_of(
        payloads, (NAME, "protobuf", descriptors.SerializeToString()), "protobuf", **options
    )


def by_its_json(message: Any, path: str) -> Value:
    """Value at a path by the runtime's own mapping to JSON; None if that has nothing there.

    In this mapping wrappers become their content, keys are text, and unset fields are omitted.
    """
    node: Any = MessageToDict(
        message,
        preserving_proto_field_name=True,
        use_integers_for_enums=True,
        always_print_fields_with_no_presence=True,
    )
    for step in field_path(path):
        if isinstance(node, list):
            node = node[int(step)] if int(step) < len(node) else None
        elif node is not None:
            node = node.get(str(step))
    return None if node is None else float(node)


# Any schema of both syntaxes, and any content


@dataclass(frozen=True)
class Member:
    """A field of a generated message: one, of a oneof, optional, many, or a map by a key's type."""

    name: str
    kind: int
    type_name: str
    role: str
    key: int = 0


def declared(name: str, members: Sequence[Member], syntax: str) -> Any:
    message = descriptor_pb2.DescriptorProto(name=name)
    if any(member.role == "oneof" for member in members):
        message.oneof_decl.add(name="either")
    for number, member in enumerate(members, 1):
        made = message.field.add(name=member.name, number=number, label=Field.LABEL_OPTIONAL)
        _set_type(made, member.kind, member.type_name)
        if member.role in ("many", "map"):
            made.label = Field.LABEL_REPEATED
        if member.role == "map":
            entry = message.nested_type.add(name=f"{member.name.title()}Entry")
            entry.options.map_entry = True
            label = Field.LABEL_OPTIONAL
            entry.field.add(name="key", number=1, type=member.key, label=label)
            value = entry.field.add(name="value", number=2, label=label)
            _set_type(value, member.kind, member.type_name)
            _set_type(made, Field.TYPE_MESSAGE, f".motor.{name}.{entry.name}")
        if member.role == "oneof":
            made.oneof_index = 0
        if member.role == "default" and member.kind == Field.TYPE_DOUBLE:
            made.default_value = "20.5"
    # Those that proto3 marks as optional come last among its oneofs.
    for member, made in zip(members, message.field, strict=True):
        if member.role == "optional" and syntax == "proto3":
            made.proto3_optional = True
            made.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{member.name}")
    return message


def _set_type(field: Any, kind: int, type_name: str) -> None:
    field.type = kind
    if type_name:
        field.type_name = type_name


@st.composite
def schemas(draw: st.DrawFn) -> tuple[str, dict[str, list[Member]]]:
    """A syntax, and members by name of the message; the last message holds no other."""
    syntax = draw(st.sampled_from(["proto2", "proto3"]))
    types: list[tuple[int, str]] = [
        (kind, ".motor.Mode" if kind == Field.TYPE_ENUM else "") for kind in NUMBERS
    ]
    types += [(Field.TYPE_STRING, ""), (Field.TYPE_BYTES, "")]
    types += [(Field.TYPE_MESSAGE, f".google.protobuf.{name}") for name in WRAPPERS]
    last = "default" if syntax == "proto2" else "plain"
    roles = st.sampled_from(["plain", "optional", "oneof", "many", "map", last])
    messages: dict[str, list[Member]] = {}
    for name, inner in (("Port", []), ("Hydraulics", [(Field.TYPE_MESSAGE, ".motor.Port")] * 6)):
        drawn = draw(
            st.lists(
                st.tuples(st.sampled_from(types + inner), roles, st.sampled_from(list(KEYS))),
                min_size=1,
                max_size=6,
            )
        )
        messages[name] = [
            Member(f"f{i}", kind, type_name, role, key)
            for i, ((kind, type_name), role, key) in enumerate(drawn)
        ]
    return syntax, messages


def content(messages: Mapping[str, Sequence[Member]], name: str) -> st.SearchStrategy[Any]:
    """Keyword arguments of a message, in which anything may be left out."""
    each = {}
    for member in messages[name]:
        one = of_one(messages, member)
        each[member.name] = {
            "many": st.lists(one, max_size=3),
            "map": st.dictionaries(KEYS.get(member.key, st.none()), one, max_size=3),
        }.get(member.role, one)
    return st.fixed_dictionaries({}, optional=each)


def of_one(messages: Mapping[str, Sequence[Member]], member: Member) -> st.SearchStrategy[Any]:
    if member.type_name == ".motor.Port":
        return content(messages, "Port")
    wrapped = WRAPPERS.get(member.type_name.rpartition(".")[2])
    if wrapped is not None:
        return st.fixed_dictionaries({"value": NUMBERS[wrapped]})
    if member.kind == Field.TYPE_STRING:
        return st.text(max_size=4)
    return NUMBERS.get(member.kind, st.binary(max_size=4))


def paths_of(messages: Mapping[str, Sequence[Member]], name: str) -> list[str]:
    """Paths to all numbers: of arrays the first and one that may not be there, of maps some key."""
    paths = []
    for member in messages[name]:
        at = [member.name]
        if member.role == "many":
            at = [f"{member.name}[0]", f"{member.name}[2]"]
        elif member.role == "map":
            at = [f"{member.name}.{key}" for key in keys_of(member.key)]
        if member.type_name == ".motor.Port":
            paths += [f"{one}.{two}" for one in at for two in paths_of(messages, "Port")]
        elif member.kind in NUMBERS or member.type_name.startswith(".google"):
            paths += at
    return paths


def keys_of(kind: int) -> tuple[str, ...]:
    if kind == Field.TYPE_STRING:
        return (r"oil", r"a\.b", r"\[1\]")
    return ("true", "false") if kind == Field.TYPE_BOOL else ("0", "1")


def made_of(made: Any, fields: Mapping[str, Any]) -> bytes:
    """A payload; maps of messages cannot be set whole."""
    message = made()
    _fill(message, fields)
    return bytes(message.SerializeToString())


def _fill(message: Any, fields: Mapping[str, Any]) -> None:
    for name, value in fields.items():
        field = message.DESCRIPTOR.fields_by_name[name]
        target = getattr(message, name)
        if isinstance(value, dict) and field.is_repeated:
            for key, one in value.items():
                if isinstance(one, dict):
                    _fill(target[key], one)
                else:
                    target[key] = one
        elif isinstance(value, dict):
            target.SetInParent()
            _fill(target, value)
        elif isinstance(value, list):
            for one in value:
                if isinstance(one, dict):
                    _fill(target.add(), one)
                else:
                    target.append(one)
        else:
            setattr(message, name, value)


@settings(max_examples=80)
@given(data=st.data(), schema=schemas())
def test_any_schema_is_read_as_by_the_official_reader(
    tmp_path_factory: pytest.TempPathFactory,
    data: st.DataObject,
    schema: tuple[str, dict[str, list[Member]]],
) -> None:
    syntax, messages = schema
    all_declared = [declared(name, members, syntax) for name, members in messages.items()]
    descriptors = set_of(syntax, *all_declared)
    made = class_of(descriptors)
    contents = data.draw(st.lists(content(messages, "Hydraulics"), min_size=1, max_size=4))
    path = tmp_path_factory.mktemp("protobuf") / "log.mcap"
    path.write_bytes(protobuf([made_of(made, one) for one in contents], descriptors))
    decoded = official_messages(path)
    for field, found in all_values(path, paths_of(messages, "Hydraulics")[:24]).items():
        wanted = [by_its_json(one, field) for one in decoded]
        np.testing.assert_equal(found, wanted, err_msg=field)


# A schema of everything, by hand


def _field(name: str, kind: int, type_name: str = "", role: str = "plain", key: int = 0) -> Member:
    return Member(name, kind, type_name, role, key)


PORT = [_field("pressure", Field.TYPE_DOUBLE), _field("side", Field.TYPE_UINT32)]
HYDRAULICS = [
    _field("stamp", Field.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
    _field("port", Field.TYPE_MESSAGE, ".motor.Port"),
    _field("ports", Field.TYPE_MESSAGE, ".motor.Port", "many"),
    _field("values", Field.TYPE_FLOAT, role="many"),
    _field("total", Field.TYPE_INT64),
    _field("running", Field.TYPE_BOOL),
    _field("name", Field.TYPE_STRING),
    _field("maybe", Field.TYPE_DOUBLE, role="optional"),
    _field("mode", Field.TYPE_ENUM, ".motor.Mode"),
    _field("wrapped", Field.TYPE_MESSAGE, ".google.protobuf.DoubleValue"),
    _field("by_name", Field.TYPE_DOUBLE, role="map", key=Field.TYPE_STRING),
    _field("by_number", Field.TYPE_MESSAGE, ".motor.Port", "map", Field.TYPE_INT32),
    _field("by_truth", Field.TYPE_ENUM, ".motor.Mode", "map", Field.TYPE_BOOL),
    _field("bar", Field.TYPE_DOUBLE, role="oneof"),
    _field("raw", Field.TYPE_INT32, role="oneof"),
    _field("itself", Field.TYPE_MESSAGE, ".motor.Hydraulics"),
]
DESCRIPTORS = set_of(
    "proto3", declared("Port", PORT, "proto3"), declared("Hydraulics", HYDRAULICS, "proto3")
)


@pytest.fixture(scope="module")
def hydraulics() -> Callable[..., bytes]:
    """Maker of payloads."""
    made = class_of(DESCRIPTORS)
    return lambda **fields: made_of(made, fields)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_messages_are_read_as_by_the_official_reader(
    tmp_path: Path, hydraulics: Callable[..., bytes], compression: CompressionType
) -> None:
    rng = random.Random(5)  # noqa: S311
    payloads = [
        hydraulics(
            port={"pressure": rng.gauss(100, 20), "side": i % 2},
            ports=[{"pressure": rng.random()} for _ in range(rng.randrange(4))],
            values=[rng.random() for _ in range(rng.randrange(4))],
            total=rng.randrange(-(2**63), 2**63),
            running=bool(i % 3),
            mode=(0, 1, 7)[i % 3],
            name="x" * (i % 5),
        )
        for i in range(200)
    ]
    path = tmp_path / "log.mcap"
    path.write_bytes(protobuf(payloads, DESCRIPTORS, compression=compression))
    fields = ("port.pressure", "port.side", "ports[2].pressure", "values[0]", "total")
    for field, found in all_values(path, (*fields, "running", "mode")).items():
        assert found == officially(path, field)
        assert any(found)


def test_what_is_not_set_is_missing_where_that_can_be_told(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    full = hydraulics(
        port={},
        maybe=0.0,
        values=[1.0],
        wrapped={"value": 0.0},
        by_name={"oil": 50.5, "": 1.0, "a.b": 2.0},
        by_number={-3: {"pressure": 9.0}, 4: {}},
        by_truth={True: 7},
        bar=0.0,
        itself={"itself": {"total": 8}},
    )
    path = tmp_path / "log.mcap"
    path.write_bytes(protobuf([hydraulics(), full], DESCRIPTORS))
    wanted: dict[str, list[Value]] = {
        "total": [0.0, 0.0],
        "running": [0.0, 0.0],
        "mode": [0.0, 0.0],
        "port.pressure": [None, 0.0],
        "maybe": [None, 0.0],
        "values[0]": [None, 1.0],
        "wrapped": [None, 0.0],
        "wrapped.value": [None, 0.0],
        "by_name.oil": [None, 50.5],
        r"by_name.a\.b": [None, 2.0],
        "by_name.water": [None, None],
        "by_number.-3.pressure": [None, 9.0],
        "by_number[4].pressure": [None, 0.0],
        "by_number.5.pressure": [None, None],
        "by_truth.true": [None, 7.0],
        "by_truth.false": [None, None],
        "bar": [None, 0.0],
        "raw": [None, None],
        "itself.itself.total": [None, 8.0],
    }
    assert all_values(path, list(wanted)) == wanted


def test_a_default_that_proto2_names_is_no_reading(tmp_path: Path) -> None:
    """A field absent from the message was not measured, whatever its default."""
    members = [_field("oil", Field.TYPE_DOUBLE, role="default")]
    descriptors = set_of("proto2", declared("Hydraulics", members, "proto2"))
    made = class_of(descriptors)
    data = protobuf([made_of(made, {}), made_of(made, {"oil": 20.5})], descriptors)
    assert values(tmp_path, data, "oil") == [None, 20.5]
    assert officially(tmp_path / "log.mcap", "oil") == [20.5, 20.5]


def test_payloads_that_are_no_protobuf_are_missing_and_counted(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    payloads = [hydraulics(total=5), b"\xff\xff", hydraulics(port={"pressure": 1})[:-1]]
    data = protobuf(payloads, DESCRIPTORS)
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
        ("by_name[3]", "log_column_missing"),
        ("by_number.oil.pressure", "log_column_missing"),
        ("by_number.2147483648.pressure", "log_column_missing"),
        ("by_truth.1", "log_column_missing"),
        ("wrapped.pressure", "log_column_missing"),
        ("values", "log_type"),
        ("by_name", "log_type"),
        ("port", "log_type"),
        ("name", "log_type"),
        ("stamp", "log_type"),
    ],
)
def test_fields_that_do_not_serve_are_told(
    tmp_path: Path, hydraulics: Callable[..., bytes], field: str, wrong: str
) -> None:
    data = protobuf([hydraulics(total=1)], DESCRIPTORS)
    assert error_of(tmp_path, data, field).code == wrong


def test_a_field_that_is_not_there_is_told_with_those_that_are(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    message = error_of(tmp_path, protobuf([hydraulics()], DESCRIPTORS), "pressure").message
    for there in ("port.pressure", "ports[0].side", "by_name.KEY", "wrapped", "itself.total"):
        assert f"'{there}'" in message
    assert "'name'" not in message


def test_descriptors_that_contradict_themselves_are_damage(tmp_path: Path) -> None:
    whole = DESCRIPTORS.SerializeToString()
    one_missing = descriptor_pb2.FileDescriptorSet(file=DESCRIPTORS.file[:1]).SerializeToString()
    twice = descriptor_pb2.FileDescriptorSet(file=[*DESCRIPTORS.file, DESCRIPTORS.file[0]])
    for name, data in (
        (NAME, b"\xff"),
        (NAME, b""),
        (NAME, one_missing),
        (NAME, twice.SerializeToString()),
        ("motor.Unknown", whole),
    ):
        broken = mcap_of([b""], (name, "protobuf", data), "protobuf")
        assert error_of(tmp_path, broken, "total").code == "log_damaged"


def test_without_the_extra_the_error_says_which(
    tmp_path: Path, hydraulics: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    wrong = error_of(tmp_path, protobuf([hydraulics(total=1)], DESCRIPTORS), "total")
    assert wrong.code == "log_extra_missing"
    assert "motor-leakage[protobuf]" in wrong.message


def test_stamps_in_messages(tmp_path: Path, hydraulics: Callable[..., bytes]) -> None:
    payloads = [hydraulics(total=i, stamp={"seconds": 1740808800 + i}) for i in range(3)]
    data = protobuf([*payloads, hydraulics(total=9)], DESCRIPTORS)
    log = read(tmp_path, data, source_of("total", stamp="stamp"))
    times = log.channels["pressure_difference"].time_us - 1740808800 * 10**6
    assert times.tolist() == [0, 1_000_000, 2_000_000]
    assert log.refused_rows == 1

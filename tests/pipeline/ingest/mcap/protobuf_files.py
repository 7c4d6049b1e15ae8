"""Descriptors of Protobuf messages, and files of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, wrappers_pb2
from google.protobuf.json_format import MessageToDict
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import strategies as st

from pipeline.config.field_paths import field_path
from tests.pipeline.ingest.mcap_files import Value, mcap_of

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


def field_of(
    name: str, kind: int, type_name: str = "", role: str = "plain", key: int = 0
) -> Member:
    return Member(name, kind, type_name, role, key)

"""Descriptors of Protobuf messages, and files of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf import (
    descriptor_pb2,
    descriptor_pool,
    json_format,
    message_factory,
    wrappers_pb2,
)
from google.protobuf.timestamp_pb2 import Timestamp

from tests.pipeline.ingest.mcap_files import mcap_of

Field = descriptor_pb2.FieldDescriptorProto
NAME = "motor.Hydraulics"


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


@dataclass(frozen=True)
class Member:
    """A field of a generated message: one, of a oneof, optional, many, or a map by a key's type."""

    name: str
    kind: int
    type_name: str = ""
    role: str = "plain"
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
    """A payload of fields as JSON has them."""
    return bytes(json_format.ParseDict(fields, made()).SerializeToString())

"""Descriptors of Protobuf messages, and files of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
KINDS = {name.removeprefix("TYPE_").lower(): number for name, number in Field.Type.items()}
NAME = "motor.Hydraulics"


def imported(message: Any) -> Any:
    """The file in which a message of Protobuf's own is declared."""
    file = descriptor_pb2.FileDescriptorProto()
    message.DESCRIPTOR.file.CopyToProto(file)
    return file


STAMP, WRAPPED = imported(Timestamp), imported(wrappers_pb2.DoubleValue)


def set_of(syntax: str, **messages: str) -> Any:
    """Descriptors of messages by name, the file that imports before those that it imports."""
    mode = descriptor_pb2.EnumDescriptorProto(name="Mode")
    for name, number in (("OFF", 0), ("ON", 1), ("FAST", 7)):
        mode.value.add(name=name, number=number)
    main = descriptor_pb2.FileDescriptorProto(
        name="motor.proto",
        package="motor",
        syntax=syntax,
        dependency=[STAMP.name, WRAPPED.name],
        message_type=[_declared(name, fields, syntax) for name, fields in messages.items()],
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


def _declared(name: str, fields: str, syntax: str) -> Any:
    """A message of fields as a .proto file has them; `map` is one of text to numbers."""
    message = descriptor_pb2.DescriptorProto(name=name)
    if "oneof " in fields:
        message.oneof_decl.add(name="either")
    for number, line in enumerate(fields.split(";"), 1):
        *role, kind, field_name = line.split()
        many = Field.LABEL_REPEATED if role in (["repeated"], ["map"]) else Field.LABEL_OPTIONAL
        field = message.field.add(name=field_name, number=number, label=many)
        inner = Field.TYPE_ENUM if kind == "motor.Mode" else Field.TYPE_MESSAGE
        field.type = KINDS.get(kind, inner)
        if kind not in KINDS:
            field.type_name = f".{kind}"
        if role == ["map"]:
            entry = message.nested_type.add(name=f"{field_name.title()}Entry")
            entry.options.map_entry = True
            entry.field.add(name="key", number=1, type=Field.TYPE_STRING, label=1)
            entry.field.add(name="value", number=2, type=KINDS[kind], label=1)
            field.type, field.type_name = Field.TYPE_MESSAGE, f".motor.{name}.{entry.name}"
        elif role == ["oneof"]:
            field.oneof_index = 0
        elif role == ["default"]:
            field.default_value = "20.5"
    # Those that proto3 marks as optional come last among its oneofs.
    for line, field in zip(fields.split(";"), message.field, strict=True):
        if line.split()[0] == "optional" and syntax == "proto3":
            field.proto3_optional = True
            field.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{field.name}")
    return message


def made_of(made: Any, fields: Mapping[str, Any]) -> bytes:
    """A payload of fields as JSON has them."""
    return bytes(json_format.ParseDict(fields, made()).SerializeToString())

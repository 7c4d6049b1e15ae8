"""Messages of Protobuf, laid out as the descriptors in the schema record say.

Their classes are made by the format's own package. A field that is not set is missing where
Protobuf can tell (messages, ``optional``, ``oneof``, and all of proto2, whatever default its schema
names), and its default where it cannot: plain numbers of proto3, of which a 0 is never written.
Truth values and members of an enum are their numbers. Maps are not read.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

from mcap.records import Schema

from pipeline.config.logs import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.mcap.decoding import (
    Decoded,
    Decoder,
    Payloads,
    Value,
    Wanted,
    no_field,
    one_by_one,
)

_BROKEN = "a message that is not as its descriptor says"


def protobuf_decoder(path: Path, topic: str, schema: Schema, wanted: Wanted) -> Decoder:
    """Return decoder of the messages of a topic.

    Raises LogError: ``log_extra_missing``; ``log_damaged`` for descriptors that are none;
    ``log_column_missing`` for a field that is not in them.
    """
    message_class, decode_error = _message_class(path, schema)
    descriptor = message_class.DESCRIPTOR
    values: dict[FieldPath, Value] = {}
    for field in (*wanted.readings, *wanted.qualities, *([wanted.stamp] if wanted.stamp else [])):
        try:
            values[field] = _value(descriptor, field, stamp=field == wanted.stamp)
        except LookupError as error:
            raise no_field(path, topic, field, _names(descriptor, ())) from error
        except TypeError as error:
            how = f"field {path_text(field)!r} is no number but {error}"
            raise LogError("log_type", path, how, topic) from error

    def message(payload: bytes) -> Any:
        try:
            return message_class.FromString(payload)
        except decode_error:
            return None

    def decode(payloads: Payloads) -> Decoded:
        return one_by_one(list(map(message, payloads.each())), wanted, values, _BROKEN)

    def tree(payload: bytes) -> Any:
        content = message(payload)
        return None if content is None else _tree(content)

    return Decoder(decode, tree)


def _message_class(path: Path, schema: Schema) -> tuple[Any, type[Exception]]:
    """Return class of a schema's messages, and what it raises on what is none."""
    try:
        from google.protobuf.message import DecodeError
        from mcap.exceptions import McapError
        from mcap_protobuf.decoder import DecoderFactory
    except ImportError as error:
        raise LogError(
            "log_extra_missing",
            path,
            "its messages are Protobuf: install the extra protobuf "
            "(pip install 'motor-leakage[protobuf]')",
        ) from error
    try:
        decode: Any = DecoderFactory().decoder_for("protobuf", schema)
        return type(decode(b"")), DecodeError
    # The runtime raises TypeError on what contradicts itself, KeyError on what is not there.
    except (McapError, DecodeError, TypeError, LookupError, ValueError, RecursionError) as error:
        raise LogError(
            "log_damaged", path, f"the descriptors of {schema.name} cannot be read: {error}"
        ) from error


def _names(descriptor: Any, above: FieldPath, around: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield paths of numbers, for an error; a message may hold itself."""
    for field in descriptor.fields:
        inner, is_text = field.message_type, field.cpp_type == field.CPPTYPE_STRING
        path = (*above, field.name, *((0,) if _is_repeated(field) else ()))
        if inner is None and not is_text:
            yield path_text(path)
        elif inner is not None and inner.full_name not in around and not _is_map(inner):
            yield from _names(inner, path, (*around, descriptor.full_name))


def _value(descriptor: Any, path: FieldPath, *, stamp: bool) -> Value:
    """Return what gives a message's value at a path; only a stamp may be a message."""
    field = descriptor.fields_by_name[path[0]]
    get, inner, rest = _getter(field), field.message_type, path[1:]
    if inner is not None and _is_map(inner):
        raise TypeError("a map")
    if _is_repeated(field):
        if not rest:
            raise TypeError("an array")
        get, rest = _then(get, _element(rest[0])), rest[1:]
    if rest:
        if inner is None:
            raise LookupError(path)
        return _then(get, _value(inner, rest, stamp=stamp))
    if inner is not None and not stamp:
        raise TypeError(f"a message {inner.full_name}")
    is_plain = inner is None and field.cpp_type != field.CPPTYPE_BOOL
    return get if is_plain else _then(get, _tree)


def _getter(field: Any) -> Value:
    name = field.name
    if field.has_presence:
        return lambda message: getattr(message, name) if message.HasField(name) else None
    return attrgetter(name)


def _then(first: Value, second: Value) -> Value:
    return lambda message: None if (inner := first(message)) is None else second(inner)


def _element(step: str | int) -> Value:
    """Return function of a repeated field that gives a value of it."""
    if isinstance(step, int):
        return lambda values: values[step] if step < len(values) else None
    raise LookupError(step)


def _is_map(message_type: Any) -> bool:
    return bool(message_type.GetOptions().map_entry)


def _is_repeated(field: Any) -> bool:
    # Older runtimes know only the label, newer ones warn of it.
    is_repeated = getattr(field, "is_repeated", None)
    return bool(field.label == field.LABEL_REPEATED if is_repeated is None else is_repeated)


def _tree(node: Any) -> Any:
    """Return a value as dicts, lists and plain values; a map as nothing."""
    if hasattr(node, "DESCRIPTOR"):
        return {field.name: _tree(_getter(field)(node)) for field in node.DESCRIPTOR.fields}
    if hasattr(node, "items"):
        return None
    if hasattr(node, "__len__") and not isinstance(node, str | bytes):
        return [_tree(element) for element in node]
    return int(node) if isinstance(node, bool) else node

"""Messages of Protobuf, laid out as the descriptors in the schema record say.

Payloads are decoded by Protobuf's own runtime, which the format's own reader uses too. A field that
is not set is missing where Protobuf can tell (messages, ``optional``, ``oneof``, and all of proto2,
whatever default its schema names), and its default where it cannot: plain numbers of proto3, of
which a 0 is never written. Truth values and members of an enum are their numbers, a wrapper such as
``google.protobuf.DoubleValue`` is the number in it, and a map's key is a step of a path.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config.field_paths import FieldPath
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.fields import Place, wanted_kinds
from pipeline.ingest.mcap.layout import Schema
from pipeline.ingest.mcap.payloads import Decoded, Decoder, Numbers, Payloads, stamps_of_parts

_Step = Callable[[Any], Any]

_NUMBERS = {1: "i4", 2: "i8", 3: "u4", 4: "u8", 5: "f8", 6: "f4", 7: "?", 8: "i4"}
"""NumPy's names by the runtime's ``CPPTYPE_INT32`` and so on, truth values and enums included."""

_KEYS: Mapping[int, str | int] = {1: 0, 2: 0, 3: 0, 4: 0, 7: "true", 9: "KEY"}
"""Keys that a map may have, by the runtime's name of their type."""

_TRUTH = {"true": True, "false": False}
_WHOLE_NUMBER = re.compile(r"-?\d{1,20}")
_WRAPPERS = frozenset(
    f"google.protobuf.{name}Value"
    for name in ("Double", "Float", "Int64", "UInt64", "Int32", "UInt32", "Bool")
)


def protobuf_decoder(
    path: Path,
    topic: str,
    schema: Schema,
    fields: Sequence[FieldPath],
    stamp: FieldPath | None,
    time_format: str,
) -> Decoder:
    """Decoder of the messages of a schema; errors as of `wanted_kinds` and `protobuf_root`."""
    message_class, decode_error = _message_class(path, schema)
    root = _Place(message_class.DESCRIPTOR)
    kinds, parts = wanted_kinds(path, topic, root, fields, stamp)
    follows = [_follow(root, one) for one in kinds]

    def decode(payloads: Payloads) -> Decoded:
        count = payloads.start.size
        columns: list[list[Any]] = [[None] * count for _ in kinds]
        sound = np.ones(count, np.bool_)
        pairs = list(zip(columns, follows, strict=True))
        for i, payload in enumerate(payloads.each()):
            try:
                message = message_class.FromString(payload)
            except decode_error:
                sound[i] = False
                continue
            for column, follow in pairs:
                column[i] = follow(message)
        values = dict(zip(kinds, columns, strict=True))
        readings = {one: _readings(values[one], sound) for one in fields}
        found = [_numbers(values[one], kinds[one]) for one in parts]
        return Decoded(readings, stamps_of_parts(found, time_format) if found else None)

    return decode


def protobuf_root(path: Path, schema: Schema) -> Place:
    """A message, as its descriptors lay it out.

    Raises
    ------
    LogError
        ``log_extra_missing``, ``log_damaged``.
    """
    return _Place(_message_class(path, schema)[0].DESCRIPTOR)


def _message_class(path: Path, schema: Schema) -> tuple[Any, type[Exception]]:
    """Class of a schema's messages, and what it raises on what is none."""
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
        from google.protobuf.message import DecodeError
    except ImportError as error:
        raise LogError(
            "log_extra_missing",
            path,
            "its messages are Protobuf: install the extra protobuf "
            "(pip install 'motor-leakage[protobuf]')",
        ) from error
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
        waiting = _by_name(files)
        pool = descriptor_pool.DescriptorPool()
        while waiting:
            _add_file(pool, waiting, next(iter(waiting)))
        found = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    # The runtime raises TypeError on what contradicts itself, KeyError on what is not there.
    except (DecodeError, TypeError, KeyError, ValueError, RecursionError) as error:
        raise LogError(
            "log_damaged", path, f"the descriptors of {schema.name} cannot be read: {error}"
        ) from error
    return found, DecodeError


def _by_name(files: Sequence[Any]) -> dict[str, Any]:
    names = [file.name for file in files]
    if len(set(names)) < len(names):
        raise ValueError("two files have one name")
    return dict(zip(names, files, strict=True))


def _add_file(pool: Any, waiting: dict[str, Any], name: str) -> None:
    """Add a file to the pool, after those that it imports."""
    file = waiting.pop(name)
    for dependency in file.dependency:
        if dependency in waiting:
            _add_file(pool, waiting, dependency)
    pool.Add(file)


@dataclass(frozen=True, slots=True)
class _Place:
    """A place in a message, as `pipeline.ingest.mcap.fields` asks for it."""

    message: Any  # descriptor of the message that is here; None where there is none
    field: Any = None  # descriptor of the field whose value this is, or whose values these are
    is_many: bool = False  # all values of a repeated field are here, or all entries of a map

    @property
    def is_map(self) -> bool:
        """True if entries of a map are here."""
        has_message = self.is_many and self.message is not None
        return bool(has_message and self.message.GetOptions().map_entry)

    @property
    def is_wrapper(self) -> bool:
        """True if a message is here that only wraps a number, so that it can be absent."""
        name = None if self.message is None or self.is_many else self.message.full_name
        return name in _WRAPPERS

    @property
    def number(self) -> str | None:
        """NumPy's name of the type of the number that is here."""
        if self.is_wrapper:
            return _NUMBERS[self.message.fields_by_name["value"].cpp_type]
        return None if self.is_many or self.field is None else _NUMBERS.get(self.field.cpp_type)

    @property
    def what(self) -> str:
        """The thing that is here, in words."""
        if self.is_many:
            return "a map" if self.is_map else "an array"
        return "text or bytes" if self.message is None else f"a message {self.message.full_name}"

    def steps(self) -> list[str | int]:
        """The steps inwards; any key of a map serves to find what it holds."""
        if self.is_map:
            return [_KEYS[self.message.fields_by_name["key"].cpp_type]]
        if self.is_many:
            return [0]
        return [] if self.message is None else list(self.message.fields_by_name)

    def inside(self, step: str | int) -> _Place | None:
        """The place one step further inwards."""
        if self.is_map:
            value = self.message.fields_by_name["value"]
            return None if _key(self.message, step) is None else _Place(value.message_type, value)
        if self.is_many:
            return _Place(self.message, self.field) if isinstance(step, int) else None
        field = None if self.message is None else self.message.fields_by_name.get(step)
        return None if field is None else _Place(field.message_type, field, _is_repeated(field))


def _key(entry: Any, step: str | int) -> Any:
    """Key of a map that a step means; None where it cannot mean one."""
    kind = entry.fields_by_name["key"].cpp_type
    if _KEYS[kind] == "KEY":
        return step if isinstance(step, str) else None
    if _KEYS[kind] == "true":
        return _TRUTH.get(str(step))
    key = int(step) if _WHOLE_NUMBER.fullmatch(str(step)) else None
    limits = np.iinfo(_NUMBERS[kind])
    return key if key is not None and limits.min <= key <= limits.max else None


def _is_repeated(field: Any) -> bool:
    # Older runtimes know only the label, newer ones warn of it.
    is_repeated = getattr(field, "is_repeated", None)
    return bool(field.label == field.LABEL_REPEATED if is_repeated is None else is_repeated)


def _follow(root: _Place, path: FieldPath) -> _Step:
    """Function of a message that gives what a path leads to; None where that is not set."""
    steps: list[_Step] = []
    place: _Place | None = root
    for step in path:
        if place is None:
            raise LookupError(path)
        steps.append(_step(place, step))
        place = place.inside(step)
    if place is not None and place.is_wrapper:
        steps.append(attrgetter("value"))
    if len(steps) == 1:
        return steps[0]

    def follow(message: Any) -> Any:
        for step in steps:
            message = step(message)
            if message is None:
                return None
        return message

    return follow


def _step(place: _Place, step: str | int) -> _Step:
    """Function of what is at a place that gives what is one step further inwards."""
    if place.is_map:
        key = _key(place.message, step)
        return lambda entries: entries.get(key)
    if isinstance(step, int):
        return lambda values: values[step] if step < len(values) else None
    if place.message.fields_by_name[step].has_presence:
        return lambda message: getattr(message, step) if message.HasField(step) else None
    return attrgetter(step)


def _readings(values: Sequence[float | None], sound: NDArray[np.bool_]) -> Readings:
    missing = np.array([value is None for value in values], dtype=np.bool_)
    raw = np.array(values, dtype=np.float64)
    example = None if sound.all() else "a message that is not as its descriptor says"
    return Readings(raw, missing, ~sound, example)


def _numbers(values: Sequence[Any], kind: str) -> Numbers:
    """Numbers, 0 where there is none, and where there is one."""
    there = np.array([value is not None for value in values], dtype=np.bool_)
    return np.array([value or 0 for value in values], dtype=kind), there

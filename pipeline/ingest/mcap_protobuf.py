"""Messages of Protobuf, laid out as the descriptors in the schema record say.

A field that is not set is missing where Protobuf can tell (messages, ``optional``, ``oneof``,
proto2), and its default where it cannot: plain numbers of proto3, of which a 0 is never written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap_layout import Schema
from pipeline.ingest.mcap_paths import FieldPath, path_text
from pipeline.ingest.mcap_payloads import (
    NANOSECONDS,
    SECONDS,
    Decoded,
    Decoder,
    Payloads,
    stamps_of_numbers,
    stamps_of_seconds,
)
from pipeline.ingest.time_stamps import WrittenStamps

_Follow = Callable[[Any], Any]


def protobuf_decoder(
    path: Path,
    topic: str,
    schema: Schema,
    fields: Sequence[FieldPath],
    stamp: FieldPath | None,
    time_format: str,
) -> Decoder:
    """Decoder of the messages of a schema.

    Parameters
    ----------
    path, topic
        For messages of errors.
    schema
        Its record.
    fields
        What is wanted of each message.
    stamp
        Where its time stamp is: a number, or a message of seconds and nanoseconds.
    time_format
        How a stamp is written that is one number.

    Raises
    ------
    LogError
        ``log_extra_missing``, ``log_damaged``; ``log_column_missing`` or ``log_type`` where a path
        leads nowhere, or to something else than a number.
    """
    message_class, decode_error = _message_class(path, schema)
    root = message_class.DESCRIPTOR
    parts = [] if stamp is None else _stamp_parts(root, stamp)
    kinds = {one: _kind(path, topic, root, one) for one in (*fields, *parts)}
    follows = [_follow(root, one) for one in kinds]

    def decode(payloads: Payloads) -> Decoded:
        count = payloads.start.size
        columns: list[list[Any]] = [[None] * count for _ in kinds]
        sound = np.ones(count, np.bool_)
        pairs = list(zip(columns, follows, strict=True))
        for i, payload in enumerate(_each(payloads)):
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
        return Decoded(readings, _stamps(found, time_format) if found else None)

    return decode


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
        waiting = {file.name: file for file in files}
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


def _add_file(pool: Any, waiting: dict[str, Any], name: str) -> None:
    """Add a file to the pool, after those that it imports."""
    file = waiting.pop(name)
    for dependency in file.dependency:
        if dependency in waiting:
            _add_file(pool, waiting, dependency)
    pool.Add(file)


def _kind(path: Path, topic: str, root: Any, wanted: FieldPath) -> str:
    """NumPy's name of the type of a field."""
    message, field, in_array = root, None, False
    for step in wanted:
        if isinstance(step, int):
            inside, in_array = in_array, False
        else:
            by_name = {} if in_array or message is None else message.fields_by_name
            field = by_name.get(step)
            inside = field is not None
            if field is not None:
                message, in_array = field.message_type, _is_repeated(field)
        if not inside or field is None:
            raise LogError(
                "log_column_missing",
                path,
                f"messages of topic {topic!r} have no field {path_text(wanted)!r}; there are "
                + ", ".join(repr(name) for name in _names(root, "", 0)[:40]),
                topic,
            )
    kind = None if in_array or field is None else _NUMBERS.get(field.cpp_type)
    if kind is None:
        raise LogError("log_type", path, f"field {path_text(wanted)!r} is no number", topic)
    return kind


_NUMBERS = {1: "i4", 2: "i8", 3: "u4", 4: "u8", 5: "f8", 6: "f4"}
"""NumPy's names by the runtime's ``CPPTYPE_INT32`` and so on; neither truth values nor enums."""


def _is_repeated(field: Any) -> bool:
    # Older runtimes know only the label, newer ones warn of it.
    is_repeated = getattr(field, "is_repeated", None)
    return bool(field.label == field.LABEL_REPEATED if is_repeated is None else is_repeated)


def _names(message: Any, before: str, depth: int) -> list[str]:
    """Paths to all numbers, an array's by its first element."""
    names: list[str] = []
    for field in message.fields:
        name = before + field.name + ("[0]" if _is_repeated(field) else "")
        if field.cpp_type in _NUMBERS:
            names.append(name)
        # A message may hold itself.
        elif field.message_type is not None and depth < 5 and len(names) < 40:
            names += _names(field.message_type, name + ".", depth + 1)
    return names


def _follow(root: Any, path: FieldPath) -> _Follow:
    """Function of a message that gives what a path leads to; None where that is not set."""
    steps: list[tuple[str | int, bool]] = []
    message = root
    for step in path:
        has_presence = False
        if isinstance(step, str):
            field = message.fields_by_name[step]
            message, has_presence = field.message_type, field.has_presence
        steps.append((step, has_presence))

    def follow(message: Any) -> Any:
        for step, has_presence in steps:
            if isinstance(step, int):
                if step >= len(message):
                    return None
                message = message[step]
            elif has_presence and not message.HasField(step):
                return None
            else:
                message = getattr(message, step)
        return message

    return follow


def _stamp_parts(root: Any, stamp: FieldPath) -> list[FieldPath]:
    """Paths to the seconds and nanoseconds of a stamp, or to the one number that it is."""
    message = root
    for step in stamp:
        field = message.fields_by_name.get(step) if message is not None else None
        message = message if isinstance(step, int) else getattr(field, "message_type", None)
    names = [] if message is None else list(message.fields_by_name)
    seconds = [(*stamp, name) for name in SECONDS if name in names]
    nanoseconds = [(*stamp, name) for name in NANOSECONDS if name in names]
    return [*seconds[:1], *nanoseconds[:1]] if seconds and nanoseconds else [stamp]


def _each(payloads: Payloads) -> Iterator[bytes]:
    text = payloads.text.tobytes()
    for start, length in zip(payloads.start.tolist(), payloads.length.tolist(), strict=True):
        yield text[start : start + length]


def _readings(values: Sequence[float | None], sound: NDArray[np.bool_]) -> Readings:
    missing = np.array([value is None for value in values], dtype=np.bool_)
    raw = np.array(values, dtype=np.float64)
    example = None if sound.all() else "a message that is not as its descriptor says"
    return Readings(raw, missing, ~sound, example)


def _numbers(values: Sequence[Any], kind: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Numbers, 0 where there is none, and where there is one."""
    there = np.array([value is not None for value in values], dtype=np.bool_)
    return np.array([value or 0 for value in values], dtype=kind), there


def _stamps(
    found: Sequence[tuple[NDArray[Any], NDArray[np.bool_]]], time_format: str
) -> WrittenStamps:
    if len(found) == 2:
        (seconds, there), (nanoseconds, also) = found
        return stamps_of_seconds(seconds, nanoseconds, there & also)
    # Nothing is before 1990, so that a missing one is not readable.
    return stamps_of_numbers(found[0][0], time_format)

"""JSON messages: many payloads are laid out as lines and parsed at once.

Of messages that differ in one number alone, only the number is parsed (`one_number`). Where a piece
does not come out as one object a line, with a number or null in each wanted field, it is parsed
message by message, so that what is no number is found and counted. Each way gives what the `json`
module gives, but for the sign of an integer -0 and for integers of over 4300 digits.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json as arrow_json

from pipeline.config.field_paths import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.arrow_types import nulls
from pipeline.ingest.assembly import Readings, readings_of
from pipeline.ingest.mcap.layout import fields_at
from pipeline.ingest.mcap.messages import read_messages
from pipeline.ingest.mcap.one_number import one_number
from pipeline.ingest.mcap.payloads import (
    NANOSECONDS,
    SECONDS,
    Decoded,
    Decoder,
    Payloads,
    stamps_of_numbers,
    stamps_of_parts,
    unreadable_stamps,
)
from pipeline.ingest.time_stamps import WrittenStamps, written_as_text

_INT64 = np.iinfo(np.int64)
_ELEMENTS_SHOWN = 4
_DEEPEST = 6
_MOST_SHAPES = 32
_Tree = dict[str | int, Any]
"""Arrow types by path, step by step."""


def json_decoder(
    fields: Sequence[FieldPath],
    stamp: FieldPath | None,
    time_format: str,
    qualities: Sequence[FieldPath] = (),
) -> Decoder:
    """Decoder of JSON messages; a quality may be text, a number or a truth value.

    A stamp is a number or text in a format, or an object of seconds and nanoseconds.
    """

    is_one_number = len(fields) == 1 and stamp is None and not qualities

    @lru_cache(_MOST_SHAPES)
    def value(message: bytes) -> object:
        return _value(json_object(message), fields[0])

    def decode(payloads: Payloads) -> Decoded:
        if is_one_number:
            numbers = one_number(payloads, value)
            if numbers is not None:
                return Decoded({fields[0]: readings_of(pa.array(numbers))}, None)
        types = _quality_types(payloads, qualities)
        for kinds in _stamp_kinds(payloads, stamp, time_format):
            decoded = _at_once(payloads, fields, kinds, time_format, types)
            if decoded is not None:
                return decoded
        return _one_by_one(payloads, fields, stamp, time_format, qualities)

    return decode


def require_json_field(path: Path, topic: str, field: FieldPath, *, salvage: bool) -> None:
    """Refuse a topic without the field in any message; a field that is null is a missing sample.

    Raises
    ------
    LogError
        ``log_column_missing``: it says which fields there are.
    """
    there: set[str] = set()
    for messages in read_messages(path, salvage=salvage):
        ids = [i for i, channel in messages.channels.items() if channel.topic == topic]
        for i in np.flatnonzero(np.isin(messages.channel_id, ids)).tolist():
            payload = messages.buffer[messages.payload_start[i] : messages.payload_end[i]]
            message = json_object(bytes(payload)) or {}
            if _has(message, field):
                return
            if len(there) < 40:
                there.update(path_text(one) for one, _ in islice(leaves(message), 40))
    raise LogError(
        "log_column_missing",
        path,
        f"no message of topic {topic!r} has a field {path_text(field)!r}; there are "
        + ", ".join(map(repr, sorted(there)[:40])),
        topic,
    )


def _stamp_kinds(
    payloads: Payloads, stamp: FieldPath | None, time_format: str
) -> list[dict[FieldPath, pa.DataType]]:
    """Types that the stamp's parts may have, by path, as the first message has it.

    None at all where it tells no type.
    """
    if stamp is None:
        return [{}]
    value = _value(json_object(payloads.first), stamp)
    if isinstance(value, str):
        return [{stamp: pa.string()}]
    if isinstance(value, dict) and (names := _names(value)):
        return [{(*stamp, name): pa.int64() for name in names}]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return []
    # As a float64, nanoseconds since 1970 come in steps of 256.
    whole: dict[FieldPath, pa.DataType] = {stamp: pa.int64()}
    return [whole] if time_format == "epoch_ns" else [whole, {stamp: pa.float64()}]


def _quality_types(
    payloads: Payloads, qualities: Sequence[FieldPath]
) -> dict[FieldPath, pa.DataType]:
    """Types of the qualities, as the first message has them."""
    first = json_object(payloads.first) if qualities else None
    types: dict[FieldPath, pa.DataType] = {}
    for path in qualities:
        value = _value(first, path)
        is_number = isinstance(value, int | float)
        types[path] = pa.float64() if is_number else pa.string()
        if isinstance(value, bool):
            types[path] = pa.bool_()
    return types


def _names(value: Mapping[str, Any]) -> tuple[str, str] | None:
    """Names of the seconds and nanoseconds of a stamp."""
    seconds = next((name for name in SECONDS if name in value), None)
    nanoseconds = next((name for name in NANOSECONDS if name in value), None)
    return (seconds, nanoseconds) if seconds and nanoseconds else None


def _at_once(
    payloads: Payloads,
    fields: Sequence[FieldPath],
    stamp_types: Mapping[FieldPath, pa.DataType],
    time_format: str,
    quality_types: Mapping[FieldPath, pa.DataType],
) -> Decoded | None:
    """Readings; None unless every line is one object and every wanted value of its type or null."""
    # A stamp may be a reading too, but not where it is text.
    if any(stamp_types.get(field) == pa.string() for field in fields):
        return None
    types = {**dict.fromkeys(fields, pa.float64()), **stamp_types}
    if any(types.get(path, kind) != kind for path, kind in quality_types.items()):
        return None
    table = _table(payloads, {**types, **quality_types})
    if table is None:
        return None
    readings = {field: readings_of(_column(table, field)) for field in fields}
    parts = [_column(table, part) for part in stamp_types]
    qualities = {path: _column(table, path) for path in quality_types}
    return Decoded(readings, _stamps(parts, time_format) if parts else None, qualities)


def _table(payloads: Payloads, types: Mapping[FieldPath, pa.DataType]) -> pa.Table | None:
    schema = _schema(types)
    # The parser takes objects, not lines: without this, an object begun in one message and ended in
    # the next would go through.
    if schema is None or not payloads.length.all():
        return None
    first = fields_at(payloads.text.data, payloads.start, "u1")
    last = fields_at(payloads.text.data, payloads.start + payloads.length - 1, "u1")
    if not ((first == ord("{")).all() and (last == ord("}")).all()):
        return None
    block_size = max(2**20, 2 * int(payloads.length.max()))
    try:
        table = arrow_json.read_json(
            pa.BufferReader(pa.py_buffer(payloads.text)),
            read_options=arrow_json.ReadOptions(use_threads=False, block_size=block_size),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=schema, unexpected_field_behavior="ignore"
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    return table if table.num_rows == payloads.start.size else None


def _schema(types: Mapping[FieldPath, pa.DataType]) -> pa.Schema | None:
    """Arrow's schema of the wanted fields; None where one of them is part of another."""
    tree: _Tree = {}
    for path, kind in types.items():
        node = tree
        for step in path[:-1]:
            node = node.setdefault(step, {})
            if not isinstance(node, dict):
                return None
        if node.setdefault(path[-1], kind) is not kind:
            return None
    made = _arrow_type(tree)
    return None if made is None else pa.schema(list(made))


def _arrow_type(node: object) -> pa.DataType | None:
    if not isinstance(node, dict):
        return node
    inner = {step: _arrow_type(below) for step, below in node.items()}
    if None in inner.values():
        return None
    if all(isinstance(step, str) for step in inner):
        return pa.struct(list(inner.items()))
    # Positions of an array: all of one type, or the message has to be looked at by itself.
    kinds = list(inner.values())
    same = all(isinstance(step, int) for step in inner) and kinds.count(kinds[0]) == len(kinds)
    return pa.list_(kinds[0]) if same else None


def _column(table: pa.Table, path: FieldPath) -> pa.Array:
    values = table.column(path[0]).combine_chunks()
    if isinstance(values, pa.ChunkedArray):
        values = pa.concat_arrays(values.chunks)
    for step in path[1:]:
        values = pc.struct_field(values, step) if isinstance(step, str) else _element(values, step)
    return values


def _element(lists: pa.ListArray, position: int) -> pa.Array:
    """An element of each list; null where the list is shorter."""
    length = pc.fill_null(pc.list_value_length(lists), 0).to_numpy()
    at = lists.offsets.to_numpy()[:-1] + position
    return lists.values.take(pa.array(at, mask=length <= position))


def _stamps(parts: Sequence[pa.Array], time_format: str) -> WrittenStamps:
    if pa.types.is_string(parts[0].type):
        return written_as_text(pa.chunked_array(parts), time_format)
    numbers = [(pc.fill_null(part, 0).to_numpy(), ~nulls(part)) for part in parts]
    return stamps_of_parts(numbers, time_format)


def _one_by_one(
    payloads: Payloads,
    fields: Sequence[FieldPath],
    stamp: FieldPath | None,
    time_format: str,
    qualities: Sequence[FieldPath],
) -> Decoded:
    count = payloads.start.size
    raw = {field: np.full(count, np.nan) for field in fields}
    missing = {field: np.ones(count, dtype=np.bool_) for field in fields}
    unparsed = {field: np.zeros(count, dtype=np.bool_) for field in fields}
    examples: dict[FieldPath, str] = {}
    stamps: list[object] = []
    words: dict[FieldPath, list[str | None]] = {path: [] for path in qualities}
    for i, payload in enumerate(payloads.each()):
        message = json_object(payload)
        for field in fields:
            value = _value(message, field)
            number = _number(value)
            if number is not None:
                raw[field][i], missing[field][i] = number, False
            elif message is None or value is not None:
                unparsed[field][i] = True
                examples.setdefault(field, repr(payload if message is None else value)[:60])
        if stamp is not None:
            stamps.append(_value(message, stamp))
        for path in qualities:
            value = _value(message, path)
            # Halves of letters beyond the first 65 536 are no text to Arrow.
            word = None if value is None else str(value).encode(errors="replace").decode()
            words[path].append(word)
    readings = {
        field: Readings(raw[field], missing[field], unparsed[field], examples.get(field))
        for field in fields
    }
    cells = {path: pa.array(words[path], pa.string()) for path in qualities}
    return Decoded(readings, None if stamp is None else _mixed_stamps(stamps, time_format), cells)


def _mixed_stamps(values: Sequence[object], time_format: str) -> WrittenStamps:
    """Stamps of any kind each."""
    # No stamp holds a letter beyond ASCII, and halves of such letters are no text to Arrow.
    is_text = [isinstance(value, str) and value.isascii() for value in values]
    texts = [value if text else None for value, text in zip(values, is_text, strict=True)]
    written = written_as_text(pa.chunked_array([pa.array(texts, pa.string())]), time_format)
    time_us, kind = written.time_us.copy(), written.kind.copy()
    for i in np.flatnonzero(~np.array(is_text)).tolist():
        stamp = _number_stamp(values[i], time_format)
        time_us[i], kind[i] = stamp.time_us[0], stamp.kind[0]
    return WrittenStamps(time_us, kind)


def _number_stamp(value: object, time_format: str) -> WrittenStamps:
    if isinstance(value, dict) and (names := _names(value)):
        parts = [value[name] for name in names]
        if all(_fits(part) for part in parts):
            there = np.ones(1, np.bool_)
            return stamps_of_parts([(np.array([part]), there) for part in parts], time_format)
    if _fits(value) or isinstance(value, float):
        return stamps_of_numbers(np.array([value]), time_format)
    return unreadable_stamps(1)


def _fits(value: object) -> bool:
    return (
        isinstance(value, int) and not isinstance(value, bool) and _INT64.min <= value <= _INT64.max
    )


def json_object(payload: bytes) -> dict[str, Any] | None:
    """The object that a message is; None: it is none."""
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def _value(message: Any, path: FieldPath) -> object:
    """The value that a path leads to; None where it leads nowhere."""
    for step in path:
        if not _leads(message, step):
            return None
        message = message[step]
    return message


def _has(message: Any, path: FieldPath) -> bool:
    """True if a path leads to something, be it null, or is cut short by a null."""
    for step in path:
        if not _leads(message, step):
            return message is None
        message = message[step]
    return True


def _leads(node: object, step: str | int) -> bool:
    """True for an object with such a key, or an array with such a position."""
    if isinstance(step, str):
        return isinstance(node, dict) and step in node
    return isinstance(node, list) and step < len(node)


def leaves(node: Any, path: FieldPath = ()) -> Iterator[tuple[FieldPath, Any]]:
    """Values that are neither objects nor arrays, by path; of an array the first ones."""
    below: Iterable[tuple[str | int, Any]] = ()
    if isinstance(node, dict):
        below = node.items()
    elif isinstance(node, list):
        below = enumerate(node[:_ELEMENTS_SHOWN])
    else:
        yield path, node
    for step, inner in below if len(path) < _DEEPEST else ():
        # A key without a letter cannot stand in a path.
        if step != "":
            yield from leaves(inner, (*path, step))


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:  # An integer of more than 308 digits is a number, but not finite.
        return math.inf if value > 0 else -math.inf

"""JSON messages: many payloads are laid out as lines and parsed at once.

Of messages that differ in a single number, only the number is parsed. What does not come out as an
object a line, with values of a type in each wanted field, is parsed message by message. Each way
gives what the `json` module gives, but for the sign of an integer -0 and integers of 4300 digits.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import islice
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json as arrow_json
from numpy.typing import NDArray

from pipeline.config.logs import FieldPath
from pipeline.ingest.assembly import readings_of
from pipeline.ingest.cells import nulls
from pipeline.ingest.mcap.decoding import (
    Decoded,
    Decoder,
    Payloads,
    Wanted,
    one_by_one,
    pair_of,
    stamps_of_numbers,
    value_at,
)
from pipeline.ingest.mcap.messages import column, fields_at
from pipeline.ingest.time_stamps import WrittenStamps, parse_written

_MOST_SHAPES = 32
_NUMBER = re.compile(rb" *-?[0-9][-+.0-9eE]*")
_MOST_NUMBERS = 8
_LONGEST = 1024
_WIDEST = 40
_BLANK, _PLUS, _POINT, _ZERO, _NINE = b" +.09"
_Tree = dict[str | int, Any]
"""Arrow types by path, step by step."""


def json_decoder(wanted: Wanted) -> Decoder:
    """Return decoder of JSON messages; a quality may be text, a number or a truth value.

    A stamp is a number or text in a format, or an object of seconds and nanoseconds.
    """
    is_one_number = len(wanted.readings) == 1 and not wanted.stamp and not wanted.qualities
    paths = [*wanted.readings, *wanted.qualities, *([wanted.stamp] if wanted.stamp else [])]
    values = {path: partial(value_at, path=path) for path in paths}

    @lru_cache(_MOST_SHAPES)
    def value(message: bytes) -> object:
        return value_at(json_object(message), wanted.readings[0])

    def decode(payloads: Payloads) -> Decoded:
        if is_one_number:
            numbers = _one_number(payloads, value)
            if numbers is not None:
                readings = readings_of(pa.array(numbers))
                return Decoded({wanted.readings[0]: readings}, None, {})
        decoded = _at_once(payloads, wanted)
        if decoded is not None:
            return decoded
        messages = list(map(json_object, payloads.each()))
        broken = (
            payload
            for payload, message in zip(payloads.each(), messages, strict=True)
            if message is None
        )
        return one_by_one(messages, wanted, values, repr(next(broken, b""))[:60])

    return Decoder(decode, json_object)


def _at_once(payloads: Payloads, wanted: Wanted) -> Decoded | None:
    """Return readings; None unless each line is an object with values of their types or null."""
    first = json_object(payloads.first) if wanted.stamp or wanted.qualities else None
    stamp_types = _stamp_types(first, wanted)
    # A stamp may be a reading too, but not where it is text.
    if stamp_types is None or pa.string() in map(stamp_types.get, wanted.readings):
        return None
    types = {**dict.fromkeys(wanted.readings, pa.float64()), **stamp_types}
    for path in wanted.qualities:
        kind = _type_of(value_at(first, path)) or pa.string()
        if types.setdefault(path, kind) != kind:
            return None
    table = _table(payloads, types)
    if table is None:
        return None
    readings = {path: readings_of(_column(table, path)) for path in wanted.readings}
    qualities = {path: _column(table, path) for path in wanted.qualities}
    parts = [_column(table, path) for path in stamp_types]
    return Decoded(readings, _stamps(parts, wanted.time_format) if parts else None, qualities)


def _stamp_types(first: Any, wanted: Wanted) -> dict[FieldPath, pa.DataType] | None:
    """Return types of the stamp's parts, by path, by the first message; None where unknown."""
    if wanted.stamp is None:
        return {}
    stamp = value_at(first, wanted.stamp)
    if isinstance(stamp, dict) and (names := pair_of(stamp)):
        return {(*wanted.stamp, name): pa.int64() for name in names}
    # As a float64, nanoseconds since 1970 come in steps of 256; smaller counts are exact.
    is_whole = type(stamp) is int and wanted.time_format == "epoch_ns"
    kind = pa.int64() if is_whole else _type_of(stamp)
    return None if kind is None or pa.types.is_boolean(kind) else {wanted.stamp: kind}


def _type_of(value: object) -> pa.DataType | None:
    if isinstance(value, bool):
        return pa.bool_()
    if isinstance(value, int | float):
        return pa.float64()
    return pa.string() if isinstance(value, str) else None


def _table(payloads: Payloads, types: Mapping[FieldPath, pa.DataType]) -> pa.Table | None:
    schema = _schema(types)
    # The parser takes objects, not lines: without this, an object begun in a message and ended in
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
    return table if table.num_rows == payloads.length.size else None


def _schema(types: Mapping[FieldPath, pa.DataType]) -> pa.Schema | None:
    """Return Arrow's schema of the wanted fields; None if any is in an array or another."""
    tree: _Tree = {}
    for path, kind in types.items():
        node = tree
        for step in path[:-1]:
            node = node.setdefault(step, {})
            if not isinstance(node, dict):
                return None
        if node.setdefault(path[-1], kind) is not kind or any(
            isinstance(part, int) for part in path
        ):
            return None
    return pa.schema(list(_struct(tree)))


def _struct(tree: _Tree) -> pa.DataType:
    inner = {
        step: _struct(below) if isinstance(below, dict) else below for step, below in tree.items()
    }
    return pa.struct(list(inner.items()))


def _column(table: pa.Table, path: FieldPath) -> pa.Array:
    values = pa.concat_arrays(table.column(path[0]).chunks)
    return pc.struct_field(values, list(path[1:])) if path[1:] else values


def _stamps(parts: Sequence[pa.Array], time_format: str) -> WrittenStamps:
    if pa.types.is_string(parts[0].type):
        return parse_written([pa.chunked_array(parts)], time_format)
    # Nothing is before 1990, so that a missing stamp is not readable.
    numbers = [(pc.fill_null(part, 0).to_numpy(), ~nulls(part)) for part in parts]
    return stamps_of_numbers(numbers, time_format)


def json_object(payload: bytes) -> dict[str, Any] | None:
    """Return the object that a message is; None: it is none."""
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


# Messages that differ in a single number: nothing else of them is parsed twice.


def _one_number(payloads: Payloads, value: Callable[[bytes], object]) -> NDArray[np.float64] | None:
    """Return the wanted number of each message; None unless all else is in all of them the same.

    `value` is what the `json` module finds in a message. Where it finds two other numbers that are
    put in the place of the first message's, it would find any.
    """
    around = _around_number(payloads.first, value)
    if around is None:
        return None
    before, behind = around
    if payloads.length.max() > _LONGEST:
        return None
    numbers = np.empty(payloads.length.size)
    for rows, length, text in payloads.by_length():
        width = length - len(before) - len(behind)
        if not 0 < width <= _WIDEST:
            return None
        size, end = length + 1, length + 1 - len(behind)
        if not (_stand(text, 1, before, size) and _stand(text, end, behind, size)):
            return None
        # With the byte before each.
        cells = column(text, len(before), f"V{width + 1}", size).view(np.uint8)
        figures = _decimals(cells, width + 1)
        if figures is None:
            return None
        numbers[rows] = figures
    return numbers


def _around_number(first: bytes, value: Callable[[bytes], object]) -> tuple[bytes, bytes] | None:
    """Return text before and behind the wanted number of a message."""
    if len(first) > _LONGEST:
        return None
    for match in islice(_NUMBER.finditer(first), _MOST_NUMBERS):
        before, behind = first[: match.start()], first[match.end() :]
        if all(value(before + b"%g" % other + behind) == other for other in (1, -20.5)):
            return before, behind
    return None


def _stand(text: memoryview, at: int, expected: bytes, size: int) -> bool:
    """Return True if the very bytes stand at a place in each row of a size."""
    actual = column(text, at, f"V{len(expected)}", size).tobytes()
    return actual == expected * (len(text) // size)


def _decimals(cells: NDArray[np.uint8], width: int) -> NDArray[np.float64] | None:
    """Return numbers in cells of a width, the first byte of each aside; None if any is not JSON.

    Arrow's cast refuses what is no number. JSON has no plus here, no point without a digit on
    either side, and no zero before the digits of a number; exponents are left to the parser.
    """
    cells[::width] = _BLANK
    if cells.min() < _BLANK or cells.max() > _NINE:
        return None
    digit, point = cells >= _ZERO, cells == _POINT
    inner_zero = (cells[1:-1] == _ZERO) & digit[2:]
    if (
        (cells == _PLUS).any()
        or point[-1]
        or (point[1:] > digit[:-1]).any()
        or (point[:-1] > digit[1:]).any()
        or (inner_zero > (digit | point)[:-2]).any()
    ):
        return None
    edges = pa.py_buffer(np.arange(0, cells.size + 1, width, dtype=np.int32))
    texts = pa.Array.from_buffers(
        pa.string(), cells.size // width, [None, edges, pa.py_buffer(cells)]
    )
    try:
        numbers = pc.ascii_ltrim_whitespace(texts).cast(pa.float64())
    except pa.ArrowInvalid:
        return None
    decimals: NDArray[np.float64] = numbers.to_numpy()
    return decimals

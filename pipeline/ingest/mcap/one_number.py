"""JSON messages that differ in one number alone: nothing else of them is parsed twice."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import islice

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.ingest.mcap.layout import fields_at
from pipeline.ingest.mcap.payloads import Payloads, cut_out

_NUMBER = re.compile(rb" *-?[0-9][-+.0-9eE]*")
_MOST_NUMBERS = 8
_LONGEST = 1024
_BLANK, _MINUS, _POINT, _ZERO = b" -.0"


def one_number(payloads: Payloads, value: Callable[[bytes], object]) -> pa.Array | None:
    """The wanted number of each message; None unless all else is in all of them the same.

    `value` is what the `json` module finds in a message. Where it finds two other numbers that are
    put in the place of the first message's, it would find any.
    """
    around = _around_number(payloads.first, value)
    if around is None:
        return None
    before, behind = around
    starts = payloads.start + len(before)
    ends = payloads.start + payloads.length - len(behind)
    text = payloads.text.data
    if (starts >= ends).any():
        return None
    if not (_stands(text, payloads.start, before) and _stands(text, ends, behind)):
        return None
    cells, cell_starts = cut_out(text, starts, ends, _BLANK)
    if not _are_decimals(cells):
        return None
    edges = np.append(cell_starts - 1, cells.size).astype(np.int32)
    buffers = [None, pa.py_buffer(edges), pa.py_buffer(cells)]
    numbers = pa.Array.from_buffers(pa.string(), starts.size, buffers)
    try:
        return pc.ascii_ltrim_whitespace(numbers).cast(pa.float64())
    except pa.ArrowInvalid:
        return None


def _around_number(first: bytes, value: Callable[[bytes], object]) -> tuple[bytes, bytes] | None:
    """Text before and behind the wanted number of a message."""
    if len(first) > _LONGEST:
        return None
    for found in islice(_NUMBER.finditer(first), _MOST_NUMBERS):
        before, behind = first[: found.start()], first[found.end() :]
        if all(value(before + b"%g" % other + behind) == other for other in (1, -20.5)):
            return before, behind
    return None


def _stands(text: memoryview, at: NDArray[np.int64], expected: bytes) -> bool:
    """True if the very bytes stand at each place."""
    return fields_at(text, at, f"V{len(expected)}").tobytes() == expected * at.size


def _are_decimals(cells: NDArray[np.uint8]) -> bool:
    """True if cells, each behind a blank, hold no text that Arrow casts and JSON has not.

    JSON has no point without a digit on either side, and no zero before the digits of a number;
    exponents are left to the parser.
    """
    digit, point = cells - np.uint8(_ZERO) < 10, cells == _POINT
    in_number = digit | point
    leading_zero = (cells[1:-1] == _ZERO) & digit[2:] & ~in_number[:-2]
    return bool(
        (in_number | (cells == _MINUS) | (cells == _BLANK)).all()
        and not (point[1:] & ~digit[:-1]).any()
        and not (point[:-1] & ~digit[1:]).any()
        and not point[-1]
        and not leading_zero.any()
    )

"""JSON messages that differ in one number alone: nothing else of them is parsed twice."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import islice

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.ingest.mcap.decoding import Payloads
from pipeline.ingest.mcap.layout import column

_NUMBER = re.compile(rb" *-?[0-9][-+.0-9eE]*")
_MOST_NUMBERS = 8
_LONGEST = 1024
_WIDEST = 40
_BLANK, _PLUS, _POINT, _ZERO, _NINE = b" +.09"


def one_number(payloads: Payloads, value: Callable[[bytes], object]) -> NDArray[np.float64] | None:
    """The wanted number of each message; None unless all else is in all of them the same.

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
        found = _decimals(cells, width + 1)
        if found is None:
            return None
        numbers[rows] = found
    return numbers


def _around_number(first: bytes, value: Callable[[bytes], object]) -> tuple[bytes, bytes] | None:
    """Text before and behind the wanted number of a message."""
    if len(first) > _LONGEST:
        return None
    for found in islice(_NUMBER.finditer(first), _MOST_NUMBERS):
        before, behind = first[: found.start()], first[found.end() :]
        if all(value(before + b"%g" % other + behind) == other for other in (1, -20.5)):
            return before, behind
    return None


def _stand(text: memoryview, at: int, expected: bytes, size: int) -> bool:
    """True if the very bytes stand at a place in each row of a size."""
    found = column(text, at, f"V{len(expected)}", size).tobytes()
    return found == expected * (len(text) // size)


def _decimals(cells: NDArray[np.uint8], width: int) -> NDArray[np.float64] | None:
    """Numbers in cells of one width, the first byte of each aside; None where some is none of JSON.

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

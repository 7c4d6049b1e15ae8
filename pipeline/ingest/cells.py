"""Cells of a log: their types, blank ones, and the quality that they state of samples."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.config.channels import QualityValue
from pipeline.errors import LogError

NUMBER_LIKE = r"^[^#]*\d[^#]*$"
"""What has a digit, but #DIV/0! and 1.#QNAN."""

_GOOD, _BAD, _BLANK = 0, 1, 2
"""States of a cell of a quality column."""

_MOST_VALUES = 1000
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|[+-]?inf(inity)?")
_TRUTH = {"true": 1.0, "false": 0.0}


def may_be_number(cell: str) -> bool:
    """Return True for a cell that may be a number in another dialect, and is no word for none."""
    return re.search(NUMBER_LIKE, cell) is not None


def is_text(kind: pa.DataType) -> bool:
    """Return True for text of any layout."""
    types = pa.types
    return bool(types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind))


def is_number(kind: pa.DataType) -> bool:
    """Return True for integers, decimals and floating-point numbers; truth values are none."""
    types = pa.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def nulls(column: pa.Array | pa.ChunkedArray) -> NDArray[np.bool_]:
    """Return True for each null of a column."""
    if not column.null_count:
        return np.zeros(len(column), np.bool_)
    return pl.Series(column.is_null()).to_numpy()


def quality_states(
    path: Path, name: str, cells: pa.Array | pa.ChunkedArray, good: Iterable[QualityValue]
) -> NDArray[np.uint8]:
    """Return state of each cell of a quality column: good, bad or blank; blank where it is null.

    Text is compared without regard to case and blanks around it, and as a number where both are
    numbers: 192, 192.0 and "192" are the same, and so are true and 1.

    Raises LogError: ``log_type``: the column holds neither text nor numbers, or too many different
    ones.
    """
    kind, is_a = cells.type, pa.types
    if not (is_text(kind) or is_number(kind) or is_a.is_boolean(kind) or is_a.is_null(kind)):
        raise LogError("log_type", path, f"a column of type {kind} is no quality", name)
    encoded = cells.dictionary_encode()
    if isinstance(encoded, pa.ChunkedArray):
        encoded = encoded.combine_chunks()
    values = encoded.dictionary.to_pylist()
    if len(values) > _MOST_VALUES:
        how = f"more than {_MOST_VALUES} different values are no quality"
        raise LogError("log_type", path, how, name)
    texts = frozenset(map(_text, good))
    numbers = frozenset(number for text in texts if (number := _number(text)) is not None)
    blank = _GOOD if "" in texts else _BLANK
    of_value = np.array([*(_state(v, texts, numbers) for v in values), blank], np.uint8)
    states: NDArray[np.uint8] = of_value[
        encoded.indices.cast(pa.int64()).fill_null(len(values)).to_numpy()
    ]
    return states


def is_bad(states: NDArray[np.uint8], missing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return samples not called good by the log: where the quality is blank, those with a value."""
    bad: NDArray[np.bool_] = (states == _BAD) | ((states == _BLANK) & ~missing)
    return bad


def _state(value: object, texts: frozenset[str], numbers: frozenset[float]) -> int:
    text = "" if value is None or value != value else _text(value)
    if text in texts or _number(text) in numbers:
        return _GOOD
    return _BAD if text else _BLANK


def _text(value: object) -> str:
    return str(value).strip().casefold()


def _number(text: str) -> float | None:
    if text in _TRUTH:
        return _TRUTH[text]
    # `float` also takes 1_92 and the digits of other scripts.
    return float(text) if _NUMBER.fullmatch(text) else None

"""Kinds of Arrow types, and marks of cells."""

from __future__ import annotations

import numpy as np
import polars as pl
import pyarrow as pa
from numpy.typing import NDArray


def is_text(kind: pa.DataType) -> bool:
    """True for text of any layout."""
    types = pa.types
    return bool(types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind))


def is_number(kind: pa.DataType) -> bool:
    """True for integers, decimals and floating-point numbers; truth values are none."""
    types = pa.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def nulls(column: pa.Array | pa.ChunkedArray) -> NDArray[np.bool_]:
    """True for each null of a column."""
    if not column.null_count:
        return np.zeros(len(column), np.bool_)
    return pl.Series(column.is_null()).to_numpy()

"""Text in columns of Parquet, which a few bytes may repeat any number of times.

Such columns are read as dictionaries, each text once, and written out only where that is of a size
that a log can have.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.errors import LogError

MOST_TEXT_A_ROW = 256
"""Bytes of a stamp, a name or a quality, on average over some rows."""

_SLACK = 2**22


def is_text(kind: pa.DataType) -> bool:
    """Whether a type is one of text."""
    return bool(
        pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
    )


def text_paths(fields: Iterable[pa.Field], above: str = "") -> list[str]:
    """Paths of all columns of text, those within others too."""
    found: list[str] = []
    for field in fields:
        path = above + field.name
        if pa.types.is_struct(field.type):
            found += text_paths(field.type, f"{path}.")
        elif is_text(field.type):
            found.append(path)
    return found


def decoded(path: Path, name: str, column: pa.Array) -> pa.Array:
    """A column without a dictionary.

    Parameters
    ----------
    path, name
        File and column, for messages of errors.
    column
        Of any type.

    Raises
    ------
    LogError
        ``log_too_large``: its text is longer than any of a log.
    """
    if not pa.types.is_dictionary(column.type):
        return column
    if is_text(column.type.value_type):
        lengths = pc.binary_length(column.dictionary)
        _require_short(path, name, pc.sum(lengths.take(column.indices)).as_py() or 0, len(column))
    return column.dictionary_decode()


def _require_short(path: Path, name: str, size: int, rows: int) -> None:
    if size > MOST_TEXT_A_ROW * rows + _SLACK:
        raise LogError(
            "log_too_large",
            path,
            f"column {name!r} unfolds to {size} bytes in {rows} rows, which no log does: see what "
            "it is",
            name,
        )

"""Cells of a CSV, as text or as Arrow parsed them, to readings and stamps.

A column is parsed as numbers or stamps at once where that can be; a bad cell costs its column some
speed and nothing else, and is counted.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pipeline.config.logs import Logs
from pipeline.config.time_formats import EPOCH_UNITS, EXCEL_DAYS
from pipeline.errors import LogError
from pipeline.ingest.arrow_types import nulls
from pipeline.ingest.assembly import Readings, readings_of
from pipeline.ingest.time_stamps import WrittenStamps, written

_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$|^[+-]?(?i:nan|inf|infinity)$"


def stamps(logs: Logs, columns: list[pa.ChunkedArray]) -> WrittenStamps:
    """Time stamps of a column of time, or of one of dates and one of times."""
    numeric = logs.time_format in EPOCH_UNITS or logs.time_format == EXCEL_DAYS
    if logs.decimal == "," and numeric and pa.types.is_string(columns[-1].type):
        columns = [*columns[:-1], pc.replace_substring(columns[-1], ",", ".")]
    return written(columns, logs.time_format)


def time_types(logs: Logs) -> tuple[pa.DataType, ...]:
    """Types of a time column that Arrow may parse, to be tried in turn; then comes text."""
    if logs.date_column:
        return ()
    if logs.time_format == "iso8601":
        return (pa.timestamp("us", "UTC"), pa.timestamp("us"))
    if logs.time_format in EPOCH_UNITS:
        return (pa.int64(),)
    return (pa.float64(),) if logs.time_format == EXCEL_DAYS else ()


def with_missing_tokens(logs: Logs, table: pa.Table, kept: Collection[str]) -> pa.Table:
    """A table with null for the tokens of a missing sample in its columns of text, but for some."""
    tokens = pa.array(logs.missing_tokens, pa.string())
    for at, name in enumerate(table.column_names):
        column = table.column(at)
        if name not in kept and pa.types.is_string(column.type):
            is_token = pc.is_in(column, value_set=tokens)
            table = table.set_column(at, name, pc.if_else(is_token, None, column))
    return table


def readings(path: Path, logs: Logs, name: str, cells: pa.ChunkedArray) -> Readings:
    """Numbers of a column of text, or of one that Arrow could parse as float64.

    Raises
    ------
    LogError
        ``log_damaged``: a quotation mark is opened and not closed in its row.
    """
    if pa.types.is_floating(cells.type):
        return readings_of(cells)
    trimmed = cells
    if logs.thousands:
        trimmed = _without_groups(logs, cells)
    elif logs.decimal == ",":
        # A dot is then no decimal sign: 1.234 may be a thousand and more.
        trimmed = pc.replace_substring(pc.replace_substring(cells, ".", "_"), ",", ".")
    try:
        return readings_of(trimmed.cast(pa.float64()))
    except pa.ArrowInvalid:
        return _cell_by_cell(path, logs, name, cells, trimmed)


def _without_groups(logs: Logs, cells: pa.ChunkedArray) -> pa.ChunkedArray:
    """Numbers without marks between their thousands; a mark elsewhere stays, and is no number."""
    mark, decimal = re.escape(logs.thousands), re.escape(logs.decimal)
    trimmed = pc.utf8_trim_whitespace(cells)
    grouped = rf"^[+-]?[0-9]{{1,3}}({mark}[0-9]{{3}})+({decimal}[0-9]*)?$"
    plain = pc.if_else(
        pc.match_substring_regex(trimmed, grouped),
        pc.replace_substring(trimmed, logs.thousands, ""),
        pc.replace_substring(trimmed, logs.thousands, "_"),
    )
    if logs.decimal == ".":
        return plain
    return pc.replace_substring(pc.replace_substring(plain, ".", "_"), ",", ".")


def _cell_by_cell(
    path: Path, logs: Logs, name: str, texts: pa.ChunkedArray, dotted: pa.ChunkedArray
) -> Readings:
    """Slower, for a column in which some cell is no bare number."""
    if pc.any(pc.match_substring_regex(texts, r"[\r\n]")).as_py():
        raise LogError(
            "log_damaged", path, "a quotation mark is opened and not closed in its row", name
        )
    trimmed = pc.utf8_trim_whitespace(dotted)
    is_number = pc.match_substring_regex(trimmed, _NUMBER)
    # The grammar lets through one sign at most; the cast below knows no plus.
    unsigned = pc.utf8_ltrim(pc.if_else(is_number, trimmed, None), "+")
    blank = pc.is_in(
        pc.utf8_trim_whitespace(texts), value_set=pa.array(logs.missing_tokens, pa.string())
    )
    missing = np.logical_not(pc.fill_null(is_number, False).to_numpy())
    unparsed = missing & ~nulls(texts) & np.logical_not(blank.to_numpy())
    example = texts[int(np.argmax(unparsed))].as_py() if unparsed.any() else None
    raw = readings_of(unsigned.cast(pa.float64())).raw
    return Readings(raw, missing, unparsed, example)

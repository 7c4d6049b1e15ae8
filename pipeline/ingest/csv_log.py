"""Logs as delimited text.

All wanted columns are taken as text and converted column by column, so that a bad cell costs its
own column some speed and nothing else, and is counted. A row with too many or too few cells, and a
last row without a line end, are left out and counted: half a figure looks like a figure.
"""

from __future__ import annotations

import codecs
import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv
from numpy.typing import NDArray

from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings, require_time, span, time_name, wide_log
from pipeline.ingest.contract import LogSource, RawLog
from pipeline.ingest.time_stamps import TimeStampError, TimeStamps, from_text

LARGEST_FILE = 4 * 2**30
"""Bytes; a CSV is held in memory while it is read."""

_HEAD = 2**20
_SPAN_PIECE = 2**16
_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$|^[+-]?(?i:nan|inf|infinity)$"


@dataclass(frozen=True, slots=True)
class _Text:
    """A CSV taken apart: UTF-8, whole lines only."""

    names: tuple[str, ...]
    body: memoryview
    torn_rows: int


@dataclass(frozen=True, slots=True)
class _Table:
    columns: dict[str, pa.ChunkedArray]
    ragged_rows: int


def read_csv_log(path: Path, source: LogSource) -> RawLog:
    """Read the wanted columns of a CSV.

    Parameters
    ----------
    path
        An existing file.
    source
        Its dialect and channels.

    Raises
    ------
    LogError
        As listed in `pipeline.ingest.contract`.
    """
    text = _split(path, _utf8(path, _bytes(path), source.encoding), source)
    wanted = dict.fromkeys([source.time_source, *(c.source for c in source.channels)])
    table = _table(path, source, text, tuple(wanted))
    columns = {
        channel.channel: _readings(path, source, channel.source, table.columns[channel.source])
        for channel in source.channels
    }
    refused = {
        "last row without a line end (it may be cut)": text.torn_rows,
        "rows with too many or too few cells": table.ragged_rows,
    }
    return wide_log(path, source, _stamps(path, source, table), columns, refused)


def csv_time_span(path: Path, source: LogSource) -> tuple[int, int]:
    """First and last time stamp of a CSV, from its first and last rows where these can be read.

    Raises
    ------
    LogError
        As `read_csv_log`; ``log_empty`` where there is no row.
    """
    if _is_utf8(source.encoding) and path.stat().st_size > 4 * _SPAN_PIECE:
        try:
            return _span_of_ends(path, source)
        except LogError:
            # Say what is wrong, or find the span, from the whole file.
            pass
    text = _split(path, _utf8(path, _bytes(path), source.encoding), source)
    return _span(path, source, [text])


def _span_of_ends(path: Path, source: LogSource) -> tuple[int, int]:
    with path.open("rb") as file:
        head = file.read(_SPAN_PIECE)
        file.seek(-_SPAN_PIECE, 2)
        tail = file.read()
    first = _split(path, _utf8(path, head, source.encoding), source)
    start = tail.find(b"\n") + 1
    whole_lines = _repaired(tail[start : _end_of_lines(tail)])
    last = _Text(first.names, memoryview(whole_lines), 0)
    return _span(path, source, [first, last])


def _span(path: Path, source: LogSource, texts: Sequence[_Text]) -> tuple[int, int]:
    parts: list[NDArray[np.int64]] = []
    for text in texts:
        stamps = _stamps(path, source, _table(path, source, text, (source.time_source,)))
        require_time(path, stamps, time_name(source))
        parts.append(stamps.time_us[stamps.readable])
    return span(path, parts)


def _bytes(path: Path) -> bytes:
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise LogError(
            "log_too_large",
            path,
            f"{size} bytes are more than the {LARGEST_FILE} that a CSV may have: split it, or use "
            "Parquet",
        )
    return path.read_bytes()


def _is_utf8(encoding: str) -> bool:
    return codecs.lookup(encoding).name in {"utf-8", "utf-8-sig", "ascii"}


def _utf8(path: Path, data: bytes, encoding: str) -> bytes:
    """The file's text as UTF-8 without a byte order mark."""
    if not _is_utf8(encoding):
        try:
            # An incremental decoder leaves half a character at the end to the last, cut row.
            data = codecs.getincrementaldecoder(encoding)().decode(data).encode()
        except (UnicodeError, ValueError) as error:
            raise LogError(
                "log_encoding", path, f"the text is not in encoding {encoding}: {error}"
            ) from error
    _refuse_binary(path, data[:4096])
    return _repaired(data).removeprefix(codecs.BOM_UTF8)


def _repaired(data: bytes) -> bytes:
    """What is not UTF-8 gets a mark in its place, and a cell with a mark is no number."""
    return data if data.isascii() else data.decode(errors="replace").encode()


def _refuse_binary(path: Path, head: bytes) -> None:
    nul = head.count(0)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or 5 * nul > 2 * len(head):
        raise LogError(
            "log_encoding", path, 'the text looks like UTF-16: set encoding = "utf-16" for this log'
        )
    if nul:
        raise LogError(
            "log_not_csv", path, "the file is not text: set the format it has, or unpack it first"
        )


def _end_of_lines(data: bytes) -> int:
    return max(data.rfind(b"\n"), data.rfind(b"\r")) + 1


def _split(path: Path, data: bytes, source: LogSource) -> _Text:
    """Names of the columns, and the rows below them up to the last line end."""
    lines = data[:_HEAD].splitlines(keepends=True)
    header = source.skip_rows
    while header < len(lines) and not lines[header].strip():
        header += 1
    if header >= len(lines):
        raise LogError("log_empty", path, f"no header after {source.skip_rows} skipped lines")
    if not lines[header].endswith((b"\n", b"\r")):
        code = "log_truncated" if len(data) < _HEAD else "log_not_csv"
        raise LogError(code, path, "the header has no line end", f"line {header + 1}")
    try:
        cells = next(csv.reader([lines[header].decode()], delimiter=source.separator))
    except csv.Error as error:
        raise LogError("log_not_csv", path, f"the header cannot be read: {error}") from error
    start = sum(map(len, lines[: header + 1]))
    end = max(_end_of_lines(data), start)
    torn = int(bool(data[end : end + _HEAD].strip()))
    return _Text(tuple(cell.strip() for cell in cells), memoryview(data)[start:end], torn)


def _positions(
    path: Path, source: LogSource, names: Sequence[str], wanted: Sequence[str]
) -> list[int]:
    for name in wanted:
        count = names.count(name)
        if count > 1:
            raise LogError(
                "log_column_twice", path, f"{count} columns are called {name!r}: rename one"
            )
        if not count:
            there = ", ".join(repr(known[:40]) for known in names[:40])
            hint = ", not in encoding utf-8: set the right one" if "\ufffd" in there else ""
            raise LogError(
                "log_column_missing",
                path,
                f"no column {name!r}; separated by {source.separator!r} there are {there}{hint}",
            )
    return [names.index(name) for name in wanted]


def _table(path: Path, source: LogSource, text: _Text, wanted: tuple[str, ...]) -> _Table:
    """The wanted columns as text, rows of the wrong width left out."""
    keys = [str(i) for i in _positions(path, source, text.names, wanted)]
    if not len(text.body):
        return _Table({name: pa.chunked_array([], pa.string()) for name in wanted}, 0)
    try:
        table, ragged = _parse(source, text, keys)
    except pa.ArrowInvalid as error:
        raise LogError("log_damaged", path, f"the rows cannot be told apart: {error}") from error
    if any("\n" in row.text.rstrip("\r\n") for row in ragged):
        raise LogError("log_damaged", path, "a quotation mark is opened and not closed in its row")
    if len(ragged) > table.num_rows:
        raise LogError(
            "log_not_csv",
            path,
            f"{len(ragged)} of {len(ragged) + table.num_rows} rows have not the header's "
            f"{len(text.names)} cells, the first has {ragged[0].actual_columns}: check separator "
            "and skip_rows",
        )
    return _Table(dict(zip(wanted, map(table.column, keys), strict=True)), len(ragged))


def _parse(source: LogSource, text: _Text, keys: list[str]) -> tuple[pa.Table, list[Any]]:
    ragged: list[Any] = []

    def leave_out(row: Any) -> str:
        ragged.append(row)
        return "skip"

    # Columns go by position: names may repeat, or be those of no column that is wanted.
    table = arrow_csv.read_csv(
        pa.BufferReader(pa.py_buffer(text.body)),
        read_options=arrow_csv.ReadOptions(column_names=[str(i) for i in range(len(text.names))]),
        parse_options=arrow_csv.ParseOptions(
            delimiter=source.separator, invalid_row_handler=leave_out
        ),
        convert_options=arrow_csv.ConvertOptions(
            include_columns=keys,
            column_types=dict.fromkeys(keys, pa.string()),
            null_values=list(source.missing_tokens),
            strings_can_be_null=True,
        ),
    )
    return table, ragged


def _stamps(path: Path, source: LogSource, table: _Table) -> TimeStamps:
    texts = table.columns[source.time_source]
    if source.decimal == "," and source.time_format.startswith("epoch_"):
        texts = pc.replace_substring(texts, ",", ".")
    try:
        return from_text(texts, source.time_format, source.time_zone)
    except TimeStampError as error:
        raise LogError("log_time", path, str(error), source.time_source) from error


def _readings(path: Path, source: LogSource, name: str, texts: pa.ChunkedArray) -> Readings:
    """Numbers of a column of text."""
    dotted = texts
    if source.decimal == ",":
        # A dot is then no decimal sign: 1.234 may be a thousand and more.
        dotted = pc.replace_substring(pc.replace_substring(texts, ".", "_"), ",", ".")
    try:
        numbers = dotted.cast(pa.float64())
    except pa.ArrowInvalid:
        return _readings_cell_by_cell(path, source, name, texts, dotted)
    missing = texts.is_null().to_numpy()
    return Readings(_floats(numbers), missing, np.zeros(missing.size, dtype=np.bool_))


def _readings_cell_by_cell(
    path: Path, source: LogSource, name: str, texts: pa.ChunkedArray, dotted: pa.ChunkedArray
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
        pc.utf8_trim_whitespace(texts), value_set=pa.array(source.missing_tokens, pa.string())
    )
    missing = np.logical_not(pc.fill_null(is_number, False).to_numpy())
    unparsed = missing & texts.is_valid().to_numpy() & np.logical_not(blank.to_numpy())
    example = texts[int(np.argmax(unparsed))].as_py() if unparsed.any() else None
    return Readings(_floats(unsigned.cast(pa.float64())), missing, unparsed, example)


def _floats(numbers: pa.ChunkedArray) -> NDArray[np.float64]:
    floats: NDArray[np.float64] = pc.fill_null(numbers, np.nan).to_numpy()
    return floats

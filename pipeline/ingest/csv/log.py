"""Logs as delimited text, read in pieces, so that memory holds the readings and not the text.

A row with too many or too few cells, and a last row without a line end, are left out and counted:
half a figure looks like a figure. Where a header comes again in the middle, it holds from there on.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.csv as arrow_csv

from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest.contract import LogFile, Place, RawLog
from pipeline.ingest.csv import cells as csv_cells
from pipeline.ingest.csv.header import HeadedRows, Header, headed_rows, rows_begin
from pipeline.ingest.csv.text import Lines, is_packed, is_utf8, read_lines, repaired
from pipeline.ingest.table import Columns, RawTable, wanted_columns

_SPAN_PIECE = 2**16
# Room for more rows than those of a file's first piece make likely: they may be shorter further on.
_SLACK = 1.1
# From so many rows of another width on, most of the rows before must have the header's.
_MANY_RAGGED = 2**19


def read_csv_log(file: LogFile) -> RawLog:
    """Read the wanted columns of a CSV, plain or packed with gzip or Zstandard."""
    reader = _Reader(RawTable(file), wanted_columns(file))
    for lines in read_lines(file.path, file.logs.encoding):
        reader.read(lines)
    return reader.log()


def csv_units(file: LogFile) -> dict[str, str]:
    """Units in the line below the header, by column; none without such a line."""
    if not file.logs.unit_rows:
        return {}
    data = next(read_lines(file.path, file.logs.encoding, _SPAN_PIECE)).data
    header = Header(file.path, file.logs, ())
    below = data[header.take_first(data) :].splitlines()[:1]
    return dict(zip(header.names, *map(header.cells, below), strict=False)) if below else {}


def csv_can_grow(file: LogFile) -> bool:
    """True for plain text, to which rows are appended."""
    return is_utf8(file.logs.encoding) and not is_packed(file.path)


def read_csv_piece(file: LogFile, place: Place, most_bytes: int) -> tuple[RawLog | None, Place]:
    """Rows of a growing CSV from a place on, as far as its last line end, and the place behind."""
    with file.path.open("rb") as text_file:
        text_file.seek(place.position)
        data = text_file.read(most_bytes)
    end = max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
    if not end:
        return None, place
    reader = _Reader(RawTable(file), wanted_columns(file), is_whole=False)
    if place.columns:
        reader.header.resume(place.columns)
    text = data[:end] if place.position else data[:end].removeprefix(codecs.BOM_UTF8)
    reader.read(Lines(repaired(text)))
    if reader.header.unit_rows_left:
        return None, place
    return reader.log(), Place(place.position + end, reader.header.names)


def csv_time_span(file: LogFile) -> tuple[int, int]:
    """First and last time stamp of a CSV, from its first and last rows where these can be read."""
    times = Columns(wanted_columns(file).time, None, ())
    if csv_can_grow(file) and file.path.stat().st_size > 4 * _SPAN_PIECE:
        try:
            return _span_of_ends(file, times)
        except LogError:
            pass  # The whole file says what is wrong, or has the span.
    reader = _Reader(RawTable(file), times)
    for lines in read_lines(file.path, file.logs.encoding):
        reader.read(lines)
    reader.require_rows_of_one_width()
    return reader.table.span()


def _span_of_ends(file: LogFile, times: Columns) -> tuple[int, int]:
    with file.path.open("rb") as text_file:
        text_file.seek(-_SPAN_PIECE, 2)
        tail = text_file.read()
    begin, end = tail.find(b"\n") + 1, max(tail.rfind(b"\n"), tail.rfind(b"\r")) + 1
    reader = _Reader(RawTable(file), times)
    reader.read(next(read_lines(file.path, file.logs.encoding, _SPAN_PIECE)))
    first = reader.table.span()
    reader.table = RawTable(file)
    reader.read(Lines(repaired(tail[begin:end])))
    last = reader.table.span()
    return min(first[0], last[0]), max(first[1], last[1])


class _Ragged(NamedTuple):
    """A row of another width: its piece, its line within it, both from 0, and its cells."""

    piece: int
    line: int
    cells: int


def _first(ragged: Sequence[Any], data: bytes, start: int, piece: int) -> _Ragged:
    """The first of some rows of a piece, told by their text."""
    cells = {re.split(r"[\r\n]", row.text)[0].encode(): row.actual_columns for row in ragged}
    above = len(data[:start].splitlines())
    rows = enumerate(data[start:].splitlines(), above)
    return next(_Ragged(piece, at, cells[row]) for at, row in rows if row in cells)


class _Reader:
    """Takes the pieces of a file one after the other, and gives the log."""

    def __init__(self, table: RawTable, columns: Columns, *, is_whole: bool = True) -> None:
        self.is_whole = is_whole
        self.path = table.path
        self.logs = logs = table.logs
        self.columns = columns
        self.table = table
        self.header = Header(table.path, logs, columns.all)
        self.torn = 0
        self.rows = 0
        self.ragged = 0
        self.first_ragged = _Ragged(0, 0, 0)
        self.pieces = 0
        numbers: tuple[pa.DataType, ...] = () if logs.thousands else (pa.float64(),)
        # What each column may be parsed as at once; what fails is not tried again.
        self.types: dict[str, tuple[pa.DataType, ...]] = dict.fromkeys(columns.numbers, numbers)
        self.types |= dict.fromkeys(columns.time, csv_cells.time_types(logs))
        self.types |= dict.fromkeys(columns.qualities, (pa.string(),))

    def read(self, lines: Lines) -> None:
        """Take a piece."""
        self.torn += bool(lines.torn)
        if lines.torn or not lines.data:
            self.header.require(torn=lines.torn)
            return
        self.pieces += 1
        start = rows_begin(self.header, lines.data)
        if self._read_at_once(lines.data, start):
            return
        for rows in headed_rows(self.header, lines.data, start):
            self._read_rows(rows, lines.data, start)
        if self.ragged > _MANY_RAGGED:
            self.require_rows_of_one_width()

    def _read_at_once(self, data: bytes, start: int) -> bool:
        """Read a piece all of whose cells are numbers and stamps, so that no header is in it."""
        keys = {name: str(at) for name, at in self.header.position.items()}
        if start == len(data) or not all(self.types.get(name) for name in keys):
            return False
        whole = HeadedRows(
            memoryview(data)[start:], len(self.header.names), self.header.position, 0
        )
        try:
            types = {key: self.types[name][0] for name, key in keys.items()}
            table, ragged = self._parse(whole, types)
        except pa.ArrowInvalid:
            return False
        if ragged:
            return False
        self._count(table.num_rows, len(data))
        # In the parser's own blocks, which need no copy to be arrays.
        for batch in table.to_batches():
            self._add({name: pa.chunked_array([batch.column(key)]) for name, key in keys.items()})
        return True

    def _count(self, rows: int, size: int) -> None:
        """Count rows; by those of the first piece, make room for the whole file."""
        if (
            self.is_whole
            and not self.rows
            and is_utf8(self.logs.encoding)
            and not is_packed(self.path)
        ):
            self.table.expect(int(_SLACK * rows * self.path.stat().st_size / size))
        self.rows += rows

    def log(self) -> RawLog:
        """All that was read."""
        self.require_rows_of_one_width()
        ragged = "row with too many or too few cells"
        if self.ragged:
            first = self.first_ragged
            ragged += f", the first in line {self._line(first)} with {first.cells}"
        return self.table.log(
            {
                "last row without a line end (it may be cut)": self.torn,
                ragged: self.ragged,
                "line equal to the header": self.header.repeated,
            }
        )

    def require_rows_of_one_width(self) -> None:
        """Refuse a file most of whose rows do not have the header's number of cells."""
        if self.ragged > self.rows:
            raise LogError(
                "log_not_csv",
                self.path,
                f"{self.ragged} of {self.ragged + self.rows} rows have not the header's "
                f"{len(self.header.names)} cells, the first has {self.first_ragged.cells}: check "
                "separator and skip_rows",
                f"line {self._line(self.first_ragged)}",
            )

    def _line(self, row: _Ragged) -> int:
        """Number of a row's line in the file, from 1."""
        # Counted only where it is asked for, which costs a sound file nothing.
        pieces = islice(read_lines(self.path, self.logs.encoding), row.piece + 1)
        line, last = row.line + 1, b""
        for number, lines in enumerate(pieces):
            # A line end of two characters may be cut in two.
            line -= last.endswith(b"\r") and lines.data.startswith(b"\n")
            if number < row.piece:
                line += len(lines.data.splitlines())
            last = lines.data
        return line

    def _read_rows(self, rows: HeadedRows, data: bytes, start: int) -> None:
        keys = {name: str(at) for name, at in rows.position.items()}
        try:
            table, ragged = self._parsed(rows, keys)
        except pa.ArrowInvalid as error:
            raise LogError(
                "log_damaged",
                self.path,
                f"the rows cannot be told apart: {error}",
                f"after line {rows.line}" if rows.line else None,
            ) from error
        swallowed = [row for row in ragged if "\n" in row.text.rstrip("\r\n")]
        if swallowed:
            first = _first(swallowed, data, start, self.pieces - 1)
            raise LogError(
                "log_damaged",
                self.path,
                "a quotation mark is opened and not closed in its row",
                f"line {self._line(first)}",
            )
        if ragged and not self.ragged:
            self.first_ragged = _first(ragged, data, start, self.pieces - 1)
        self.ragged += len(ragged)
        self._count(table.num_rows, len(rows.body))
        self._add({name: table.column(key) for name, key in keys.items()})

    def _parsed(self, rows: HeadedRows, keys: dict[str, str]) -> tuple[pa.Table, list[Any]]:
        """The columns parsed at once, or as text where that cannot be."""
        types = {key: self.types.get(name) or () for name, key in keys.items()}
        while any(types.values()):
            first = {key: kinds[0] if kinds else pa.string() for key, kinds in types.items()}
            try:
                return self._parse(rows, first)
            except pa.ArrowInvalid:
                failed = self._next_types(rows, keys)
                if not failed:
                    break
                types = {key: self.types.get(name) or () for name, key in keys.items()}
        return self._parse(rows, dict.fromkeys(keys.values(), pa.string()))

    def _next_types(self, rows: HeadedRows, keys: dict[str, str]) -> bool:
        """Try the next types of the columns that are not of their first; False: all are."""
        failed = False
        for name, key in keys.items():
            while kinds := self.types.get(name, ()):
                try:
                    self._parse(rows, {key: kinds[0]})
                    break
                except pa.ArrowInvalid:
                    self.types[name] = kinds[1:]
                    failed = True
        return failed

    def _add(self, cells: Mapping[str, pa.ChunkedArray]) -> None:
        cells = self.table.of_motor(self.columns, cells)
        self.table.add(
            csv_cells.stamps(self.logs, [cells[name] for name in self.columns.time]),
            {
                name: csv_cells.readings(self.path, self.logs, name, cells[name])
                for name in self.columns.numbers
            },
            self.columns.channel_names(cells),
            {name: cells[name] for name in self.columns.qualities},
        )

    def _parse(self, rows: HeadedRows, types: dict[str, pa.DataType]) -> tuple[pa.Table, list[Any]]:
        """Columns by position, and the rows that are left out."""
        if not self.columns.qualities:
            return _parse(self.logs, rows, types)
        # What means "no sample" in a column of readings is an answer in one of qualities.
        table, ragged = _parse(self.logs, rows, types, text_can_be_null=False)
        kept = {str(rows.position[name]) for name in self.columns.qualities}
        return csv_cells.with_missing_tokens(self.logs, table, kept), ragged


def _parse(
    logs: Logs,
    rows: HeadedRows,
    types: dict[str, pa.DataType],
    *,
    text_can_be_null: bool = True,
) -> tuple[pa.Table, list[Any]]:
    ragged: list[Any] = []

    def leave_out(row: Any) -> str:
        ragged.append(row)
        return "skip"

    # Columns go by position: names may repeat, or be those of no column that is wanted.
    table = arrow_csv.read_csv(
        pa.BufferReader(pa.py_buffer(rows.body)),
        read_options=arrow_csv.ReadOptions(
            use_threads=False, column_names=list(map(str, range(rows.width)))
        ),
        parse_options=arrow_csv.ParseOptions(
            delimiter=logs.separator, invalid_row_handler=leave_out
        ),
        convert_options=arrow_csv.ConvertOptions(
            include_columns=list(types),
            column_types=types,
            null_values=list(logs.missing_tokens),
            strings_can_be_null=text_can_be_null,
            decimal_point=logs.decimal,
        ),
    )
    return table, ragged

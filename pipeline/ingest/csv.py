"""Logs as delimited text, read in pieces, so that memory holds the readings and not the text.

A piece is parsed as numbers and stamps at once; where some cell of it is neither, all its cells are
taken as text, and what is no number is counted. A row with too many or too few cells, and a last
row without a line end, are left out and counted: half a figure looks like a figure.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv

from pipeline.config.logs import EPOCH_UNITS, EXCEL_DAYS, Logs
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings, readings_of
from pipeline.ingest.cells import NUMBER_LIKE
from pipeline.ingest.contract import LogFile, RawLog, Reader
from pipeline.ingest.table import Columns, RawTable, require_columns, wanted_columns
from pipeline.ingest.time_stamps import WrittenStamps, parse_written

MOST_CELLS = 2**14
"""Cells of a header, as many as a spreadsheet has; the parser takes 2 kB for each."""

LARGEST_TEXT = 4 * 2**30
"""Bytes of text in a file, packed or not; readings of more would not fit into memory."""

LARGEST_RATIO = 400
"""Bytes of text to a byte of a packed file. A motor that stands still all night has below 100."""

PIECE = 2**21
"""Bytes read at a time: few enough to stay in the processor's cache."""

LONGEST_LINE = 2**25
"""Bytes of a line; a file with longer ones is no table."""

_RATIO_FROM = 2**26
_LINE = 2**12
_UNPACKED_HERE = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd"}
_PACKERS = {
    **_UNPACKED_HERE,
    b"PK\x03\x04": "zip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"7z\xbc\xaf": "7z",
    b"Rar!": "rar",
}

_HEAD = 2**20
_SPAN_PIECE = 2**16
_SHOWN = 60
_NAME = r"^[^\d+.,-]*\p{L}"
_OPEN_QUOTE = "a quotation mark is opened and not closed in its row"


def _read(file: LogFile) -> RawLog:
    """Read the wanted columns of a CSV, plain or packed with gzip or Zstandard."""
    return _rows(file, wanted_columns(file)).log()


def _span(file: LogFile) -> tuple[int, int]:
    """Return first and last time stamp of a CSV, from its first and last rows if readable."""
    times = Columns(wanted_columns(file).time)
    with file.path.open("rb") as text_file:
        is_plain = _is_utf8(file.logs.encoding) and _packer(text_file.read(8)) is None
    if is_plain and file.path.stat().st_size > 4 * _SPAN_PIECE:
        # Where they cannot be read, the whole file says what is wrong, or has the span.
        with suppress(LogError):
            return _span_of_ends(file, times)
    reader = _rows(file, times)
    reader.require_rows_of_one_width()
    return reader.table.span()


def _rows(file: LogFile, columns: Columns) -> _Rows:
    """Read all rows of a file."""
    reader = _Rows(file, columns)
    for data in read_lines(file.path, file.logs.encoding):
        reader.read(data)
    return reader


def _span_of_ends(file: LogFile, times: Columns) -> tuple[int, int]:
    with file.path.open("rb") as text_file:
        text_file.seek(-_SPAN_PIECE, 2)
        tail = text_file.read()
    begin, end = tail.find(b"\n") + 1, max(tail.rfind(b"\n"), tail.rfind(b"\r")) + 1
    head, last_rows = _Rows(file, times), _Rows(file, times)
    head.read(next(read_lines(file.path, file.logs.encoding, _SPAN_PIECE)))
    last_rows.go_on(head.names)
    last_rows.read(repair(tail[begin:end]))
    first, last = head.table.span(), last_rows.table.span()
    return min(first[0], last[0]), max(first[1], last[1])


def _header(path: Path, logs: Logs, data: bytes) -> tuple[tuple[str, ...], int]:
    """Return names of the header of a file, and the bytes up to the rows below its units."""
    lines = data[:_HEAD].splitlines(keepends=True)
    at = logs.skip_rows
    while at < len(lines) and not lines[at].strip():
        at += 1
    if at >= len(lines) or not lines[at].endswith((b"\n", b"\r")):
        if at < len(lines) and len(data) > _HEAD:
            how = f"the header is longer than {_HEAD} bytes"
            raise LogError("log_not_csv", path, how, f"line {at + 1}")
        if data and not data.endswith((b"\n", b"\r")):
            raise LogError("log_truncated", path, "the header has no line end")
        raise LogError("log_empty", path, f"no header after {logs.skip_rows} skipped lines")
    names = _cells(path, logs, lines[at])
    if len(names) > MOST_CELLS:
        how = f"the header has {len(names)} cells, at most {MOST_CELLS} are read: check separator"
        raise LogError("log_not_csv", path, how)
    end, units_left = at + 1, logs.unit_rows
    while units_left and end < len(lines):
        units_left -= bool(lines[end].strip())
        end += 1
    return names, sum(map(len, lines[:end]))


def _cells(path: Path, logs: Logs, line: bytes) -> tuple[str, ...]:
    """Return cells of a header or a line of units, without blanks around them."""
    text = line.decode().strip("\r\n").removeprefix("\ufeff")
    try:
        row = next(csv.reader([text], delimiter=logs.separator), [])
    except csv.Error as error:
        raise LogError("log_not_csv", path, f"the header cannot be read: {error}") from error
    return tuple(cell.strip() for cell in row)


class _Rows:
    """Takes the pieces of a file in turn, and gives the log."""

    def __init__(self, file: LogFile, columns: Columns) -> None:
        self.path, self.logs = file.path, file.logs
        self.columns = columns
        numbers = partial(_readings, file.path, file.logs)
        self.table = RawTable(file, columns, partial(_stamps, file.logs), numbers)
        self.names: tuple[str, ...] = ()
        self.position: Mapping[str, int] = {}
        self.head = b""  # the lines above the rows
        self.torn = self.rows = self.ragged = 0
        self.first_ragged = ""

    def go_on(self, names: tuple[str, ...]) -> None:
        """Read rows below a header of these names."""
        parted = f"separated by {self.logs.separator!r} "
        require_columns(self.path, names, self.columns.all, parted)
        self.position = {name: names.index(name) for name in self.columns.all}
        self.names = names

    def read(self, data: bytes) -> None:
        """Take a piece."""
        start = 0
        if not self.names:
            names, start = _header(self.path, self.logs, data)
            self.head = data[:start]
            self.go_on(names)
        if not data.endswith((b"\n", b"\r")):
            self.torn += bool(data)
            return
        if start < len(data):
            self._read_rows(data, start)

    def _read_rows(self, data: bytes, start: int) -> None:
        types = self._types()
        texts = dict.fromkeys(types, pa.string())
        outcome = None
        with suppress(pa.ArrowInvalid):
            outcome = self._parsed(types, data, start)
        try:
            table, ragged = outcome or self._parsed(texts, data, start)
        except pa.ArrowInvalid as error:
            how = f"the rows are ambiguous: {error}"
            raise LogError("log_damaged", self.path, how) from error
        if ragged.swallowed:
            raise LogError("log_damaged", self.path, f"{_OPEN_QUOTE}: {ragged.swallowed!r}")
        if ragged.header:
            raise self._other_header(ragged.header)
        # A header is no number, and no other text than any.
        if outcome is None or types == texts:
            self._require_no_other_header(table)
        self.ragged += ragged.count
        self.first_ragged = self.first_ragged or ragged.first
        self.rows += table.num_rows
        # In the parser's own blocks, which need no copy to be arrays.
        for batch in table.to_batches():
            columns = zip(self.position, batch.columns, strict=True)
            self.table.add({name: pa.chunked_array([column]) for name, column in columns})

    def _parsed(
        self, types: Mapping[str, pa.DataType], data: bytes, start: int
    ) -> tuple[pa.Table, _Ragged]:
        """Return columns by position, as some types, and the rows that are left out."""
        ragged = _Ragged(self._is_header)
        # Columns go by position: names may repeat, or be those of no column that is wanted.
        table = arrow_csv.read_csv(
            pa.BufferReader(pa.py_buffer(memoryview(data)[start:])),
            read_options=arrow_csv.ReadOptions(
                use_threads=False, column_names=list(map(str, range(len(self.names))))
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self.logs.separator, invalid_row_handler=ragged.leave_out
            ),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=list(types),
                column_types=dict(types),
                null_values=list(self.logs.missing_tokens),
                decimal_point=self.logs.decimal,
            ),
        )
        return table, ragged

    def _types(self) -> dict[str, pa.DataType]:
        """Return types that the wanted columns may be parsed as at once, by their position."""
        logs, types = self.logs, dict.fromkeys(self.columns.all, pa.string())
        if not logs.thousands:
            types |= dict.fromkeys(self.columns.numbers, pa.float64())
        time = pa.int64() if logs.time_format in EPOCH_UNITS else pa.string()
        time = pa.float64() if logs.time_format == EXCEL_DAYS else time
        types |= dict.fromkeys(self.columns.time, pa.string() if logs.date_column else time)
        return {str(at): types[name] for name, at in self.position.items()}

    def _is_header(self, line: str) -> bool:
        """Return True for a row of another width that has a name in the place of the time."""
        time = self.columns.time[0]
        if time in line:
            with suppress(LogError):
                cells, place = _cells(self.path, self.logs, line.encode()), self.position[time]
                return time in cells and place < len(cells) and cells[place] in self.names
        return False

    def _require_no_other_header(self, table: pa.Table) -> None:
        """Refuse a header with other columns: read on by position, they would be taken for these.

        Its cells are names that differ, and no stamp. Lines of the file's head that come again are
        rows without a time.
        """
        if not self.columns.numbers:
            return
        wanted = [self.position[name] for name in (*self.columns.time, *self.columns.numbers)]
        places = list(map(str, wanted))
        is_named = pl.all_horizontal(pl.col(places).str.contains(_NAME))
        rows = pl.DataFrame(table).filter(is_named).select(pl.col(places).str.strip_chars())
        if rows.is_empty():
            return
        times = rows.to_arrow().columns[: len(self.columns.time)]
        without_time = rows.filter(_stamps(self.logs, times).kind == 0)
        head = [_cells(self.path, self.logs, line) for line in self.head.splitlines()]
        known = {tuple(line[at] for at in wanted) for line in head if len(line) > max(wanted)}
        for cells in without_time.iter_rows():
            if cells not in known and len({*cells}) == len(cells):
                raise self._other_header(self.logs.separator.join(cells))

    def _other_header(self, line: str) -> LogError:
        how = "another header, with other columns than the first: split the log before "
        return LogError("log_not_csv", self.path, how + repr(line[:_SHOWN].strip()))

    def log(self) -> RawLog:
        """Return all that was read."""
        self.require_rows_of_one_width()
        ragged = f"row with too many or too few cells, the first has {self.first_ragged}"
        return self.table.log(
            {
                "last row without a line end (it may be cut)": self.torn,
                ragged: self.ragged,
            }
        )

    def require_rows_of_one_width(self) -> None:
        """Refuse a file most of whose rows do not have the header's number of cells."""
        if self.ragged > self.rows:
            how = (
                f"{self.ragged} of {self.ragged + self.rows} rows have not the header's "
                f"{len(self.names)} cells, the first has {self.first_ragged}: check separator and "
                "skip_rows"
            )
            raise LogError("log_not_csv", self.path, how)


@dataclass(slots=True)
class _Ragged:
    """Rows of a piece that have another width."""

    is_header: Callable[[str], bool]
    count: int = 0
    first: str = ""  # its cells and begin, for a message
    header: str = ""  # the first header
    swallowed: str = ""  # begin of the first that goes over several lines

    def leave_out(self, row: Any) -> str:
        """Count a row; nothing else is kept of it, as there may be many."""
        if not self.count:
            self.first = f"{row.actual_columns} in {row.text[:_SHOWN]!r}"
        if not self.header and self.is_header(row.text):
            self.header = row.text
        if not self.swallowed and "\n" in row.text.rstrip("\r\n"):
            self.swallowed = row.text[:_SHOWN]
        self.count += 1
        return "skip"


def _stamps(logs: Logs, columns: Sequence[pa.ChunkedArray]) -> WrittenStamps:
    """Return time stamps of a column of time, or of a column of dates and another of times."""
    numeric = logs.time_format in EPOCH_UNITS or logs.time_format == EXCEL_DAYS
    if logs.decimal == "," and numeric and pa.types.is_string(columns[-1].type):
        columns = [*columns[:-1], pc.replace_substring(columns[-1], ",", ".")]
    return parse_written(columns, logs.time_format)


def _readings(path: Path, logs: Logs, name: str, cells: pa.ChunkedArray) -> Readings:
    """Return numbers of a column of text, or of a column that Arrow could parse as float64."""
    if pa.types.is_floating(cells.type):
        return readings_of(cells)
    texts = pl.Series(name, cells)
    if texts.str.contains_any(["\n", "\r"]).any():
        raise LogError("log_damaged", path, _OPEN_QUOTE, name)
    plain = trimmed = texts.str.strip_chars()
    if logs.thousands:
        plain = _without_groups(logs, plain)
    if logs.decimal == ",":
        # A dot is then no decimal sign: 1.234 may be a thousand and more.
        plain = plain.str.replace_all(".", "_", literal=True).str.replace_all(
            ",", ".", literal=True
        )
    numbers = plain.cast(pl.Float64, strict=False)
    missing = numbers.is_null()
    blank = trimmed.is_null() | trimmed.is_in(logs.missing_tokens)
    unparsed = missing & ~blank
    lost = texts.filter(unparsed)
    numbers_lost = lost.filter(lost.str.contains(NUMBER_LIKE))
    example = next(chain(numbers_lost.head(1), lost.head(1)), None)
    raw = numbers.fill_null(np.nan).to_numpy()
    return Readings(raw, missing.to_numpy(), unparsed.to_numpy(), example)


def _without_groups(logs: Logs, cells: pl.Series) -> pl.Series:
    """Return numbers without marks between their thousands; a mark elsewhere makes it no number."""
    mark, decimal = re.escape(logs.thousands), re.escape(logs.decimal)
    grouped = rf"^[+-]?[0-9]{{1,3}}({mark}[0-9]{{3}})+({decimal}[0-9]*)?$"
    whole, none = (cells.str.replace_all(logs.thousands, to, literal=True) for to in ("", "_"))
    return whole.zip_with(cells.str.contains(grouped), none)


# The text: unpacked, decoded and cut into pieces of whole lines


def _is_utf8(encoding: str) -> bool:
    """Return True if text in an encoding is UTF-8 as it stands."""
    return codecs.lookup(encoding).name in {"utf-8", "utf-8-sig", "ascii"}


def _packer(head: bytes) -> str | None:
    return next((name for magic, name in _PACKERS.items() if head.startswith(magic)), None)


def read_lines(path: Path, encoding: str, piece: int = PIECE) -> Iterator[bytes]:
    """Yield text of a file, plain or packed, in UTF-8, as pieces of whole lines; `piece` in bytes.

    There is at least one piece. The last is what stands behind the last line end, if anything.
    Raises LogError for what is no text, in another encoding, too large, or cannot be unpacked.
    """
    pieces, begin = _decode(path, unpack(path, piece), encoding), b""
    while len(begin) < 4 and (data := next(pieces, None)) is not None:
        begin += data
    rest = list[bytes]()  # of a line whose end is not there yet
    for text in chain([_first(path, begin)], pieces):
        newline = text.rfind(b"\n")
        end = max(newline, text.rfind(b"\r", newline + 1)) + 1
        if end:
            yield repair(b"".join([*rest, text[:end]]))
            rest = []
        if end < len(text):
            rest.append(text[end:])
        if sum(map(len, rest)) > LONGEST_LINE:
            raise LogError("log_not_csv", path, f"a line is longer than {LONGEST_LINE} bytes")
    last = b"".join(rest)
    yield repair(last) if last.strip() else b""


def repair(data: bytes) -> bytes:
    """Return text with ASCII's minus, and a mark that is no number for what is not UTF-8."""
    if data.isascii():
        return data
    return data.decode(errors="replace").replace("\N{MINUS SIGN}", "-").encode()


def unpack(path: Path, piece: int) -> Iterator[bytes]:
    """Yield bytes of the text in pieces; errors as of `read_lines`."""
    size, total = path.stat().st_size, 0
    with path.open("rb") as file:
        packer = _packer(file.read(8))
        file.seek(0)
        if packer is not None and packer not in _UNPACKED_HERE.values():
            how = f"the file is packed with {packer}: unpack it, or use gzip"
            raise LogError("log_not_csv", path, how)
        # Up to the end of a line, where that is near: it need not be joined to the next piece.
        plain = iter(lambda: file.read(piece) + file.readline(_LINE), b"")
        for data in plain if packer is None else _inflate(path, file, packer, piece):
            total += len(data)
            if total > LARGEST_TEXT:
                how = f"there are over {LARGEST_TEXT} bytes of text: split it, or use Parquet"
                raise LogError("log_too_large", path, how)
            # By what has been unpacked so far: a bomb shows long before its end.
            if packer and total > max(_RATIO_FROM, LARGEST_RATIO * file.tell()):
                how = (
                    f"its {size} bytes expand to more than {LARGEST_RATIO} times as many, too many"
                )
                raise LogError("log_too_large", path, f"{how} for a log: check its content")
            yield data


def _inflate(path: Path, file: BinaryIO, packer: str, piece: int) -> Iterator[bytes]:
    # Not the zstandard package's reader: it takes a cut file for whole.
    try:
        with pa.CompressedInputStream(pa.PythonFile(file, "r"), packer) as stream:
            # Not `read`: in PyArrow 26 a stream that fails keeps what that has set aside for good.
            while (data := stream.read_buffer(piece)).size:
                yield data.to_pybytes()
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        if "runcated" in reason or "end of" in reason:
            how = f"the end of the {packer} file is missing: copy it again"
            raise LogError("log_truncated", path, how) from error
        how = f"the {packer} file cannot be unpacked: {reason}"
        raise LogError("log_damaged", path, how) from error


def _decode(path: Path, pieces: Iterator[bytes], encoding: str) -> Iterator[bytes]:
    """Yield pieces in UTF-8; half a character at the end is left to the last, cut row."""
    if _is_utf8(encoding):
        yield from pieces
        return
    decoder = codecs.getincrementaldecoder(encoding)()
    for data in pieces:
        try:
            yield decoder.decode(data).encode()
        except (UnicodeError, ValueError) as error:
            how = f"the text is not in encoding {encoding}: {error}"
            raise LogError("log_encoding", path, how) from error


def _first(path: Path, data: bytes) -> bytes:
    """Return first piece without its mark; what is no text, or in another encoding, is refused."""
    head = data[:4096]
    packer = _packer(head)
    if packer is not None:
        raise LogError("log_not_csv", path, f"what is in it is packed again, with {packer}")
    if head.startswith(b"SQLite format 3\0"):
        how = "this is an SQLite database: export its table as CSV or Parquet"
        raise LogError("log_not_csv", path, how)
    if head and not any(head):
        raise LogError("log_damaged", path, "the file holds nothing but zero bytes: copy it again")
    encoding = wide_encoding(head)
    if encoding:
        how = f'the text looks like {encoding.upper()}: set encoding = "{encoding}" for this log'
        raise LogError("log_encoding", path, how)
    if 0 in head:
        how = "the file is not text: set the format it has, or unpack it first"
        raise LogError("log_not_csv", path, how)
    return data.removeprefix(codecs.BOM_UTF8)


def wide_encoding(head: bytes) -> str | None:
    """Return encoding of text whose letters have zero bytes around them."""
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    # Of plain letters every other byte is zero in UTF-16, and three of four in UTF-32.
    nul = head.count(0)
    if 5 * nul <= 2 * len(head):
        return None
    return f"utf-{32 if 10 * nul > 7 * len(head) else 16}-{'le' if head[0] else 'be'}"


READER = Reader(_read, _span)

"""The first lines of a CSV: encoding, separator, header, line of units, and the cells below."""

from __future__ import annotations

import codecs
import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from pipeline.errors import LogError
from pipeline.ingest.csv.text import read_lines, unpacked
from pipeline.setup.guess_cells import is_missing, is_number
from pipeline.setup.guess_channels import unit_of
from pipeline.setup.guess_times import is_clock, is_date, is_stamp, is_time_name
from pipeline.units import CHANNELS

_HEAD_BYTES = 2**16
_MOST_LINES = 400
_SEPARATORS = (";", "\t", "|", ",")
_ENCODINGS = ("utf-8", "cp1252")
_BOMS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)

Cells = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CsvHead:
    """The head of a CSV, as its first lines tell it."""

    encoding: str
    separator: str
    skip_rows: int  # lines before the header
    unit_rows: int  # lines below it without samples
    names: Cells
    units: Cells  # cells of the line of units below the header, if there is one
    rows: tuple[Cells, ...]  # the first ones, all as wide as the header


@dataclass(frozen=True, slots=True)
class _Table:
    """Lines taken apart by one separator."""

    separator: str
    lines: tuple[Cells, ...]
    width: int
    first: int  # the first row of samples
    fit: tuple[bool, float, int]  # how well it all fits together


def csv_head(path: Path) -> CsvHead:
    """Read the head of a CSV.

    Raises LogError (``log_not_csv``) if the first lines are no table, or no line above it has its
    names.
    """
    encoding = _encoding(path)
    lines = list(islice(_lines(path, encoding, _HEAD_BYTES), _MOST_LINES))
    table = max((_table(lines, separator) for separator in _SEPARATORS), key=lambda one: one.fit)
    if table.width < 2:
        if any(len(_cells(line, mark)) > 2 for line in lines for mark in _SEPARATORS):
            raise LogError("log_empty", path, "there are names of columns and no row of samples")
        raise LogError("log_not_csv", path, "the first lines are no table of two columns or more")
    header, units = _header(table)
    if header is None:
        raise LogError("log_not_csv", path, "no line above the first rows has names of the columns")
    names = table.lines[header]
    below = table.lines[header + 1 : table.first]
    rows = [row for row in table.lines[table.first :] if len(row) == table.width and row != names]
    return CsvHead(
        encoding=encoding,
        separator=table.separator,
        skip_rows=header,
        unit_rows=sum(any(row) for row in below),
        names=names,
        units=units,
        rows=tuple(rows),
    )


def csv_rows(path: Path, head: CsvHead, most_bytes: int) -> Iterator[Cells]:
    """Rows below the header, those as wide as it is, up to so many bytes of text."""
    lines = _lines(path, head.encoding, 2**20, most_bytes)
    for line in islice(lines, head.skip_rows + 1 + head.unit_rows, None):
        row = _cells(line, head.separator)
        if len(row) == len(head.names) and row != head.names and not row[0].startswith("#"):
            yield row


def csv_last_rows(path: Path, head: CsvHead) -> list[Cells]:
    """Some rows of the end of a CSV, where that can be had without reading it all."""
    if head.encoding != "utf-8" or path.stat().st_size < 2 * _HEAD_BYTES:
        return []
    with path.open("rb") as file:
        file.seek(-_HEAD_BYTES, 2)
        lines = file.read().decode(errors="replace").splitlines()[1:]
    rows = [_cells(line, head.separator) for line in lines]
    return [row for row in rows if len(row) == len(head.names)]


def _encoding(path: Path) -> str:
    head = next(unpacked(path, _HEAD_BYTES), b"")
    for bom, name in _BOMS:
        if head.startswith(bom):
            return name
    # Text has no NUL: in UTF-16 every other byte of plain letters is one.
    if 5 * head.count(0) > 2 * len(head):
        return "utf-16-be" if head[:1] == b"\0" else "utf-16-le"
    for name in _ENCODINGS:
        try:
            codecs.getincrementaldecoder(name)().decode(head)
        except UnicodeDecodeError:
            continue
        return name
    return "latin-1"


def _lines(path: Path, encoding: str, piece: int, most_bytes: int = 1) -> Iterator[str]:
    """Whole lines of at least so many bytes."""
    done = 0
    for lines in read_lines(path, encoding, piece):
        yield from (line.decode() for line in lines.data.splitlines())
        done += len(lines.data)
        if done >= most_bytes:
            return


def _cells(line: str, separator: str) -> Cells:
    """Cells of a line, as the reader of the header takes them."""
    try:
        row = next(csv.reader([line.removeprefix("\ufeff")], delimiter=separator), [])
    except csv.Error:
        return ()
    return tuple(cell.strip() for cell in row)


def _holds_sample(cell: str) -> bool:
    return is_number(cell) or is_stamp(cell) or is_date(cell) or is_clock(cell)


def _table(lines: Sequence[str], separator: str) -> _Table:
    rows = tuple(_cells(line, separator) for line in lines)
    widths = Counter(len(row) for row in rows if len(row) > 1)
    # The rows of samples are the last ones, whatever stands before them.
    tail = Counter(len(row) for row in rows[len(rows) // 2 :] if len(row) > 1)
    if not widths:
        return _Table(separator, rows, 1, 0, (False, 0.0, 0))
    width = max(tail or widths, key=lambda one: (tail[one], widths[one], one))
    wide = [row for row in rows if len(row) == width and any(map(_holds_sample, row))]
    # A column is one of samples where most of its cells are, those in the header left aside.
    shares = [
        sum(map(_holds_sample, cells)) / max(sum(not is_missing(c) for c in cells), 1)
        for cells in zip(*wide[len(wide) // 3 :], strict=True)
    ]
    sampled = [i for i, share in enumerate(shares) if share > 0.5]
    if not sampled:
        return _Table(separator, rows, 1, 0, (False, 0.0, 0))
    first = next(
        (i for i, row in enumerate(rows) if len(row) == width and _holds_sample(row[sampled[0]])), 0
    )
    named = first > 0 and len(rows[first - 1]) == width
    below = len([row for row in rows[first:] if row])
    regular = sum(len(row) == width for row in rows[first:]) / max(below, 1)
    return _Table(separator, rows, width, first, (named, sum(shares) / width * regular, width))


def _header(table: _Table) -> tuple[int | None, Cells]:
    """The line that has the names, and the cells of a line of units below it."""
    block: list[int] = []
    for at in range(table.first - 1, -1, -1):
        line = table.lines[at]
        # Marks of a dataset, such as "#ROWS", may stand between.
        if len(line) != table.width and any(line) and not line[0].startswith("#"):
            break
        if len(table.lines[at]) == table.width:
            block.insert(0, at)
    # Annotations, such as "#datatype", are no names where others are there.
    block = [at for at in block if not table.lines[at][0].startswith("#")] or block
    if not block:
        return None, ()
    with_time = [at for at in block if any(map(is_time_name, table.lines[at]))]
    distinct = {at: len(set(table.lines[at]) - {""}) for at in block}
    header = with_time[0] if with_time else max(block, key=lambda at: (distinct[at], -at))
    below = [table.lines[at] for at in block if at > header]
    # The same in all cells are types of numbers, such as "F".
    units = [cells for cells in below if len(set(cells[1:]) - {""}) > 1 or len(cells) == 2]
    return header, max(units, key=_count_of_units, default=())


def _count_of_units(cells: Cells) -> int:
    return sum(any(unit_of(channel, cell) for channel in CHANNELS) for cell in cells if cell)

"""Headers of a CSV: the first one, and those that come again where a logger started anew."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.config.logs import Logs
from pipeline.errors import LogError

_HEAD = 2**20

MOST_CELLS = 2**14
"""Cells of a header, as many as a spreadsheet has columns; the parser takes 2 kB for each."""

MOST_HEADERS = 2**16
"""Headers in a file: a logger that starts anew every second of a night writes fewer."""


@dataclass(frozen=True, slots=True)
class HeadedRows:
    """Rows below one header."""

    body: memoryview  # their text
    width: int  # cells of the header
    position: Mapping[str, int]  # column of each wanted name, from 0
    line: int  # number of the header's line; 0 where it is not counted


class Header:
    """The header that holds at a place of a file; each must have all wanted columns."""

    def __init__(self, path: Path, logs: Logs, wanted: Sequence[str]) -> None:
        self.path = path
        self.logs = logs
        self.wanted = wanted
        self.names: tuple[str, ...] = ()
        self.position: Mapping[str, int] = {}
        self.line = 0
        self.repeated = 0
        self.unit_rows_left = 0

    def require(self, *, torn: int) -> None:
        """Refuse a file that has ended without a header, `torn` bytes behind its last line end."""
        if self.names:
            return
        if torn > _HEAD:
            raise LogError("log_not_csv", self.path, f"no line end in {torn} bytes")
        if torn:
            raise LogError("log_truncated", self.path, "the header has no line end")
        raise LogError(
            "log_empty", self.path, f"no header after {self.logs.skip_rows} skipped lines"
        )

    def take_first(self, data: bytes) -> int:
        """Read the first header; returns where the rows begin."""
        lines = data[:_HEAD].splitlines(keepends=True)
        at = self.logs.skip_rows
        while at < len(lines) and not lines[at].strip():
            at += 1
        if at >= len(lines):
            self.require(torn=0)
        if not lines[at].endswith((b"\n", b"\r")):
            raise LogError(
                "log_not_csv", self.path, f"the header is longer than {_HEAD} bytes", f"line {at}"
            )
        self.line = at + 1
        self._take(self.cells(lines[at]))
        return sum(map(len, lines[: at + 1]))

    def cells(self, line: bytes) -> tuple[str, ...]:
        """Cells of a line, without blanks around them."""
        text = line.decode().strip("\r\n").removeprefix("\ufeff")
        try:
            row = next(csv.reader([text], delimiter=self.logs.separator), [])
        except csv.Error as error:
            raise LogError(
                "log_not_csv", self.path, f"the header cannot be read: {error}"
            ) from error
        if len(row) > MOST_CELLS:
            raise LogError(
                "log_not_csv",
                self.path,
                f"the header has {len(row)} cells, read are at most {MOST_CELLS}: check separator "
                "and skip_rows",
            )
        return tuple(cell.strip() for cell in row)

    def take_again(self, names: tuple[str, ...]) -> None:
        """A header that is met again: its columns may be others, or stand in another order."""
        self.repeated += 1
        if self.repeated > MOST_HEADERS:
            raise LogError(
                "log_not_csv", self.path, f"its header stands there more than {MOST_HEADERS} times"
            )
        self.line = 0
        self._take(names)

    def _take(self, names: tuple[str, ...]) -> None:
        self.unit_rows_left = self.logs.unit_rows
        if names != self.names:
            self.resume(names)

    def resume(self, names: tuple[str, ...]) -> None:
        """Go on below a header of these names."""
        self.position = _positions(self.path, self.logs, names, self.wanted)
        self.names = names

    def is_again(self, line: bytes) -> tuple[str, ...] | None:
        """Names of a line that is a header; None: it is none."""
        try:
            names = self.cells(line)
        except LogError:
            return None
        return names if set(self.wanted) <= set(names) else None


def rows_begin(header: Header, data: bytes) -> int:
    """Begin of the rows of a piece of whole lines, below the file's header and lines of units.

    The header is as the piece before has left it, and is moved on.
    """
    start = 0 if header.names else header.take_first(data)
    return _below_units(header, data, start, len(data))


def headed_rows(header: Header, data: bytes, start: int) -> Iterator[HeadedRows]:
    """Rows of a piece from `start` on, each with the header that holds for them."""
    parts: list[memoryview] = []
    for begin, end in [*_headers_again(header, data, start), (len(data), len(data))]:
        start = _below_units(header, data, start, begin)
        parts.append(memoryview(data)[start:begin])
        names = header.is_again(data[begin:end]) if end > begin else None
        if names != header.names:
            yield from _headed(header, parts)
            parts = []
        if names is not None:
            header.take_again(names)
        start = end


def _headed(header: Header, parts: list[memoryview]) -> Iterator[HeadedRows]:
    filled = [part for part in parts if len(part)]
    if filled:
        body = filled[0] if len(filled) == 1 else memoryview(b"".join(filled))
        yield HeadedRows(body, len(header.names), header.position, header.line)


def _below_units(header: Header, data: bytes, start: int, end: int) -> int:
    """Begin of the rows below the lines of units that are still to come."""
    while header.unit_rows_left and start < end:
        stop = _end_of_line(data, start, end)
        header.unit_rows_left -= bool(data[start:stop].strip())
        start = stop
    return start


def _end_of_line(data: bytes, start: int, end: int) -> int:
    newline = data.find(b"\n", start, end)
    limit = end if newline < 0 else newline + 1
    carriage_return = data.find(b"\r", start, limit)
    return limit if carriage_return < 0 else carriage_return + 1


def _headers_again(header: Header, data: bytes, start: int) -> Iterator[tuple[int, int]]:
    """Begin and end of the lines that are headers."""
    sample = data[start : start + 2**16]
    # The wanted name that the rows themselves hold least often, such as no letter of a month.
    names = [name.encode() for name in header.wanted]
    needle = min(names, key=lambda name: (sample.count(name), -len(name)))
    at = data.find(needle, start)
    while at >= 0:
        newline = max(data.rfind(b"\n", start, at), start - 1)
        begin = max(data.rfind(b"\r", newline + 1, at), newline) + 1
        end = _end_of_line(data, at, len(data))
        if header.is_again(data[begin:end]) is not None:
            yield begin, end
        at = data.find(needle, end)


def _positions(
    path: Path, logs: Logs, names: Sequence[str], wanted: Sequence[str]
) -> dict[str, int]:
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
                f"no column {name!r}; separated by {logs.separator!r} there are {there}{hint}",
            )
    return {name: names.index(name) for name in wanted}

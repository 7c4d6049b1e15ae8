"""Suggestion of the TOML that reads a log, to paste into a motor's file.

A guess from the first lines, rows or messages; the reader judges it in the end. What cannot be told
is a comment beside what was assumed, or a question.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from glob import escape
from pathlib import Path

from pipeline.config.motors import MISSING_TOKENS
from pipeline.errors import LogError
from pipeline.ingest.contract import readable
from pipeline.setup.guess_cells import Marks, as_number, marks_of, strange_tokens
from pipeline.setup.guess_channels import likely_units
from pipeline.setup.guess_csv import CsvHead, csv_head, csv_last_rows, csv_rows
from pipeline.setup.guess_files import suffix_of
from pipeline.setup.guess_layout import (
    GuessedColumn,
    GuessedSource,
    TableLayout,
    Times,
    find_layout,
    find_times,
    kind_of,
)
from pipeline.setup.guess_mcap import McapGuess, guess_mcap
from pipeline.setup.guess_parquet import parquet_columns, parquet_scan
from pipeline.units import CHANNELS, canonical_unit

_SCANNED_BYTES = 2**23
_MOST_UNUSED = 40
_MOST_LIKELY = 3
_SAMPLES_SHOWN = 3
_NEEDED = ("oil_temperature", "speed", "leakage_flow")


def suggest(path: Path) -> str:
    """TOML of ``[logs]`` and ``[channels]`` for a log file: tables to paste.

    Whatever is a guess or missing has a comment. Of a log of a file a channel, the other channels
    lie beside this one.

    Raises
    ------
    LogError
        The file cannot be read, or its lines are no table.
    """
    with readable(path):
        with path.open("rb") as file:
            magic = file.read(8)
        if magic.startswith(b"PAR1"):
            lines = _parquet_lines(path)
        elif magic.startswith(b"\x89MCAP"):
            lines = _mcap_lines(path, guess_mcap(path))
        else:
            lines = _csv_lines(path, csv_head(path))
        return "\n".join(lines) + "\n"


def _csv_lines(path: Path, head: CsvHead) -> Iterator[str]:
    columns = _csv_columns(head)
    cells = [one.cells for one in columns if one.kind == "number"]
    marks = marks_of(cell for own in cells for cell in own)
    at = {name: i for i, name in enumerate(head.names)}
    encodings = [head.encoding]

    def read(other: Path) -> list[GuessedColumn]:
        neighbour = csv_head(other)
        encodings.append(neighbour.encoding)
        return _csv_columns(neighbour)

    def picked(rows: Iterable[Sequence[str]], names: Sequence[str]) -> Iterator[tuple[str, ...]]:
        return (tuple(row[at[name]] for name in names) for row in rows)

    times = find_times(columns, marks, path, lambda names: picked(csv_last_rows(path, head), names))
    layout = find_layout(
        columns,
        times,
        path,
        scan=lambda names: picked(csv_rows(path, head, _SCANNED_BYTES), names),
        read=read,
    )
    # Numbers of the channels that the first lines do not hold.
    cells += [one.samples for one in layout.sources]
    marks = marks_of(cell for own in cells for cell in own)
    if marks.decimal == head.separator:
        raise LogError(
            "log_not_csv",
            path,
            "a comma is the decimal mark and separates the cells, too: such a log is not read, "
            "have it written with another separator",
        )
    yield from _head_lines(path, "csv", layout.files)
    yield from _time_lines(times)
    yield from _layout_lines(layout)
    # UTF-8 may be no more than text without any other letter.
    encoding = next((name for name in encodings if name != "utf-8"), "utf-8")
    yield from _dialect_lines(replace(head, encoding=encoding), marks, cells)
    yield from _channel_lines(layout.sources, marks)
    yield from _unused_lines("columns", layout.unused)


def _csv_columns(head: CsvHead) -> list[GuessedColumn]:
    units = head.units or ("",) * len(head.names)
    cells = list(zip(*head.rows, strict=True)) or [()] * len(head.names)
    return [
        GuessedColumn(name, unit, kind_of(own), own)
        for name, unit, own in zip(head.names, units, cells, strict=True)
        if name and head.names.count(name) == 1
    ]


def _parquet_lines(path: Path) -> Iterator[str]:
    columns = parquet_columns(path)
    times = find_times(columns, Marks(), path, lambda _: ())
    layout = find_layout(
        columns,
        times,
        path,
        scan=lambda names: parquet_scan(path, names),
        read=parquet_columns,
    )
    yield from _head_lines(path, "parquet", layout.files)
    yield from _time_lines(times)
    yield from _layout_lines(layout)
    yield from _channel_lines(layout.sources, Marks())
    yield from _unused_lines("columns", layout.unused)


def _mcap_lines(path: Path, guess: McapGuess) -> Iterator[str]:
    yield from (f"# {_comment(line)}" for line in guess.listing)
    yield from _head_lines(path, "mcap", ())
    yield f"time = {_quoted(guess.time)}{_remark(guess.remark)}"
    if guess.stamp:
        yield f"stamp = {_quoted(guess.stamp)}"
        if guess.stamp_format:
            yield from _time_lines(Times("", "", guess.stamp_format))
    yield from _channel_lines(guess.sources, Marks())
    yield from _unused_lines("fields", guess.unused)


def _head_lines(path: Path, log_format: str, patterns: Sequence[str]) -> Iterator[str]:
    folder = escape(path.resolve().parent.name)
    files = [f"{folder}/{name}" for name in patterns or [f"*{escape(suffix_of(path))}"]]
    yield "[logs]"
    yield f'format = "{log_format}"'
    yield f"files = [{', '.join(map(_quoted, files))}]  # below the folder of the logs"


def _time_lines(times: Times) -> Iterator[str]:
    guess = times.guess
    if times.time:
        yield f"time = {_quoted(times.time)}"
    if times.date:
        yield f"date_column = {_quoted(times.date)}"
    if not guess.formats:
        yield 'time_format = "iso8601"  # not recognised: which is it?'
    elif not times.is_typed:
        yield f"time_format = {_quoted(guess.formats[0])}{_remark(_other_readings(times))}"
    if not guess.has_zone:
        yield 'time_zone = "UTC"  # the stamps name no zone: which is it?'


def _other_readings(times: Times) -> str:
    """Other meanings of stamps of which day and month cannot be told apart."""
    formats, readings = times.guess.formats, times.guess.readings
    if len(formats) < 2:
        return ""
    others = ", ".join(
        f"{reading} with {_quoted(form)}"
        for form, reading in zip(formats[1:], readings[1:], strict=True)
    )
    return f"day or month first? The log begins on {readings[0]} so, on {others}"


def _layout_lines(layout: TableLayout) -> Iterator[str]:
    if layout.kind != "wide":
        yield f'layout = "{layout.kind}"'
    if layout.channel_column:
        yield f"channel_column = {_quoted(layout.channel_column)}"
    if layout.value_column:
        yield f"value_column = {_quoted(layout.value_column)}"


def _dialect_lines(head: CsvHead, marks: Marks, numbers: Iterable[Sequence[str]]) -> Iterator[str]:
    remark = ""
    if not marks.is_certain:
        other = "," if marks.decimal == "." else "."
        remark = f'or is it between thousands: decimal = "{other}", thousands = "{marks.decimal}"?'
    if head.separator != ",":
        yield f"separator = {_quoted(head.separator)}"
    if marks.decimal != "." or remark:
        yield f"decimal = {_quoted(marks.decimal)}{_remark(remark)}"
    if marks.thousands:
        yield f"thousands = {_quoted(marks.thousands)}"
    if head.encoding != "utf-8":
        yield f"encoding = {_quoted(head.encoding)}"
    if head.skip_rows:
        yield f"skip_rows = {head.skip_rows}"
    if head.unit_rows:
        yield f"unit_rows = {head.unit_rows}"
    tokens = dict.fromkeys(token for cells in numbers for token in strange_tokens(cells))
    if tokens:
        written = ", ".join(map(_quoted, (*MISSING_TOKENS, *tokens)))
        yield f"missing_tokens = [{written}]"


def _channel_lines(sources: Sequence[GuessedSource], marks: Marks) -> Iterator[str]:
    for one in sources:
        yield ""
        yield f"[channels.{one.channel}]"
        yield f"source = {_quoted(one.source)}" + ("" if one.field else _shown(one.samples))
        if one.field and one.field != "value":
            yield f"field = {_quoted(one.field)}{_shown(one.samples)}"
        yield _unit_line(one, marks)
    found = {one.channel for one in sources}
    missing = set(_NEEDED) - found
    if "low_port_pressure" in found:
        missing |= {"high_port_pressure"} - found
    elif "high_port_pressure" in found:
        missing.add("low_port_pressure")
    elif "pressure_difference" not in found:
        missing.add("pressure_difference")
    if missing:
        yield ""
        names = ", ".join(name for name in CHANNELS if name in missing)
        yield f"# not found, give source and unit: {names}"


def _unit_line(source: GuessedSource, marks: Marks) -> str:
    if source.unit:
        return f'unit = "{source.unit}"'
    numbers = [as_number(cell, marks) for cell in source.samples]
    likely = likely_units(source.channel, [number for number in numbers if number is not None])
    assumed = likely[0] if likely else canonical_unit(source.channel)
    by = f" (by its size {' or '.join(likely)})" if 0 < len(likely) <= _MOST_LIKELY else ""
    return f'unit = "{assumed}"{_remark(f"the log does not say it{by}: which is it?")}'


def _unused_lines(what: str, unused: Mapping[str, Sequence[str]]) -> Iterator[str]:
    if unused:
        yield ""
        yield f"# {what} not used:"
    for name in list(unused)[:_MOST_UNUSED]:
        yield f"#   {_comment(_quoted(name))}{_shown(unused[name]).replace('#', '').rstrip()}"


def _shown(samples: Sequence[str]) -> str:
    return _remark("; ".join(sample[:20] for sample in samples[:_SAMPLES_SHOWN]))


def _remark(text: str) -> str:
    return f"  # {_comment(text)}" if text else ""


def _comment(text: str) -> str:
    """Text that a comment may hold."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _quoted(text: str) -> str:
    """Text as a TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'

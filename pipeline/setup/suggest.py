"""Suggestion of the TOML that reads a log, to paste into a motor's file.

A guess from the first lines, rows or messages; the reader judges it in the end. What cannot be told
is a comment beside what was assumed, or a question.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path

from pipeline.config.logs import MISSING_TOKENS
from pipeline.errors import LogError
from pipeline.ingest.contract import readable
from pipeline.setup.guess_cells import Marks, as_number, marks_of, strange_tokens
from pipeline.setup.guess_channels import likely_units, missing_channels
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
from pipeline.setup.guess_mcap import guess_mcap
from pipeline.setup.guess_parquet import parquet_columns, parquet_scan
from pipeline.units import CHANNELS, canonical_unit

_SCANNED_BYTES = 2**23
_MOST_UNUSED = 40
_MOST_LIKELY = 3
_SAMPLES_SHOWN = 3


@dataclass(frozen=True, slots=True)
class LogGuess:
    """A log as its first lines tell it.

    `logs` are the lines of ``[logs]``, besides those of `files`; a comment there is a question.
    """

    format: str
    files: tuple[str, ...]  # patterns of the names of files that are alike
    logs: tuple[str, ...]
    layout: TableLayout
    marks: Marks
    listing: tuple[str, ...] = ()  # of an MCAP: topics and fields


def look(path: Path) -> LogGuess:
    """Tell the dialect, layout and channels of a log.

    Raises LogError if the file cannot be read, or its lines are no table.
    """
    with readable(path):
        with path.open("rb") as file:
            magic = file.read(8)
        if magic.startswith(b"PAR1"):
            return _parquet_guess(path)
        if magic.startswith(b"\x89MCAP"):
            return _mcap_guess(path)
        return _csv_guess(path, csv_head(path))


def suggest(path: Path) -> str:
    """TOML of ``[logs]`` and ``[channels]`` for a log file: tables to paste.

    Whatever is a guess or missing has a comment. Of a log of a file a channel, the other channels
    lie beside this one.

    Raises LogError as `look` does.
    """
    return "\n".join(_lines(path, look(path))) + "\n"


def _lines(path: Path, found: LogGuess) -> Iterator[str]:
    yield from (f"# {_comment(line)}" for line in found.listing)
    folder = escape(path.resolve().parent.name)
    files = [f"{folder}/{name}" for name in found.files]
    yield "[logs]"
    yield f'format = "{found.format}"'
    yield f"files = [{', '.join(map(quoted, files))}]  # below the folder of the logs"
    yield from found.logs
    for column, motors in found.layout.motors.items():
        names = ", ".join(map(quoted, motors))
        yield f"# rows of several motors: motor_column = {quoted(column)}, motor_name: {names}"
    yield from _channel_lines(found.layout.sources, found.marks)
    yield from _unused_lines("fields" if found.listing else "columns", found.layout.unused)


def _csv_guess(path: Path, head: CsvHead) -> LogGuess:
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
    # UTF-8 may be no more than text without any other letter.
    encoding = next((name for name in encodings if name != "utf-8"), "utf-8")
    dialect = _dialect_lines(replace(head, encoding=encoding), marks, cells)
    logs = (*_time_lines(times), *_layout_lines(layout), *dialect)
    return LogGuess("csv", _files(path, layout), logs, layout, marks)


def _files(path: Path, layout: TableLayout) -> tuple[str, ...]:
    return layout.files or (f"*{escape(suffix_of(path))}",)


def _csv_columns(head: CsvHead) -> list[GuessedColumn]:
    units = head.units or ("",) * len(head.names)
    cells = list(zip(*head.rows, strict=True)) or [()] * len(head.names)
    return [
        GuessedColumn(name, unit, kind_of(own), own)
        for name, unit, own in zip(head.names, units, cells, strict=True)
        if name and head.names.count(name) == 1
    ]


def _parquet_guess(path: Path) -> LogGuess:
    columns = parquet_columns(path)
    times = find_times(columns, Marks(), path, lambda _: ())
    layout = find_layout(
        columns,
        times,
        path,
        scan=lambda names: parquet_scan(path, names),
        read=parquet_columns,
    )
    logs = (*_time_lines(times), *_layout_lines(layout))
    return LogGuess("parquet", _files(path, layout), logs, layout, Marks())


def _mcap_guess(path: Path) -> LogGuess:
    guess = guess_mcap(path)
    logs = [f"time = {quoted(guess.time)}{_remark(guess.remark)}"]
    if guess.stamp:
        logs.append(f"stamp = {quoted(guess.stamp)}")
        if guess.stamp_format:
            logs += _time_lines(Times("", "", guess.stamp_format))
    layout = TableLayout("wide", guess.sources, guess.unused, fields=guess.motors)
    return LogGuess("mcap", _files(path, layout), tuple(logs), layout, Marks(), guess.listing)


def _time_lines(times: Times) -> Iterator[str]:
    guess = times.guess
    if times.time:
        yield f"time = {quoted(times.time)}"
    if times.date:
        yield f"date_column = {quoted(times.date)}"
    if not guess.formats:
        yield 'time_format = "iso8601"  # not recognised: which is it?'
    elif not times.is_typed:
        yield f"time_format = {quoted(guess.formats[0])}{_remark(_other_readings(times))}"
    if not guess.has_zone:
        yield 'time_zone = "UTC"  # the stamps name no zone: which is it?'


def _other_readings(times: Times) -> str:
    """Other meanings of stamps of which day and month cannot be told apart."""
    formats, readings = times.guess.formats, times.guess.readings
    if len(formats) < 2:
        return ""
    others = ", ".join(
        f"{reading} with {quoted(form)}"
        for form, reading in zip(formats[1:], readings[1:], strict=True)
    )
    return f"day or month first? The log begins on {readings[0]} so, on {others}"


def _layout_lines(layout: TableLayout) -> Iterator[str]:
    if layout.kind != "wide":
        yield f'layout = "{layout.kind}"'
    if layout.channel_column:
        yield f"channel_column = {quoted(layout.channel_column)}"
    if layout.value_column:
        yield f"value_column = {quoted(layout.value_column)}"


def _dialect_lines(head: CsvHead, marks: Marks, numbers: Iterable[Sequence[str]]) -> Iterator[str]:
    remark = ""
    if not marks.is_certain:
        other = "," if marks.decimal == "." else "."
        remark = f'or is it between thousands: decimal = "{other}", thousands = "{marks.decimal}"?'
    if head.separator != ",":
        yield f"separator = {quoted(head.separator)}"
    if marks.decimal != "." or remark:
        yield f"decimal = {quoted(marks.decimal)}{_remark(remark)}"
    if marks.thousands:
        yield f"thousands = {quoted(marks.thousands)}"
    if head.encoding != "utf-8":
        yield f"encoding = {quoted(head.encoding)}"
    if head.skip_rows:
        yield f"skip_rows = {head.skip_rows}"
    if head.unit_rows:
        yield f"unit_rows = {head.unit_rows}"
    tokens = dict.fromkeys(token for cells in numbers for token in strange_tokens(cells))
    if tokens:
        written = ", ".join(map(quoted, (*MISSING_TOKENS, *tokens)))
        yield f"missing_tokens = [{written}]"


def _channel_lines(sources: Sequence[GuessedSource], marks: Marks) -> Iterator[str]:
    for one in sources:
        yield ""
        yield f"[channels.{one.channel}]"
        yield f"source = {quoted(one.source)}" + ("" if one.field else _shown(one.samples))
        if one.named_field:
            yield f"field = {quoted(one.named_field)}{_shown(one.samples)}"
        if one.value_column:
            yield f"value_column = {quoted(one.value_column)}"
        yield _unit_line(one, marks)
    missing = missing_channels({one.channel for one in sources})
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
        yield f"#   {_comment(quoted(name))}{_shown(unused[name]).replace('#', '').rstrip()}"


def _shown(samples: Sequence[str]) -> str:
    return _remark("; ".join(sample[:20] for sample in samples[:_SAMPLES_SHOWN]))


def _remark(text: str) -> str:
    return f"  # {_comment(text)}" if text else ""


def _comment(text: str) -> str:
    """Text that a comment may hold."""
    return "".join(c if c.isprintable() else "?" for c in text)


def quoted(text: str) -> str:
    """Text as a TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'

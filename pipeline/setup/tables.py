"""What every log is to the setup: columns with their first cells, and what the log does not say.

Cells are text: numbers and the marks in them, time stamps and their formats.
"""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.clock import latest_us, microseconds, utc
from pipeline.config.logs import EPOCH_UNITS, EXCEL_DAYS, MISSING_TOKENS, THOUSANDS
from pipeline.errors import LogError
from pipeline.ingest.time_stamps import EARLIEST_US, parse_numbers, parse_written
from pipeline.setup.names import is_in, words_of

SAMPLES = 50  # cells of a column that are kept, and by which it is judged
HEAD_ROWS = 400
TIMES = ("stamp", "date", "clock", "typed")

_DATES = (
    *("%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%Y %m %d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y"),
    *("%d-%m-%Y", "%m-%d-%Y", "%d %m %Y", "%d.%m.%y", "%d/%m/%y", "%m/%d/%y", "%d-%m-%y"),
    *("%m-%d-%y", "%y-%m-%d", "%y/%m/%d", "%d-%b-%Y", "%d %b %Y", "%d-%b-%y", "%d %B %Y"),
    *("%d-%B-%Y", "%d.%b.%Y", "%d/%b/%Y", "%Y%m%d"),
)
_CLOCKS = (
    *("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M", "%H.%M.%S", "%H.%M.%S,%f", "%H%M%S"),
    "%H:%M:%S:%f",
    *("%I:%M:%S %p", "%I:%M %p", "%I:%M:%S%p", "%I:%M:%S.%f %p"),
)
_ZONE = r"(?P<zone> ?(?:Z|[+-]\d\d:?\d\d|UTC|GMT))?"
_MONTH = r"(?:\d{1,2}|[A-Za-z]{3,9})"
_DATE = rf"\d{{4}}[-/. ]{_MONTH}[-/. ]\d{{1,2}}|\d{{1,2}}[-/. ]{_MONTH}[-/. ](?:\d{{4}}|\d\d)"
_CLOCK = r"\d{1,2}[:.]\d\d(?:[:.]\d\d(?:[.,:]\d+)?)?(?: ?[AaPp][Mm])?"
_STAMP = re.compile(
    rf"(?P<date>{_DATE}|\d{{8}})(?P<between>[ T_]|, |,| - )(?P<clock>{_CLOCK}|\d{{6}}){_ZONE}"
)
_ONLY_DATE, _ONLY_CLOCK = re.compile(_DATE), re.compile(rf"(?=.*:){_CLOCK}{_ZONE}")
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d{1,9})?)?(Z|[+-]\d\d:?\d\d)?")
_EARLIEST_COUNT_US = microseconds(dt.datetime(2001, 1, 1, tzinfo=dt.UTC))
_MONTH_S = 20 * 86400.0
_HALF_OF_DAY = re.compile(r"(?i)[ap]\.?\s?m\.?")
_ZONE_IN_NAME = re.compile(
    r"(?i)(?<![^\W_])(?:utc|gmt)(?: ?([+-]) ?(\d\d?)(?::?00)?)?(?! ?[+-] ?\d|[^\W_]|:)"
)
_WHICH_TIME = (
    "its columns of times differ: which is that of all readings? Where a channel has a time of its "
    'own, have a row a reading written (layout = "long"), or a file a channel'
)

Cells = tuple[str, ...]
Rows = Iterator[Cells]


@dataclass(frozen=True, slots=True)
class Quality:
    """A column or field that says of what quality readings are."""

    source: str  # as a config finds it
    words: Cells  # of its name, those for a quality
    cells: Cells
    good: tuple[str | int, ...] | None  # codes of a good sample; None where they are asked for


@dataclass(frozen=True, slots=True)
class Column:
    """A column, tag or field: its name, how a config finds it, and some of its cells."""

    name: str
    cells: Cells
    kind: str  # as `kind_of` has it; "typed" for times by the file's own type
    unit: str = ""  # what is written beside the name as a unit
    keys: Mapping[str, Any] = field(default_factory=dict)  # of ``[channels.…]``, but for the unit
    quality: Quality | None = None

    @property
    def filled(self) -> Cells:
        """The first cells that hold something."""
        return tuple(cell for cell in self.cells if cell not in MISSING_TOKENS)[:SAMPLES]


@dataclass(frozen=True, slots=True)
class Question:
    """What a log does not say; `key` names it in an answer. Without choices any text will do."""

    key: str
    text: str
    choices: Cells = ()


@dataclass(frozen=True, slots=True)
class Marks:
    """Marks that numbers have; not certain where either could be between thousands."""

    decimal: str = "."
    thousands: str = ""
    is_certain: bool = True


@dataclass(frozen=True, slots=True)
class Table:
    """A log as its first lines, rows or messages tell it."""

    logs: Mapping[str, Any]  # keys of ``[logs]``, but for the files
    questions: tuple[Question, ...]
    columns: tuple[Column, ...]  # but for those of the time
    times: Cells
    marks: Marks = field(default_factory=Marks)
    rows: Callable[[Sequence[str]], Rows] = lambda _: iter(())  # cells of some columns, further on
    faults: Cells = ()  # what of it cannot be read, and why
    left_out: Cells = ()  # columns that cannot be read, and why
    other_times: Cells = ()  # names of columns of times that are not the readings'


# Cells


def _number(decimal: str, thousands: str) -> re.Pattern[str]:
    group = rf"[1-9]\d{{0,2}}(?:{re.escape(thousands)}\d{{3}})+|" if thousands else ""
    mark = re.escape(decimal)
    return re.compile(rf"[+-]?(?:(?:{group}\d+)(?:{mark}\d*)?|{mark}\d+)(?:[eE][+-]?\d+)?")


_NUMBERS = {
    Marks(decimal, thousands): _number(decimal, thousands)
    for thousands in ("", *THOUSANDS)
    for decimal in ".,"
    if decimal != thousands
}
_NOT_FINITE = re.compile(r"(?i)[+-]?(nan|inf|infinity)")


def is_number(cell: str) -> bool:
    """Return True if a cell is a number in some dialect."""
    fits = any(number.fullmatch(cell) for number in _NUMBERS.values())
    return bool(cell) and (fits or bool(_NOT_FINITE.fullmatch(cell)))


def marks_of(cells: Iterable[str]) -> Marks:
    """Return decimal mark and mark between thousands in which the most numbers can be read.

    Examples
    --------
    >>> marks_of(["1.234,5", "7,25"])
    Marks(decimal=',', thousands='.', is_certain=True)
    >>> marks_of(["1.234", "5.678"])
    Marks(decimal='.', thousands='', is_certain=False)
    """
    numbers = [cell for cell in cells if is_number(cell)]
    if not any(re.search(r"\D", cell.lstrip("+-")) for cell in numbers):
        return Marks()
    counts = {
        marks: sum(bool(pattern.fullmatch(cell)) for cell in numbers)
        for marks, pattern in _NUMBERS.items()
    }
    best = [marks for marks, count in counts.items() if count == max(counts.values())]
    first = best[0]
    return Marks(first.decimal, first.thousands, all(m.decimal == first.decimal for m in best))


def as_number(cell: str, marks: Marks) -> float | None:
    """Return a cell's number; None: it is none."""
    plain = cell.replace(marks.thousands, "") if marks.thousands else cell
    try:
        return float(plain.replace(marks.decimal, "."))
    except ValueError:
        return None


def kind_of(cells: Sequence[str]) -> str:
    """Return kind of most cells: stamp, date, clock, number, text or nothing."""
    filled = [cell for cell in cells if cell not in MISSING_TOKENS][:SAMPLES]
    tests = (
        *(("stamp", is_stamp), ("number", is_number)),
        *(("date", _ONLY_DATE.fullmatch), ("clock", _ONLY_CLOCK.fullmatch)),
    )
    for kind, test in tests:
        if 2 * sum(bool(test(cell)) for cell in filled) > len(filled):
            return kind
    return "text" if filled else "nothing"


def is_time_name(name: str) -> bool:
    """Return True if a column's name is that of a time.

    Examples
    --------
    >>> [is_time_name(name) for name in ("Zeit", "t_ms", "Timestamp (UTC)", "T_oil", "total")]
    [True, True, True, False, False]
    """
    words = words_of(name)
    is_count = (
        len(words) < 2 or words[0] not in ("t", "ts") or words[1] in ("ms", "us", "s", "stamp")
    )
    return is_in(words[:1], "column", "time") and is_count


def is_stamp(cell: str) -> bool:
    """Return True if a cell is a whole time stamp, not a count."""
    return bool(_ISO.fullmatch(cell) or _STAMP.fullmatch(cell))


def _shapes(stamp: str) -> list[str]:
    """Return formats that a stamp may have by its marks."""
    match = _STAMP.fullmatch(stamp)
    if match is None:
        return []
    behind = re.sub(r"Z|[+-].*", "%z", match["zone"] or "")
    dates, clocks = (
        [form for form in forms if _marks(form) == _marks(match[part])]
        for part, forms in (("date", _DATES), ("clock", _CLOCKS))
    )
    return [date + match["between"] + clock + behind for date, clock in product(dates, clocks)]


def _marks(text: str) -> str:
    """Return what stands between numbers and words of a stamp or its format."""
    return re.sub(r"%\w|[\w ]", "", text)


def _read(stamps: Sequence[str], form: str) -> list[dt.datetime]:
    """Return stamps as the readers of logs have them, those apart that they cannot read.

    Of two digits of a year, which they take for the whole of it, the year is none of a log.
    """
    times = parse_written([pa.chunked_array([pa.array(stamps, pa.string())])], form)
    is_read = (times.kind != 0) & (times.time_us >= EARLIEST_US)
    return [utc(time_us) for time_us in times.time_us[is_read].tolist()]


@dataclass(frozen=True, slots=True)
class TimeFormats:
    """Formats in which all stamps can be read, as of `logs.time_format`, the likeliest first.

    An empty format is of stamps of a type of their own.
    """

    readings: dict[str, str]  # the first stamp in words, by format
    has_zone: bool = False


def time_formats(stamps: Sequence[str]) -> TimeFormats:
    """Return formats of time stamps in text, in the order of the log, none of them blank.

    Examples
    --------
    >>> list(time_formats(["13.02.2025 06:00:00,5"]).readings)
    ['%d.%m.%Y %H:%M:%S,%f']
    >>> list(time_formats(["03/04/2025 06:00:00"]).readings.values())
    ['3 April 2025', '4 March 2025']
    """
    has_zone = bool(stamps) and all(re.search(rf"\d{_ZONE[:-1]}$", stamp) for stamp in stamps)
    if stamps and all(map(_ISO.fullmatch, stamps)):
        return TimeFormats({"iso8601": ""}, has_zone)
    ends = stamps[:: max(len(stamps) - 1, 1)]
    likely = dict.fromkeys(form for stamp in ends for form in _shapes(stamp))
    forms = (form for form in likely if len(_read(ends, form)) == len(ends))
    read = {form: own for form in forms if len(own := _read(stamps, form)) == len(stamps)}
    least = min(map(_misfit, read.values()), default=0)
    days: dict[dt.datetime, str] = {}
    for form, own in read.items():
        if _misfit(own) == least:
            days.setdefault(own[0], form)
    return TimeFormats({form: f"{day.day} {day:%B %Y}" for day, form in days.items()}, has_zone)


def _misfit(times: Sequence[dt.datetime]) -> int:
    """Return stamps in the future, and steps of months: a log has neither."""
    seconds = [time_us.timestamp() for time_us in times]
    leaps = sum(abs(b - a) > _MONTH_S for a, b in pairwise(seconds))
    return leaps + sum(second > latest_us() / 1e6 for second in seconds)


def count_format(numbers: Sequence[float]) -> str | None:
    """Format of stamps that are counts, by their size; None: no count of a time after 2001."""
    for form in (*EPOCH_UNITS, EXCEL_DAYS) if numbers else ():
        time_us = parse_numbers(np.array(numbers, np.float64), form).time_us
        if time_us.min() > _EARLIEST_COUNT_US and time_us.max() < latest_us():
            return form
    return None


# The time of a table


def find_time(table: Table, path: Path, answer: str = "") -> Table:
    """Return the table with its time found, and without the columns of times.

    `answer` is the column of the time, if several may be. Raises LogError (``log_time``) if no
    column alone says the time.
    """
    halves = [column.name for column in table.columns if _is_half_of_day(column)]
    if halves:
        how = f"column {halves[0]!r} has AM or PM alone: have it written behind the time, in a cell"
        raise LogError("log_time", path, how)
    named = sorted(table.columns, key=lambda col: (_is_arrival(col), not is_time_name(col.name)))
    of_kind = {kind: [column for column in named if column.kind == kind] for kind in TIMES}
    times, formats, questions = named[:1], TimeFormats({}), list(table.questions)
    if whole := of_kind["typed"] or of_kind["stamp"]:
        rivals = [column.name for column in whole if _differ(column, whole[0])]
        if rivals:
            choices = (whole[0].name, *rivals)
            questions.append(Question("time", _WHICH_TIME, choices))
        times = [column for column in whole if column.name == answer] or whole[:1]
    if of_kind["typed"]:
        formats = TimeFormats({"": ""}, bool(times[0].unit))
    elif whole or (of_kind["date"] and of_kind["clock"]):
        times = times if whole else [of_kind["clock"][0], of_kind["date"][0]]
        formats = _formats(table, times[::-1])
    else:
        for column in named:
            counts = [as_number(cell, table.marks) for cell in column.filled]
            is_time = is_time_name(column.name) or column is table.columns[0]
            known = [number for number in counts if number is not None]
            if column.kind == "number" and is_time and (form := count_format(known)):
                times, formats = [column], TimeFormats({form: ""}, form in EPOCH_UNITS)
                break
        else:
            _require_time(table, times, path)
    logs, names = dict(table.logs), [column.name for column in times]
    logs |= dict(zip(("time", "date_column"), names, strict=False))
    example = next((cell for own in times for cell in own.filled), "")
    set_formats(logs, questions, formats, example, zone_in(" ".join(names)))
    left = [column for column in table.columns if column.name not in names]
    return replace(
        table,
        logs=logs,
        questions=tuple(questions),
        columns=tuple(column for column in left if column.kind not in TIMES),
        times=tuple(names),
        other_times=tuple(column.name for column in left if column.kind in TIMES),
    )


def _require_time(table: Table, times: Sequence[Column], path: Path) -> None:
    """Refuse a table without a column that may be of times, however they are written."""
    if not any(column.kind in TIMES or is_time_name(column.name) for column in times):
        shown = ", ".join(column.name for column in table.columns)
        how = f"none of its columns has times such as 2026-01-02T21:30:00Z: {shown}"
        raise LogError("log_time", path, "; ".join((how, *table.left_out)))


def _is_half_of_day(column: Column) -> bool:
    cells = column.filled
    return bool(cells) and all(map(_HALF_OF_DAY.fullmatch, cells))


def _is_arrival(column: Column) -> bool:
    """Return True for the time at which something else than the sensor had a reading."""
    return is_in(words_of(column.name), "column", "arrival")


def _differ(column: Column, time: Column) -> bool:
    """Return True for a column of times that may be that of the readings, as well as another."""
    is_clock = not _is_arrival(column) and len(set(column.cells) - {""}) > 1
    pairs = zip(column.cells, time.cells, strict=True)
    return is_clock and any(cell != other for cell, other in pairs if cell and other)


def _formats(table: Table, columns: Sequence[Column]) -> TimeFormats:
    """Return formats of stamps in a column, or in those of date and time."""
    cells = zip(*(column.cells for column in columns), strict=True)
    stamps = [stamp for row in cells if is_stamp(stamp := " ".join(row))][:SAMPLES]
    formats = time_formats(stamps)
    if len(formats.readings) < 2:
        return formats
    # Some stamps from further on tell day from month.
    later = islice(table.rows([column.name for column in columns]), HEAD_ROWS, 200_000, 1000)
    more = [stamp for row in later if is_stamp(stamp := " ".join(row))]
    return time_formats([*stamps, *more])


def zone_in(name: str) -> str:
    """Return the zone that the name of a column of times states, or an empty text.

    Examples
    --------
    >>> [zone_in(name) for name in ("Time (UTC)", "Date Time, GMT+01:00", "GMT+05:30", "Zeit")]
    ['UTC', 'Etc/GMT-1', '', '']
    """
    stated = _ZONE_IN_NAME.search(name)
    if stated is None or int(stated[2] or 0) > 12:
        return ""
    sign, hours = stated[1], int(stated[2] or 0)
    # Names of POSIX count hours to the west.
    return f"Etc/GMT{'-' if sign == '+' else '+'}{hours}" if hours else "UTC"


def set_formats(
    logs: dict[str, Any],
    questions: list[Question],
    formats: TimeFormats,
    example: str = "",
    zone: str = "",
) -> None:
    """Set keys and questions of the time's format, and of its zone if the log states none."""
    readings = formats.readings
    if not readings:
        text = f"how are its time stamps written ({example!r})? Day, hour and minute are needed"
        if is_number(example):
            text += f"; counts are read as {', '.join((*EPOCH_UNITS, EXCEL_DAYS))}, and no others"
        questions.append(Question("time_format", text))
    elif form := next(iter(readings)):
        logs["time_format"] = form
    if len(readings) > 1:
        days = ", or ".join(f"{reading} by {form}" for form, reading in readings.items())
        questions.append(Question("time_format", f"does it begin on {days}?", tuple(readings)))
    if not formats.has_zone:
        logs["time_zone"] = zone or "UTC"
    if not (formats.has_zone or zone):
        questions.append(Question("time_zone", "the stamps name no zone, such as Europe/Oslo"))

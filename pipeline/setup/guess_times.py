"""Guesses at the format of time stamps, each judged by the reader's own parser."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime

import numpy as np
import pyarrow as pa

from pipeline.clock import latest_us
from pipeline.config.time_formats import EPOCH_UNITS, EXCEL_DAYS
from pipeline.ingest.time_stamps import placed, written_as_numbers, written_as_text
from pipeline.ingest.wall_clock import TimeStamps
from pipeline.logs.told_nights import date_in

_TIME_NAME = re.compile(
    r"(?i)^[\W_]*(date.?time|time.?stamp|time|zeit(stempel)?|uhrzeit|datum|date|tid(sstämpel)?|"
    r"clock|epoch|ts|t)(?![a-zäöå])"
)
_NUMBER = re.compile(r"\d+(\.\d*)?")

_DATE = (
    r"(?P<ymd>\d{4}(?P<s1>[-/. ])\d{1,2}(?P=s1)\d{1,2})"
    r"|(?P<dmy>\d{1,2}(?P<s2>[-/. ])\d{1,2}(?P=s2)\d{4})"
    r"|(?P<short>\d{1,2}(?P<s3>[-/.])\d{1,2}(?P=s3)\d{2})"
    r"|(?P<named>\d{1,2}(?P<s4>[-/. ])(?P<month>[A-Za-z]{3,9})(?P=s4)(?:\d{4}|\d{2}))"
    r"|(?P<packed>\d{8})"
)
_CLOCK = (
    r"\d{1,2}(?P<c>[:.])\d{2}((?P=c)\d{2}(?P<fraction>[.,]\d{1,9})?)?(?P<half> ?[AaPp][Mm])?"
    r"|(?P<bare>\d{6})"
)
_ZONE = r"(?P<gap> ?)(?P<zone>Z|[+-]\d\d:?\d\d|UTC|GMT)"
_STAMP = re.compile(rf"(?:{_DATE})(?P<between>[ T_]|, |,| - )(?:{_CLOCK})(?:{_ZONE})?")
_DATE_ONLY = re.compile(_DATE)
_CLOCK_ONLY = re.compile(rf"(?:{_CLOCK})(?:{_ZONE})?")

_MONTH_US = 20 * 86_400_000_000


@dataclass(frozen=True, slots=True)
class TimeGuess:
    """Formats of time stamps, as in `logs.time_format`.

    There are several where the stamps can be read in several ways, the likeliest first, and none
    where in none; `readings` are what the first stamp is in each, for a person to choose by.
    """

    formats: tuple[str, ...]
    has_zone: bool = False  # the stamps say their zone, or are counted from 1970
    readings: tuple[str, ...] = ()


def is_time_name(name: str) -> bool:
    """True if a column's name is that of a time.

    Examples
    --------
    >>> [is_time_name(name) for name in ("Zeit", "t_ms", "Timestamp (UTC)", "T_oil", "total")]
    [True, True, True, True, False]
    """
    return bool(_TIME_NAME.match(name.strip()))


def is_stamp(cell: str) -> bool:
    """True if a cell is a whole time stamp, not a count."""
    text = cell.strip()
    if _STAMP.fullmatch(text):
        return True
    if ":" not in text and "T" not in text:
        return False
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return not is_clock(text)


def is_date(cell: str) -> bool:
    """True if a cell is a date alone."""
    return bool(_DATE_ONLY.fullmatch(cell.strip())) and not _NUMBER.fullmatch(cell.strip())


def is_clock(cell: str) -> bool:
    """True if a cell is a time of day alone."""
    text = cell.strip()
    return ":" in text and bool(_CLOCK_ONLY.fullmatch(text))


def guess_time(stamps: Sequence[str], decimal: str = ".", file_name: str = "") -> TimeGuess:
    """Formats of time stamps in text, some of a log in its order, none of them blank.

    The decimal mark is for stamps that are counts; a date in the file's name tells day from month.

    Examples
    --------
    >>> guess_time(["13.02.2025 06:00:00,5"]).formats
    ('%d.%m.%Y %H:%M:%S,%f',)
    >>> guess_time(["03/04/2025 06:00:00"]).readings
    ('3 April 2025', '4 March 2025')
    """
    plain = [stamp.strip().replace(decimal, ".") for stamp in stamps]
    if stamps and all(map(_NUMBER.fullmatch, plain)) and not _readable(stamps, _packed(stamps)):
        form = number_format(list(map(float, plain)))
        return TimeGuess((form,) if form else (), form in EPOCH_UNITS)
    formats = _readable(stamps, ["iso8601", *_formats(stamps)])
    if "iso8601" in formats:
        formats = ["iso8601"]
    formats = _likeliest(stamps, formats, file_name)
    has_zone = bool(stamps) and all(re.search(rf"(?:{_ZONE})$", s.strip()) for s in stamps)
    return TimeGuess(tuple(formats), has_zone, _in_words(stamps, formats))


def number_format(numbers: Sequence[float]) -> str | None:
    """Format of stamps that are counts, by their size; None: no count of a time after 2001.

    Examples
    --------
    >>> number_format([1740808800250.0]), number_format([45717.25]), number_format([12.5])
    ('epoch_ms', 'excel_days', None)
    """
    formats = [EXCEL_DAYS, *EPOCH_UNITS]
    latest = latest_us()
    earliest_us = int(datetime(2001, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
    for form in formats:
        stamps = placed(written_as_numbers(np.array(numbers), form), "UTC")
        within = stamps.readable & (stamps.time_us > earliest_us) & (stamps.time_us < latest)
        if len(numbers) and within.all():
            return form
    return None


def _packed(stamps: Sequence[str]) -> list[str]:
    return [form for form in _formats(stamps) if "%Y%m%d" in form]


def _formats(stamps: Iterable[str]) -> list[str]:
    """Formats that stamps have by their shape, those with fractions of a second first."""
    found = [form for stamp in stamps for form in _formats_of(stamp.strip())]
    unique = dict.fromkeys(found)
    return sorted(unique, key=lambda form: "%f" not in form)


def _formats_of(stamp: str) -> Iterator[str]:
    match = _STAMP.fullmatch(stamp)
    if match is None:
        return
    zone = match["zone"]
    behind = ""
    if zone:
        behind = match["gap"] + (zone if zone in ("UTC", "GMT") else "%z")
    dates = _date_formats(match)
    if match["half"]:
        # Where noon is 12 PM the month is mostly written first.
        dates.sort(key=lambda one: not one.startswith("%m"))
    for one in dates:
        yield one + match["between"] + _clock_format(match) + behind


def _date_formats(match: re.Match[str]) -> list[str]:
    if match["ymd"]:
        return ["%Y{0}%m{0}%d".format(match["s1"])]
    if match["dmy"]:
        orders = ["%d{0}%m{0}%Y", "%m{0}%d{0}%Y"]
        # With dots a date is written day first wherever it is written so.
        return [order.format(match["s2"]) for order in orders[: 1 if match["s2"] == "." else 2]]
    if match["short"]:
        orders = ["%d{0}%m{0}%y", "%m{0}%d{0}%y", "%y{0}%m{0}%d"]
        return [order.format(match["s3"]) for order in orders[: 1 if match["s3"] == "." else 3]]
    if match["named"]:
        month = "%b" if len(match["month"]) == 3 else "%B"
        year = "%Y" if re.search(r"\d{4}$", match["named"]) else "%y"
        return ["%d{0}{1}{0}{2}".format(match["s4"], month, year)]
    return ["%Y%m%d"]


def _clock_format(match: re.Match[str]) -> str:
    if match["bare"]:
        return "%H%M%S"
    mark, half = match["c"], match["half"]
    parts = ["%I" if half else "%H", "%M"]
    if match[0].count(mark, match.start("c")) > 1 or match["fraction"]:
        parts.append("%S")
    text = mark.join(parts)
    if match["fraction"]:
        text += f"{match['fraction'][0]}%f"
    return text + (half[:-2] + "%p" if half else "")


def _parsed(stamps: Sequence[str], form: str) -> TimeStamps:
    texts = pa.chunked_array([pa.array([stamp.strip() for stamp in stamps])])
    return placed(written_as_text(texts, form), "UTC")


def _readable(stamps: Sequence[str], formats: Iterable[str]) -> list[str]:
    """Formats in which the reader can read all stamps."""
    return [form for form in formats if stamps and _parsed(stamps, form).readable.all()]


def _likeliest(stamps: Sequence[str], formats: Sequence[str], file_name: str) -> list[str]:
    """Of formats that all fit, those in which the log is as logs are.

    It has no steps of months, nothing in the future, and is of the date that the file is named for.
    """
    kept = list(dict.fromkeys(formats))
    latest = latest_us()
    times = {form: _parsed(stamps, form).time_us for form in kept}
    leaps = {form: int((np.abs(np.diff(t)) > _MONTH_US).sum()) for form, t in times.items()}
    ahead = {form: int((t > latest).sum()) for form, t in times.items()}
    named = date_in(file_name)
    far = {form: named is not None and _days_off(t, named) > 1 for form, t in times.items()}
    for misfit in (ahead, leaps, far):
        fewest = min((misfit[form] for form in kept), default=0)
        kept = [form for form in kept if misfit[form] == fewest]
    if any("%y" in form for form in kept):
        # A year of two digits may stand first, too: a log is of these years sooner than old.
        kept.sort(key=lambda form: -int(times[form][0]))
    # One that differs by more than the order of the date reads the same stamps the same way.
    seen: dict[int, str] = {}
    for form in kept:
        seen.setdefault(int(times[form][0]), form)
    return list(seen.values())


def _days_off(time_us: np.ndarray, day: date) -> int:
    first = datetime.fromtimestamp(int(time_us[0]) / 1e6, UTC)
    return abs((first.date() - day).days)


def _in_words(stamps: Sequence[str], formats: Sequence[str]) -> tuple[str, ...]:
    times = [int(_parsed(stamps[:1], form).time_us[0]) for form in formats]
    moments = [datetime.fromtimestamp(time_us / 1e6, UTC) for time_us in times]
    return tuple(f"{moment.day} {moment:%B %Y}" for moment in moments)

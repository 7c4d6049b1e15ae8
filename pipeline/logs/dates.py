"""Dates in the names of logs: nights of those that cannot be read, stamps that contradict them."""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from pipeline.clock import utc
from pipeline.config.nights import DAY
from pipeline.errors import LogError
from pipeline.logs.files import failed_record, labels_of
from pipeline.logs.processed import FileRecord

# A night known from a file's name alone lies this near to those of the motor's other logs.
FARTHEST_NIGHT = 31 * DAY
# A log may be named by the day before or behind its stamps, in another zone.
NEAR_DAYS = 2
_YEAR_DAYS = 366
_DATE_IN_NAME = re.compile(r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])")
_PARTITION = re.compile(r"[a-z]+=")
_FORMS = (
    r"(?<!\d)(?P<y>20\d\d)(?P<s>[-_./ ]?)(?P<a>\d\d)(?P=s)(?P<b>\d\d)(?!\d\d?[-_./ ])",
    r"(?<!\d)(?P<y>20\d\d)(?P<s>[-_./ ])(?P<a>\d\d?)(?P=s)(?P<b>\d\d?)(?!\d)",
    r"(?<!\d)(?P<b>\d\d?)(?P<s>[-_. ])(?P<a>\d\d?)(?P=s)(?P<y>20\d\d)(?!\d)",
    r"(?<!\d)(?P<b>\d\d)(?P<a>\d\d)(?P<y>20\d\d)(?!\d)",
)
_DATES = tuple(map(re.compile, _FORMS))


def date_in(name: str) -> dt.date | None:
    """Return the last date in a file's name, or None without a date."""
    dates = _DATE_IN_NAME.findall(name)
    with suppress(ValueError):
        return dt.date(*map(int, dates[-1])) if dates else None
    return None


@lru_cache(maxsize=4096)
def dates_in(name: str) -> frozenset[dt.date]:
    """Return the dates that a path may name, where day or month may come first both.

    Examples
    --------
    >>> sorted(map(str, dates_in("W1/year=2026/month=1/day=2/W1.csv")))
    ['2026-01-02']
    >>> sorted(map(str, dates_in("W1_02.01.2026.csv")))
    ['2026-01-02', '2026-02-01']
    """
    plain, dates = _PARTITION.sub("", name), set[dt.date]()
    for at, form in enumerate(_DATES):
        for match in form.finditer(plain):
            year, first, second = (int(match[part]) for part in "yab")
            orders = [(first, second)] if at < 2 else [(first, second), (second, first)]
            for month, day in orders:
                with suppress(ValueError):
                    dates.add(dt.date(year, month, day))
    return frozenset(dates)


def days_off(name: str, first_us: int, last_us: int) -> int | None:
    """Return by how many days stamps lie beside the dates in a name; None: it has none."""
    first, last = utc(first_us).date(), utc(last_us).date()
    off = [max((first - date).days, (date - last).days, 0) for date in dates_in(name)]
    return min(off, default=None)


def dated_otherwise(records: Mapping[str, FileRecord]) -> dict[str, int]:
    """Return the days by which names contradict stamps, by log, but for those of all alike."""
    off = {
        name: days
        for name, record in records.items()
        if record.status == "ok" and record.first_us is not None and record.last_us is not None
        if (days := days_off(name, record.first_us, record.last_us)) is not None
    }
    # Logs that are all named by a day as far from their stamps are named so; not years from them.
    ((usual, n_usual),) = Counter(off.values()).most_common(1) or [(0, 0)]
    usual = usual if n_usual > 1 and usual <= FARTHEST_NIGHT.days else 0
    return {name: days for name, days in off.items() if abs(days - usual) > NEAR_DAYS}


def without_misdated(records: Mapping[str, FileRecord]) -> dict[str, FileRecord]:
    """Refuse logs whose stamps contradict the dates in their names, if most others' agree."""
    odd = dated_otherwise(records)
    n_dated = sum(1 for name, record in records.items() if record.status == "ok" and dates_in(name))
    if 2 * len(odd) >= n_dated:
        odd = {}
    refused = dict(records)
    for name, days in odd.items():
        error = LogError("log_misdated", Path(name), misdated_message(records[name], days))
        bare = replace(records[name], first_us=None, last_us=None, nights=())
        refused[name] = failed_record(bare, error)
    return refused


def misdated_message(record: FileRecord, days: int) -> str:
    """Return in words how a name contradicts its stamps."""
    first = utc(record.first_us or 0)
    why = "are day and month the other way round"
    if days > _YEAR_DAYS:
        why = "is it counted since another year than 1970"
    return (
        f"its first stamp is of {first.day} {first:%B %Y}, {days} days beside the date in its "
        f"name: {why}? Correct logs.time_format, or the log"
    )


def has_no_span(record: FileRecord) -> bool:
    """Return True for a file that cannot be read: its nights, if any, are known from elsewhere."""
    return record.status != "ok" and record.first_us is None


def with_known_nights(
    records: Mapping[str, FileRecord], before: Mapping[str, FileRecord], latest: dt.date
) -> dict[str, FileRecord]:
    """Give each unreadable file the nights that it held before, or that of the date in its name.

    A date means the night that it does in the names of the readable files. A night after the
    latest, or far from those of the motor's other logs, is none.
    """
    if not any(has_no_span(record) and not record.nights for record in records.values()):
        return dict(records)
    readable = [record for record in records.values() if record.status == "ok" and record.nights]
    dated = ((date_in(record.path), min(labels_of(record))) for record in readable)
    lags = Counter(night - date for date, night in dated if date is not None)
    lag = lags.most_common(1)[0][0] if lags else 0 * DAY
    earlier = [record for record in before.values() if record.status == "ok"]
    known = {label for record in (*readable, *earlier) for label in labels_of(record)}

    def dated_by_neighbours(record: FileRecord) -> FileRecord:
        held, named = before.get(record.path), date_in(record.path)
        if held is not None and held.nights:
            nights, how = labels_of(held), "by what it held before"
        else:
            nights, how = {named + lag} if named else set(), "by its name"
        if not nights:
            return record
        first, last = min(known or nights) - FARTHEST_NIGHT, max(known or nights) + FARTHEST_NIGHT
        near = sorted(map(str, (night for night in nights if first <= night <= min(last, latest))))
        message = f"{record.message} (night known {how})"
        return replace(record, nights=tuple(near), message=message) if near else record

    return {
        name: dated_by_neighbours(record) if has_no_span(record) and not record.nights else record
        for name, record in records.items()
    }

"""A motor's log files: finding them, their records, and the samples of a night."""

from __future__ import annotations

import datetime as dt
import re
import stat
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Rows, chosen_rows
from pipeline.clock import microseconds, now, utc
from pipeline.config import MotorSpec
from pipeline.config.nights import DAY, Night, night_of, nights_between, nights_of
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, read_log, time_span
from pipeline.logs.processed import FileRecord, content_hash
from pipeline.messages import counted
from pipeline.workers.process import reading

# Stamps this far from the middle of their log come from a wrong clock; a log that covers more has
# a wrong time format.
LONGEST_LOG_DAYS = 750
DAY_US = 86_400_000_000
# Of a record: what is another where a file is written to or replaced.
OF_CONTENT = ("size", "modified_ns", "inode")


def inspect_log(
    record: FileRecord,
    path: Path,
    before: FileRecord | None,
    spec: MotorSpec,
    latest_us: int | None = None,
) -> FileRecord:
    """Return record of a file: the former if its content is the same, else a new record.

    Samples after `latest_us` are refused [µs since 1970]; None: those a day after now.
    """
    try:
        with reading(record.path, is_asked=True):
            record = replace(record, sha256=content_hash(path))
    except OSError as error:
        return failed_record(record, _not_readable(path, error))
    same = before if before is not None and before.sha256 == record.sha256 else None
    if same is None or same.is_ahead:
        with reading(record.path):
            new = with_span(record, path, spec, latest_us)
        if same is None or (new.status, new.last_us) != (same.status, same.last_us):
            return new
    seen = {name: getattr(record, name) for name in ("modified_ns", "inode", "changed_ns")}
    return replace(same, **seen)


def change_of(record: FileRecord, path: Path) -> LogError | None:
    """Return change of a file since it was looked at; None without any, or if the file is gone."""
    now = stat_log(record.path, path)
    # Not by `changed_ns`: a backup that links the file does nothing to its content.
    is_same = all(getattr(now, name) == getattr(record, name) for name in OF_CONTENT)
    if now.status == "failed" or is_same:
        return None
    is_longer = now.size != record.size
    how = f"it went from {record.size} to {now.size} bytes" if is_longer else "it changed"
    return LogError("log_growing", path, f"{how} while it was read; the next run reads it")


def stat_log(name: str, path: Path) -> FileRecord:
    """Return size and time of a file; ``failed`` where there is no such file any more."""
    try:
        state = path.stat()
    except OSError as error:
        return failed_record(FileRecord(name, 0, 0, None), _not_readable(path, error))
    record = FileRecord(
        name,
        state.st_size,
        state.st_mtime_ns,
        None,
        inode=state.st_ino,
        changed_ns=state.st_ctime_ns,
    )
    if not stat.S_ISREG(state.st_mode):
        # Opening a pipe would block.
        fault = LogError("log_not_readable", path, "this is no file; name files in `logs.files`")
        return failed_record(record, fault)
    return record


def _not_readable(path: Path, error: OSError) -> LogError:
    return LogError("log_not_readable", path, f"{error.strerror}; check that it may be read")


def with_span(
    record: FileRecord, path: Path, spec: MotorSpec, latest_us: int | None = None
) -> FileRecord:
    """Return record of a file with its nights; ``failed`` if they cannot be read."""
    file = spec.file
    try:
        first, last = time_span(path, file.logs, file.channels, latest_us)
        if last < first or last - first > LONGEST_LOG_DAYS * DAY_US:
            # The ends of the file are no measure of it, so all of it is.
            return with_coverage(record, read_log(path, file.logs, file.channels, latest_us), spec)
    except LogError as error:
        if error.code == "log_empty":
            # A log without a row is as good as any; without a byte it is not.
            with suppress(LogError):
                return with_coverage(
                    record, read_log(path, file.logs, file.channels, latest_us), spec
                )
        return failed_record(record, error)
    nights = spec.settings.nights
    labels = nights_between(night_of(first, nights), night_of(last, nights))
    return replace(
        record, first_us=first, last_us=last, nights=tuple(map(dt.date.isoformat, labels))
    )


def failed_record(record: FileRecord, error: LogError) -> FileRecord:
    """Return record of a file that cannot be read, or is being written and left to the next run."""
    status = "growing" if error.code == "log_growing" else "failed"
    return replace(record, status=status, error_code=error.code, message=error.message)


def with_coverage(record: FileRecord, log: RawLog, spec: MotorSpec) -> FileRecord:
    """Return the record of a file that was read: its span, nights, and notes on skipped cells.

    Raises LogError: ``log_empty``: there are rows, and all cells of all channels in them are blank.
    """
    stamps, notes = log.stamps(), list(log.notes)
    notes += [
        f"{counted(part.unparsed, 'cell')} of {name} without a number{part.such_as}"
        for name, part in log.channels.items()
        if part.unparsed
    ]
    notes += _blank_channels(record, log, spec)
    ends = log.ends()
    if ends is None:
        notes.append("no samples")
        return replace(record, rows=log.rows, message="; ".join(notes))
    first, last = ends
    if last - first > LONGEST_LOG_DAYS / 2 * DAY_US:
        every = np.concatenate([channel.time_us for channel in log.channels.values()])
        near = _near_the_others(every, notes)
        stamps, first, last = [near], int(near.min()), int(near.max())
    labels = set().union(*(nights_of(part, spec.settings.nights) for part in stamps))
    return replace(
        record,
        rows=log.rows,
        first_us=first,
        last_us=last,
        nights=tuple(map(dt.date.isoformat, sorted(labels))),
        message="; ".join(notes) or None,
    )


def _near_the_others(stamps: NDArray[np.int64], notes: list[str]) -> NDArray[np.int64]:
    """Return stamps without those that lie over a year from most; a note counts them."""
    # A stamp that there is, not a mean of two: it is never far from itself.
    middle = np.partition(stamps, len(stamps) // 2)[len(stamps) // 2]
    far = np.abs(stamps - middle) > LONGEST_LOG_DAYS / 2 * DAY_US
    if far.any():
        notes.append(
            f"{counted(np.unique(stamps[far]).size, 'time stamp')} over a year from the others, "
            "left out"
        )
    near: NDArray[np.int64] = stamps[~far]
    return near


def _blank_channels(record: FileRecord, log: RawLog, spec: MotorSpec) -> list[str]:
    """Return messages about channels all of whose cells are blank."""
    cells = {name: len(part.missing) for name, part in log.channels.items() if len(part.missing)}
    blank = {name: n for name, n in cells.items() if _is_blank(log.channels[name])}
    notes = [f"all {count} cells of {name} are blank" for name, count in blank.items()]
    if blank and len(blank) == len(cells):
        message = f"there is no sample: {', '.join(notes)}"
        raise LogError("log_empty", Path(record.path), message, next(iter(blank)))
    # An on-change channel is blank in every row of another channel.
    silent = {name for name, part in spec.file.channels.items() if part.is_on_change}
    return [note for name, note in zip(blank, notes, strict=True) if name not in silent]


def _is_blank(channel: RawChannel) -> bool:
    if channel.unparsed or not channel.missing.all():
        return False
    return channel.bad_quality is None or not channel.bad_quality.any()


def labels_of(record: FileRecord) -> set[dt.date]:
    """Return nights that a file touches."""
    return set(map(dt.date.fromisoformat, record.nights))


def slice_night(
    logs: Iterable[RawLog], night: Night, reach_us: Mapping[str, int]
) -> dict[str, RawChannel]:
    """Return the samples of a night from the contents of all files that have some, file after file.

    `reach_us` is, by channel, from how long before the night samples carry over into it [µs].
    """
    parts: dict[str, list[RawChannel]] = {}
    for log in logs:
        # Channels of a table share their stamps.
        shared: dict[tuple[int, int, int], tuple[Rows, NDArray[np.int64]]] = {}
        for name, channel in log.channels.items():
            time_us, start_us = channel.time_us, night.start_us - reach_us.get(name, 0)
            key = time_us.ctypes.data, time_us.size, start_us
            if key not in shared:
                rows = chosen_rows((time_us >= start_us) & (time_us < night.end_us))
                shared[key] = rows, time_us[rows]
            parts.setdefault(name, []).append(channel.rows(*shared[key]))
    return {
        name: pieces[0] if len(pieces) == 1 else RawChannel.join(pieces)
        for name, pieces in parts.items()
    }


def reaches_us(spec: MotorSpec) -> dict[str, int]:
    """Return longest time for which the last sample of each on-change channel holds [µs]."""
    return {
        name: round(channel.longest_silence_s * SECOND_US)
        for name, channel in spec.file.channels.items()
        if channel.is_on_change and channel.longest_silence_s
    }


# Dates in the names of logs: nights of those that cannot be read, stamps that contradict them

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


def dates_of_no_night(spec: MotorSpec, nights: Collection[dt.date]) -> Iterator[str]:
    """Yield events and periods of the config that touch no night of the logs, in words."""
    for event in spec.file.events:
        if event.date > max(now().date() + DAY, *nights, dt.date.min):
            yield f"event {event.kind} of {event.date}: has not come, and changes nothing till then"
    for since, until in (*spec.file.periods.training, *spec.file.periods.validation):
        ends = (night_of(microseconds(end), spec.settings.nights) for end in (since, until))
        first, last = ends
        if nights and not any(first <= night <= last for night in nights):
            yield f"period {since} to {until}: no log covers a night of it, and it chooses nothing"

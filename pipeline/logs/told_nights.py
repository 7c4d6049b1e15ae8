"""Nights of files that cannot be read, as a former record, the name or the time tells them."""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from pipeline.config import MotorSpec
from pipeline.config.nights import DAY, night_of
from pipeline.ingest.wall_clock import LATEST_US
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord

# A night known from a file's name or time alone lies this near to those of the motor's other logs.
FARTHEST_NIGHT = 31 * DAY
# End of a message on how a file's night is known.
TOLD = re.compile(r" \((?:night )?told (by [a-z ]+)[^()]*\)$")
_DATE_IN_NAME = re.compile(r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])")


@dataclass(frozen=True, slots=True)
class PlausibleNights:
    """Nights that a file's name or time may tell where the file itself cannot be read."""

    # first, last: of the motor's readable logs; None without one.
    first: dt.date | None
    last: dt.date | None
    latest: dt.date  # the night of a day from now

    @classmethod
    def of(cls, files: Iterable[FileRecord], latest: dt.date) -> PlausibleNights:
        """From all files of a motor; those that cannot be read say nothing."""
        known = {label for one in files if one.status == "ok" for label in labels_of(one)}
        return cls(min(known, default=None), max(known, default=None), latest)

    def why_not(self, label: dt.date) -> str | None:
        """Reason why a name or time cannot tell a night; None: it can."""
        if label > self.latest:
            return "more than a day ahead"
        if self.first is None or self.last is None:
            return None
        if self.first - FARTHEST_NIGHT <= label <= self.last + FARTHEST_NIGHT:
            return None
        return f"more than {FARTHEST_NIGHT.days} days from those of the motor's other logs"

    def only_plausible(self, record: FileRecord) -> FileRecord:
        """The record of a file without nights that its name or time cannot tell."""
        if not is_guess(record):
            return record
        kept = [label for label in sorted(labels_of(record)) if self.why_not(label) is None]
        return replace(record, nights=tuple(map(dt.date.isoformat, kept)))


def is_guess(record: FileRecord) -> bool:
    """True if a file's nights, if any, are known from its name or time alone."""
    return record.status != "ok" and record.first_us is None


def is_newly_told(before: FileRecord, now: FileRecord) -> bool:
    """True if an unchanged file's name or time now gives a night that it did not before."""
    return is_guess(now) and not labels_of(now) <= labels_of(before)


def place_failed(
    records: Mapping[str, FileRecord],
    before: Mapping[str, FileRecord],
    spec: MotorSpec,
    plausible: PlausibleNights,
) -> dict[str, FileRecord]:
    """Give each unreadable file the night that it would have been of.

    In this order: by its former record, by the date in its name compared with those of readable
    files, or by the time of its last change; the message says which. A file that vanished, or
    whose night is not plausible, stays without one.
    """
    lag = _lag_of_names(one for one in records.values() if one.status == "ok" and one.nights)
    return {
        name: _placed(record, before.get(name), lag, spec, plausible)
        if is_guess(record)
        else record
        for name, record in records.items()
    }


def _placed(
    record: FileRecord,
    before: FileRecord | None,
    lag: dt.timedelta,
    spec: MotorSpec,
    plausible: PlausibleNights,
) -> FileRecord:
    told = _told(record, before, lag, spec)
    if told is None:
        return record
    labels, basis = told
    placed = plausible.only_plausible(replace(record, nights=tuple(map(dt.date.isoformat, labels))))
    if placed.nights and placed.nights == record.nights:
        return record
    # The night itself is always shown beside the message.
    how = f"night told {basis}"
    if not placed.nights:
        how = f"told {basis}, its night would lie {plausible.why_not(labels[0])}: it is of none"
    return replace(placed, message=f"{TOLD.sub('', record.message or '')} ({how})")


def _told(
    record: FileRecord, before: FileRecord | None, lag: dt.timedelta, spec: MotorSpec
) -> tuple[list[dt.date], str] | None:
    """Nights that a file seems to be of, and how they are known; None if they are not."""
    if record.nights:  # as a run before has told
        said = TOLD.search(record.message or "")
        return sorted(labels_of(record)), said[1] if said else "by what it held before"
    if record.error_code == "log_not_readable" and not record.modified_ns:
        return None  # it vanished
    if before is not None and before.nights:
        return sorted(labels_of(before)), "by what it held before"
    named = date_in(record.path)
    if named is not None:
        return [named + lag], "by its name"
    if not record.modified_ns:
        return None
    # A file may be of a time that no date can say.
    written_us = min(record.modified_ns // 1000, LATEST_US)
    return [night_of(written_us, spec.settings.nights)], "by when it was written"


def date_in(name: str) -> dt.date | None:
    """The last date in a file's name; None without one."""
    found = _DATE_IN_NAME.findall(name)
    try:
        return dt.date(*map(int, found[-1])) if found else None
    except ValueError:
        return None


def _lag_of_names(records: Iterable[FileRecord]) -> dt.timedelta:
    """Time from the date in a file's name to its first night, of most files."""
    lags = Counter(
        min(labels_of(record)) - date for record in records if (date := date_in(record.path))
    )
    return lags.most_common(1)[0][0] if lags else 0 * DAY

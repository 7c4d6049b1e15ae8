"""Local wall-clock time to UTC: the hour that comes twice, and the one that never comes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

EARLIEST_US = int(datetime(1990, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
LATEST_US = int(datetime(2200, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000
"""Outside is no stamp: a clock never set, seconds for milliseconds, time since the log's start."""

EPOCH = datetime(1970, 1, 1)
MICROSECOND = timedelta(microseconds=1)

_MINUTE_US = 60 * 1_000_000
_STEP_BACK_US = 30 * 60 * 1_000_000


@dataclass(frozen=True, slots=True)
class TimeStamps:
    """Time stamps of a column.

    A stamp is not readable where the cell was blank, no time, before 1990 or after 2200, or a local
    time that does not exist.
    """

    time_us: NDArray[np.int64]  # UTC, microseconds since 1970; 0 where not readable
    readable: NDArray[np.bool_]
    skipped: int = 0  # local times that do not exist, as the clock was put forward over them
    example: str | None = None  # the first that is not readable, as it is written, for a message


def from_naive(local_us: NDArray[np.int64], readable: NDArray[np.bool_], zone: str) -> TimeStamps:
    """Local wall-clock time of a zone to UTC.

    Where a clock change gives an hour twice, stamps belong to its first pass until they step back
    by half an hour or more, then to the second. Stamps in an hour that the change leaves out are
    not readable, and counted. `local_us` [µs since 1970], and what of it is `readable`: (n,).

    Examples
    --------
    >>> noon = np.array([1740830400000000])
    >>> from_naive(noon, np.array([True]), "Europe/Stockholm").time_us.tolist()
    [1740826800000000]
    """
    plausible = readable & (local_us >= EARLIEST_US) & (local_us < LATEST_US)
    if zone == "UTC" or not plausible.any():
        # A log of a day at 100 Hz has 69 MB of stamps: none are copied without need.
        kept = local_us if plausible.all() else np.where(plausible, local_us, 0)
        return TimeStamps(kept, plausible)
    local = local_us[plausible]
    first_us, second_us = _offsets_us(local, zone)
    offset_us = np.where(_on_second_pass(local, first_us != second_us), second_us, first_us)
    exists = second_us <= first_us
    time_us = np.zeros_like(local_us)
    time_us[plausible] = np.where(exists, local - offset_us, 0)
    plausible[plausible] = exists
    return TimeStamps(time_us, plausible, int(np.count_nonzero(~exists)))


def _offsets_us(local: NDArray[np.int64], zone: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Offset from UTC on the first and on the second pass; smaller on the first: no such time."""
    # Since 1990 all zones have changed their offset at a whole minute, St. John's at 00:01.
    by_row = local // _MINUTE_US
    begins = np.flatnonzero(np.diff(by_row, prepend=by_row[0] - 1))
    minutes, which = np.unique(by_row[begins], return_inverse=True)
    tz = ZoneInfo(zone)
    offsets = np.empty((2, minutes.size), dtype=np.int64)
    for i, minute in enumerate(minutes.tolist()):
        wall = EPOCH + timedelta(microseconds=minute * _MINUTE_US)
        for fold in (0, 1):
            offset = tz.utcoffset(wall.replace(fold=fold))
            offsets[fold, i] = 0 if offset is None else offset // MICROSECOND
    of_row = np.repeat(which, np.diff(begins, append=by_row.size))
    return offsets[0, of_row], offsets[1, of_row]


def _on_second_pass(local: NDArray[np.int64], ambiguous: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """True where an hour that comes twice has stepped back since it began."""
    if not ambiguous.any():
        return ambiguous
    steps_back = np.cumsum((np.diff(local, prepend=local[0]) < -_STEP_BACK_US) & ambiguous)
    before_run = np.maximum.accumulate(np.where(ambiguous, 0, steps_back))
    return np.asarray(ambiguous & (steps_back > before_run))

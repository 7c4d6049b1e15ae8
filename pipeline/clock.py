"""Times as UTC microseconds since 1970, and the run's clock."""

from __future__ import annotations

import datetime as dt

MICROSECOND = dt.timedelta(microseconds=1)
EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
# Words for stamps beyond that.
IN_FUTURE = "more than a day in the future"
# A logger's clock may be in another zone than it says, but not further ahead.
FARTHEST_AHEAD = dt.timedelta(days=1)


def microseconds(time: dt.datetime) -> int:
    """Return a time as UTC microseconds."""
    return (time - EPOCH) // MICROSECOND


def utc(time_us: int) -> dt.datetime:
    """Return a time stamp as the tables hold it."""
    return EPOCH + int(time_us) * MICROSECOND


def now() -> dt.datetime:
    """Return the time of this machine."""
    return dt.datetime.now(dt.UTC)


def latest_us(clock: dt.datetime | None = None) -> int:
    """Return latest time of a log, by this machine's clock by default [µs since 1970]."""
    return microseconds((clock or now()) + FARTHEST_AHEAD)

"""Nights of log files that cannot be read."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence

import pytest

from pipeline.logs.dates import with_known_nights
from pipeline.logs.processed import FileRecord

LATEST = dt.date(2026, 6, 1)


def failed(name: str) -> FileRecord:
    return FileRecord(name, 10, 1, "x", status="failed", message="torn")


def readable(name: str, *nights: str) -> FileRecord:
    return FileRecord(name, 10, 1, "y", nights=nights)


def placed(*records: FileRecord, before: Sequence[FileRecord] = ()) -> dict[str, FileRecord]:
    known = {record.path: record for record in before}
    return with_known_nights({record.path: record for record in records}, known, LATEST)


def test_as_read_before() -> None:
    """A log that was cut after it had been read: the nights that it had, whatever its name."""
    name = "a_2026-02-20.csv"
    before = readable(name, "2026-01-05", "2026-01-06")
    record = placed(failed(name), before=[before])[name]
    assert record.nights == ("2026-01-05", "2026-01-06")
    assert record.message == "torn (night known by what it held before)"
    # The next run finds it as this one left it.
    assert placed(record, before=[record])[name] == record


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("2026-03-04.csv", "2026-03-04"),
        ("M1_2026.03.04_220000.csv", "2026-03-04"),
        ("x/20260304T220000Z.mcap", "2026-03-04"),
        ("since_2020-01-01/2026-03-04.csv", "2026-03-04"),  # the last date counts
        # Digits within a longer number, such as seconds since 1970, are no date.
        *((name, None) for name in ("log.csv", "1720101005.csv", "2026-02-30.csv", "M20.csv")),
        ("serial-120260304.csv", None),
        ("2026-06-01.csv", "2026-06-01"),
        ("2026-06-02.csv", None),  # after the latest
    ],
)
def test_dates_in_names(name: str, date: str | None) -> None:
    assert placed(failed(name))[name].nights == ((date,) if date else ())


@pytest.mark.parametrize(
    ("night", "is_plausible"),
    [("2025-11-30", False), ("2025-12-01", True), ("2026-02-10", True), ("2026-02-11", False)],
)
def test_a_night_is_near_the_others(night: str, is_plausible: bool) -> None:
    """Within 31 days of the motor's readable logs, present or remembered, of 1 to 10 January.

    Files here are named after the evening on which they begin, but for one.
    """
    evening = dt.date.fromisoformat(night) - dt.timedelta(days=1)
    name = f"x_{evening}.csv"
    neighbours = [readable(f"m/2026010{day}.csv", f"2026-01-0{day + 1}") for day in (1, 2, 3)]
    strange, before = readable("m/20260104.csv", "2026-01-01"), readable("9", "2026-01-10")
    record = placed(*neighbours, strange, failed(name), before=[before])[name]
    assert record.nights == ((night,) if is_plausible else ())
    assert (record.message == "torn (night known by its name)") == is_plausible

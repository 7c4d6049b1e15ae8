"""Time stamps against Python's own datetime and zoneinfo."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from pipeline.config.logs import EPOCH_UNITS, require_time_format
from pipeline.ingest.conformance import T0_US
from pipeline.ingest.time_stamps import (
    TimeStamps,
    WrittenStamps,
    example_of,
    parse_numbers,
    parse_written,
    place_in_zone,
)

from .sources import logs_of

MICROSECOND = timedelta(microseconds=1)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
moments = st.datetimes(datetime(1990, 1, 2), datetime(2199, 12, 30))


def us(moment: datetime) -> int:
    return (moment - EPOCH) // MICROSECOND


def read(texts: list[str | None], time_format: str = "iso8601", zone: str = "UTC") -> TimeStamps:
    return place_in_zone(parse_written([pa.chunked_array([texts], pa.string())], time_format), zone)


def local(*texts: str, zone: str) -> list[int]:
    return read(list(texts), zone=zone).time_us.tolist()


def at_walls(naive: NDArray[np.int64], zone: str) -> NDArray[np.int64]:
    """Stamps on the wall clock of a zone in UTC."""
    return place_in_zone(WrittenStamps(naive, np.ones(naive.size, np.int8)), zone).time_us


@pytest.mark.parametrize(
    ("text", "offset_us"),
    [
        ("2025-03-01T06:00:00Z", 0),
        ("2025-03-01 06:00:00Z", 0),
        ("2025-03-01T06:00:00", 0),
        ("2025-03-01T06:00Z", 0),
        ("2025-03-01T06:00:00.5Z", 500_000),
        ("2025-03-01T06:00:00.123456Z", 123_456),
        ("2025-03-01T06:00:00.123456999Z", 123_456),
        ("2025-03-01T07:00:00+01:00", 0),
        ("2025-03-01T07:00:00+0100", 0),
        ("2025-03-01T07:30:00.25+01:30", 250_000),
        ("2025-02-28T22:00:00-08:00", 0),
        (" 2025-03-01T06:00:00Z ", 0),
        ("2025-03-01T06:00:00,5Z", 500_000),
        ("20250301T060000Z", 0),
    ],
)
def test_iso_8601_in_its_spellings(text: str, offset_us: int) -> None:
    for beside in ([], ["no time"], [None], ["2025-03-01T06:00:00"], ["2025-03-01T06:00:00Z"]):
        stamps = read([text, *beside])
        assert stamps.time_us[0] == T0_US + offset_us
        assert stamps.readable[0]


def test_what_is_no_stamp() -> None:
    for text in (
        *("", "no time", "2025-02-30T00:00:00Z", "2025-03-01T25:00:00Z", "06:00:00", "1740808800"),
        *("1970-01-01T00:00:00Z", "1989-12-31T23:59:59Z", "2200-01-01T00:00:00Z"),
    ):
        stamps = read([text, "2025-03-01T06:00:00Z"])
        assert stamps.readable.tolist() == [False, True]
        assert stamps.time_us.tolist() == [0, T0_US]


@given(st.lists(moments, min_size=1, max_size=20), st.integers(-14 * 60, 14 * 60), st.booleans())
def test_iso_8601_as_datetime_writes_it(
    times: list[datetime], minutes: int, bad_cell: bool
) -> None:
    zone = timezone(timedelta(minutes=minutes))
    aware = [time.replace(tzinfo=zone) for time in times]
    stamps = read([time.isoformat() for time in aware] + ["?"] * bad_cell)
    assert stamps.time_us[: len(times)].tolist() == [us(time) for time in aware]


@pytest.mark.parametrize(
    ("time_format", "text", "offset_us"),
    [
        ("%d.%m.%Y %H:%M:%S", "01.03.2025 06:00:00", 0),
        ("%d.%m.%Y %H:%M:%S.%f", "01.03.2025 06:00:00.25", 250_000),
        ("%d.%m.%Y %H:%M:%S,%f", "01.03.2025 06:00:00,25", 250_000),
        ("%d.%m.%Y, %H:%M:%S,%f", "01.03.2025, 06:00:00,25", 250_000),
        ("%m/%d/%y %I:%M:%S %p", "03/01/25 06:00:00 AM", 0),
        ("%m/%d/%Y %I:%M %p", "03/01/2025 06:00 PM", 12 * 3600 * 1_000_000),
        ("%d-%b-%Y %H:%M:%S", "01-Mar-2025 06:00:00", 0),
        ("%d %B %Y %H:%M", "01 March 2025 06:00", 0),
        ("%Y-%j %H:%M:%S", "2025-060 06:00:00", 0),
        ("%a %b %d %H:%M:%S %Y", "Sat Mar 01 06:00:00 2025", 0),
        ("%Y%m%d%H%M%S", "20250301060000", 0),
        ("%Y%m%d-%H%M%S.%f", "20250301-060000.000001", 1),
        ("%Y-%m-%d %H:%M:%S %z", "2025-03-01 07:00:00 +0100", 0),
        ("%Y-%m-%d %H:%M:%S%z", "2025-03-01 06:00:00Z", 0),
    ],
)
def test_formats_mean_what_they_mean_to_python(time_format: str, text: str, offset_us: int) -> None:
    moment = datetime.strptime(text, time_format)
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    assert us(moment) == T0_US + offset_us
    assert require_time_format(time_format) == time_format
    stamps = read([f" {text} ", "?", None, text], time_format)
    assert stamps.time_us.tolist() == [T0_US + offset_us, 0, 0, T0_US + offset_us]
    assert stamps.readable.tolist() == [True, False, False, True]
    in_tokyo = read([text], time_format, "Asia/Tokyo").time_us.tolist()
    nine_hours = 0 if "%z" in time_format else 9 * 3600 * 1_000_000
    assert in_tokyo == [T0_US + offset_us - nine_hours]


@pytest.mark.parametrize(
    ("time_format", "text", "offset_us"),
    [
        ("epoch_s", "1740808800", 0),
        ("epoch_s", "1740808800.1", 100_000),
        ("epoch_s", "1740808800.000001", 1),
        ("epoch_s", "1.7408088E9", 0),
        ("epoch_ms", "1740808800001", 1000),
        ("epoch_ms", "1740808800000.5", 500),
        ("epoch_us", "1740808800000001", 1),
        ("epoch_ns", "1740808800000001999", 1),
        ("epoch_ns", " 1740808800000001999", 1),
    ],
)
def test_time_since_1970_as_text(time_format: str, text: str, offset_us: int) -> None:
    for beside in ([], ["?"], [None], [f"{text.strip()}"]):
        stamps = read([text, *beside], time_format)
        assert stamps.time_us[0] == T0_US + offset_us


def test_the_largest_integers_are_no_time() -> None:
    for dtype in (np.int64, np.uint64):
        largest = np.array([np.iinfo(dtype).max, np.iinfo(dtype).min], dtype)
        for time_format in ("epoch_s", "epoch_ms", "epoch_us", "epoch_ns"):
            stamps = parse_numbers(largest, time_format)
            assert stamps.time_us.tolist() == [0, 0] or time_format == "epoch_ns"


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Kolkata"])
def test_arrow_timestamps_of_every_unit(unit: str, zone: str | None) -> None:
    per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    counts = [1740808800 * per_second, None, 0, 2**62, -(2**62)]
    column = pa.chunked_array([counts[:2], counts[2:]], pa.timestamp(unit, zone))
    stamps = place_in_zone(parse_written([column], "iso8601"), "UTC")
    assert stamps.time_us[:3].tolist() == [T0_US, 0, 0]
    assert stamps.readable[:3].tolist() == [True, False, False]


def test_a_zone_in_the_stamps_goes_before_the_zone_of_the_log() -> None:
    assert read(["2025-03-01T06:00:00Z"], zone="Asia/Tokyo").time_us.tolist() == [T0_US]
    assert read(["2025-03-01T15:00:00"], zone="Asia/Tokyo").time_us.tolist() == [T0_US]
    assert local("2025-03-01T15:00:00", "2025-03-01T06:00:00Z", zone="Asia/Tokyo") == [T0_US] * 2


@given(
    st.lists(moments.map(lambda time: time.replace(second=0, microsecond=0)), max_size=20),
    st.sampled_from(["Europe/Stockholm", "America/St_Johns", "Asia/Kathmandu", "Pacific/Apia"]),
)
def test_local_time_is_that_of_the_zone(times: list[datetime], zone: str) -> None:
    tz = ZoneInfo(zone)
    real = [
        time
        for time in times
        if len({time.replace(tzinfo=tz, fold=fold).utcoffset() for fold in (0, 1)}) == 1
    ]
    naive = np.array([us(time.replace(tzinfo=UTC)) for time in real], dtype=np.int64)
    assert at_walls(naive, zone).tolist() == [us(time.replace(tzinfo=tz)) for time in real]


@pytest.mark.parametrize(
    ("zone", "start"),
    [
        # At 01:00 UTC the clock goes from 03:00 back to 02:00.
        ("Europe/Stockholm", datetime(2025, 10, 25, 23, 30, tzinfo=UTC)),
        # At 02:31 UTC the clock goes from 00:01 back to 23:01 of the day before.
        ("America/St_Johns", datetime(2005, 10, 30, 1, 5, tzinfo=UTC)),
    ],
)
def test_an_hour_that_comes_twice_goes_on_where_the_clock_steps_back(
    zone: str, start: datetime
) -> None:
    # Sorted by the clock on the wall, an hour's stamps stand in pairs.
    for step_s, is_sorted in ((7, False), (10, True)):
        utc = us(start) + np.arange(0, 4 * 3600, step_s, dtype=np.int64) * 1_000_000
        walls = [(EPOCH + int(time) * MICROSECOND).astimezone(ZoneInfo(zone)) for time in utc]
        naive = np.array([us(wall.replace(tzinfo=UTC)) for wall in walls])
        assert np.any(np.diff(naive) < 0)
        found = at_walls(np.sort(naive) if is_sorted else naive, zone)
        np.testing.assert_array_equal(np.sort(found) if is_sorted else found, utc)


def test_a_sample_out_of_order_is_not_the_second_pass_of_an_hour() -> None:
    times = ["2025-10-26T02:10:00", "2025-10-26T02:09:59", "2025-10-26T02:11:00"]
    wanted = [us(datetime.fromisoformat(time + "+02:00")) for time in times]
    assert local(*times, zone="Europe/Stockholm") == wanted


def test_an_hour_that_comes_twice_in_each_of_two_years() -> None:
    passes = ["T01:30+02:00", "T02:31+02:00", "T02:00+01:00", "T03:30+01:00"]
    stamps = [day + clock for day in ("2025-10-26", "2026-10-25") for clock in passes]
    walls = [stamp[:16] for stamp in stamps]
    wanted = [us(datetime.fromisoformat(stamp)) for stamp in stamps]
    assert local(*walls, zone="Europe/Stockholm") == wanted
    # Back by exactly half an hour: still the first pass.
    walls[1], wanted[1] = walls[1].replace("31", "30"), wanted[1] - 60_000_000
    wanted[2] -= 3_600_000_000
    assert local(*walls[:3], zone="Europe/Stockholm") == wanted[:3]


def test_an_hour_that_does_not_exist_is_refused_and_counted() -> None:
    texts = ["2025-03-30T01:59:59", "2025-03-30T02:00:00", "2025-03-30T02:59:59"]
    stamps = read([*texts, "2025-03-30T03:00:00"], zone="Europe/Stockholm")
    assert stamps.readable.tolist() == [True, False, False, True]
    assert stamps.skipped == 2
    # 01:59:59 at +01:00 and 03:00:00 at +02:00 are a second apart.
    assert stamps.time_us[3] - stamps.time_us[0] == 1_000_000
    assert stamps.time_us[1:3].tolist() == [0, 0]


@given(st.lists(st.text(max_size=30) | st.none(), max_size=10))
def test_any_text_is_a_stamp_or_none(texts: list[str | None]) -> None:
    for time_format in ("iso8601", "epoch_s", "epoch_ns", "%d.%m.%Y %H:%M:%S,%f", "%Y %j %H:%M%z"):
        encodable = [text and text.encode(errors="replace").decode() for text in texts]
        stamps = read(encodable, time_format)
        assert stamps.time_us.size == stamps.readable.size == len(texts)
        assert (stamps.time_us[~stamps.readable] == 0).all()


# Messages on what cannot be read: the cell, and how a stamp would be written


@pytest.mark.parametrize(
    ("stamps", "time_format", "cell", "example"),
    [
        (["", "6 am", "7 am"], "iso8601", "6 am", "2025-03-01T06:00:00Z"),
        (
            ["13/25/2025 06:00 PM"],
            "%m/%d/%Y %I:%M %p",
            "13/25/2025 06:00 PM",
            "03/01/2025 06:00 AM",
        ),
        (["12.5", "13.5"], "epoch_s", "12.5", "1740808800"),
        (["x"], "excel_days", "x", "45717.25"),
        (["1970-01-01T00:00:07Z"], "iso8601", "1970-01-01 00:00:07", "2025-03-01T06:00:00Z"),
        # With and without a zone, so that each cell is parsed by itself.
        (
            ["0001-01-01T00:00:00+14:00", "0001-01-01T00:00:00"],
            *("iso8601", "0000-12-31 10:00:00", "2025-03-01T06:00:00Z"),
        ),
        (["9" * 400], "epoch_s", "9" * 400, "1740808800"),
    ],
)
def test_a_cell_that_is_no_time_is_shown_beside_one_that_would_be(
    stamps: list[str], time_format: str, cell: str, example: str
) -> None:
    found = read(list(stamps), time_format)
    assert not found.readable.any()
    assert (found.example, example_of(time_format)) == (cell, example)


@pytest.mark.parametrize("cell", ["9" * 400, "1" + "0" * 305, "-1e305", "1e400", "1e-400"])
@pytest.mark.parametrize("time_format", [*EPOCH_UNITS, "excel_days"])
def test_a_number_beyond_any_time_is_none(time_format: str, cell: str) -> None:
    good = example_of(time_format)
    assert read([good, cell, good], time_format).time_us.tolist() == [T0_US, 0, T0_US]


@pytest.mark.parametrize(
    "time_format", ["iso8601", "%d.%m.%Y %H:%M:%S,%f", "%Y-%j %H:%M %z", "%Y-%m-%d %H:%M"]
)
def test_the_example_is_read_in_its_format(time_format: str) -> None:
    assert read([example_of(time_format)], time_format).time_us.tolist() == [T0_US]


@pytest.mark.parametrize(
    "time_format",
    [
        *("%H:%M:%S", "%Y-%m-%d", "%Y-%m-%d %q", "%Y-%m-%d %H:%M:%S %f"),
        *("%d.%m.%Y %I:%M", "epoch", ""),
    ],
)
def test_formats_that_cannot_work_are_refused_when_they_are_named(time_format: str) -> None:
    with pytest.raises(ValidationError, match="time_format"):
        logs_of("csv", time_format=time_format)

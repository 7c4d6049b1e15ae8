"""Nights: local days that end at a stated hour, across clock changes."""

from __future__ import annotations

import datetime as dt
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import Nights
from pipeline.config.nights import DAY, night, night_of, nights_between, nights_of

OSLO = Nights(time_zone="Europe/Oslo", end_hour=6)
HOUR = 3_600_000_000
SPRING, AUTUMN = dt.date(2026, 3, 29), dt.date(2026, 10, 25)
# Zones that change at midnight, by half an hour, by two hours, on other days or never.
ZONES = (
    *("UTC", "Europe/Oslo", "America/Santiago", "Asia/Beirut", "Africa/Cairo", "America/Nuuk"),
    *("Australia/Lord_Howe", "Antarctica/Troll", "Pacific/Chatham", "Asia/Kathmandu"),
    *("Africa/Casablanca", "Pacific/Kiritimati"),
)
ANY_NIGHTS = st.builds(Nights, time_zone=st.sampled_from(ZONES), end_hour=st.integers(0, 23))
MOMENTS = st.integers(1_577_836_800_000_000, 2_000_000_000_000_000)  # 2020 to 2033


def utc(*parts: int) -> int:
    return int(dt.datetime(*parts, tzinfo=dt.UTC).timestamp()) * 1_000_000  # type: ignore[misc, arg-type]


def hours(label: dt.date, nights: Nights) -> float:
    here = night(label, nights)
    return (here.end_us - here.start_us) / HOUR


@pytest.mark.parametrize(
    ("label", "start", "end", "lengths", "both", "at_two"),
    [
        pytest.param(SPRING, (28, 5), (29, 4), (24, 24, 23, 23), 47, (29, 1), id="spring"),
        pytest.param(AUTUMN, (24, 4), (25, 5), (24, 24, 25, 25), 49, (25, 0), id="autumn"),
    ],
)
def test_a_night_of_a_clock_change(
    label: dt.date,
    start: tuple[int, int],
    end: tuple[int, int],
    lengths: tuple[int, ...],
    both: int,
    at_two: tuple[int, int],
) -> None:
    """A night that ends at 02:00 ends when the clock jumps, or with the hour's first pass."""
    here = night(label, OSLO)
    assert (here.start_us, here.end_us) == tuple(
        utc(label.year, label.month, *moment) for moment in (start, end)
    )
    assert hours(label - DAY, OSLO) == hours(label + DAY, OSLO) == 24
    for end_hour, length in enumerate(lengths, start=1):
        nights = Nights(time_zone="Europe/Oslo", end_hour=end_hour)
        assert hours(label, nights) == length
        assert hours(label, nights) + hours(label + DAY, nights) == both
    ends_at_two = night(label, Nights(time_zone="Europe/Oslo", end_hour=2))
    assert ends_at_two.end_us == utc(label.year, label.month, *at_two)


@given(MOMENTS, ANY_NIGHTS)
def test_a_moment_lies_within_its_night(moment: int, nights: Nights) -> None:
    here = night(night_of(moment, nights), nights)
    assert here.start_us <= moment < here.end_us
    for edge in (here.start_us, here.end_us - 1):
        assert night_of(edge, nights) == here.date


@given(st.dates(dt.date(2020, 1, 1), dt.date(2033, 1, 1)), ANY_NIGHTS)
def test_nights_follow_without_gap_or_overlap(label: dt.date, nights: Nights) -> None:
    here, following = night(label, nights), night(label + DAY, nights)
    assert here.end_us == following.start_us
    assert 22 <= hours(label, nights) <= 26
    end = dt.datetime.fromtimestamp(here.end_us / 1e6, ZoneInfo(nights.time_zone))
    assert end.date() == label


@given(st.lists(MOMENTS, max_size=20), ANY_NIGHTS)
def test_nights_of_many_moments_are_those_of_each(moments: list[int], nights: Nights) -> None:
    expected = {night_of(moment, nights) for moment in moments}
    assert nights_of(np.array(moments, np.int64), nights) == expected


def test_nights_between_has_both_ends() -> None:
    assert nights_between(SPRING, SPRING) == [SPRING]
    assert nights_between(SPRING, SPRING + 2 * DAY) == [SPRING, SPRING + DAY, SPRING + 2 * DAY]
    assert nights_between(SPRING, SPRING - DAY) == []

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


def local(nights: Nights, *parts: int, fold: int = 0) -> int:
    stamp = dt.datetime(*parts, tzinfo=nights.zone, fold=fold)  # type: ignore[misc, arg-type]
    return int(stamp.timestamp()) * 1_000_000


def hours(label: dt.date, nights: Nights) -> float:
    here = night(label, nights)
    return (here.end_us - here.start_us) / HOUR


class TestClockChange:
    def test_borders_stay_at_the_local_hour(self) -> None:
        assert night(SPRING, OSLO).start_us == utc(2026, 3, 28, 5)
        assert night(SPRING, OSLO).end_us == utc(2026, 3, 29, 4)
        assert night(AUTUMN, OSLO).start_us == utc(2026, 10, 24, 4)
        assert night(AUTUMN, OSLO).end_us == utc(2026, 10, 25, 5)
        for label in (SPRING, AUTUMN):
            assert hours(label - DAY, OSLO) == hours(label + DAY, OSLO) == 24

    @pytest.mark.parametrize(
        ("label", "lengths", "both", "end"),
        [
            (SPRING, (24, 24, 23, 23), 47, (2026, 3, 29, 1)),
            (AUTUMN, (24, 24, 25, 25), 49, (2026, 10, 25, 0)),
        ],
    )
    def test_end_hour_around_the_skipped_and_the_repeated_one(
        self, label: dt.date, lengths: tuple[int, ...], both: int, end: tuple[int, ...]
    ) -> None:
        """A night that ends at 02:00 ends when the clock jumps, or with the hour's first pass."""
        for end_hour, length in enumerate(lengths, start=1):
            nights = Nights(time_zone="Europe/Oslo", end_hour=end_hour)
            assert hours(label, nights) == length
            assert hours(label, nights) + hours(label + DAY, nights) == both
        assert night(label, Nights(time_zone="Europe/Oslo", end_hour=2)).end_us == utc(*end)


@given(MOMENTS, ANY_NIGHTS)
def test_a_moment_lies_within_its_night(moment: int, nights: Nights) -> None:
    here = night(night_of(moment, nights), nights)
    assert here.start_us <= moment < here.end_us
    for edge in (here.start_us, here.end_us - 1):
        assert night_of(edge, nights) == here.date


@given(st.dates(dt.date(2020, 1, 1), dt.date(2033, 1, 1)), ANY_NIGHTS)
def test_nights_follow_without_gap_or_overlap(label: dt.date, nights: Nights) -> None:
    one, other = night(label, nights), night(label + DAY, nights)
    assert one.end_us == other.start_us
    assert 22 <= (one.end_us - one.start_us) / HOUR <= 26
    end = dt.datetime.fromtimestamp(one.end_us / 1e6, ZoneInfo(nights.time_zone))
    assert end.date() == label


@given(st.lists(MOMENTS, max_size=20), ANY_NIGHTS)
def test_nights_of_many_moments_are_those_of_each(moments: list[int], nights: Nights) -> None:
    expected = {night_of(moment, nights) for moment in moments}
    assert nights_of(np.array(moments, np.int64), nights) == expected


def test_nights_between_has_both_ends() -> None:
    assert nights_between(SPRING, SPRING) == [SPRING]
    assert nights_between(SPRING, SPRING + 2 * DAY) == [SPRING, SPRING + DAY, SPRING + 2 * DAY]
    assert nights_between(SPRING, SPRING - DAY) == []

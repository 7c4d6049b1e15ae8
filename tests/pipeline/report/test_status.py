"""The fleet's state: what needs attention first, and what was said of it."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace

from pipeline.report.status import last_findings
from pipeline.report.words import STATES
from pipeline.trends.rows.motor_states import ORDER, LookStatus, urgency
from tests.pipeline.report.states import said, state_of


def test_every_state_has_a_meaning() -> None:
    assert set(STATES) == set(ORDER)


def test_of_an_alarm_that_was_inspected_twice_the_last_word_counts() -> None:
    first = said(4, "finding", finding="not_confirmed")
    second = replace(first, finding="confirmed", time=first.time + dt.timedelta(days=1))
    elsewhere = replace(first, motor_id="M2")
    found = last_findings([first, said(4), second, elsewhere])
    assert sorted(found) == ["confirmed", "not_confirmed"]


def test_a_sudden_rise_within_the_day_comes_first_and_a_clear_look_is_not_shown() -> None:
    since = dt.datetime(2026, 3, 2, 14, 30, tzinfo=dt.UTC)
    rise = LookStatus("look_now", since, "drain flow +82 % [75, 90]", told=1)
    broken = state_of("M2", look=rise)
    quiet = state_of("M3", look=LookStatus("clear", since, "x"))
    assert min((state_of("M1", "alarm"), quiet, broken), key=urgency).motor_id == "M2"
    assert "look now since 2026-03-02 14:30 UTC: drain flow +82 % [75, 90]" in broken.why
    assert "clear" not in quiet.why

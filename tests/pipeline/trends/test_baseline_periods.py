"""Baseline periods: what begins a new baseline."""

from __future__ import annotations

import datetime as dt

import pytest

from pipeline.config import MotorSpec
from pipeline.config.motors import Event
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import (
    LONGEST_SILENCE,
    History,
    blank_records,
    every_night,
    period_at,
    periods_of,
)
from pipeline.trends.nights.layout import Layout
from tests.pipeline.trends.nights import event, motor, named, night_of, reset

N = 20


def history(
    spec: MotorSpec | None = None, *said: Decision, models: dict[int, str] | None = None
) -> History:
    spec = spec or motor()
    records = blank_records([night_of(place) for place in range(N)])
    records["known"] = True
    for place in range(N):
        oil = spec.file.oil_on(night_of(place))
        records["model"][place] = (models or {}).get(place, oil).encode()
    return History(spec, Layout.of(spec, night_of(0)), records, said)


def begins(found: History, of_what: str = "leakage") -> list[tuple[int, str]]:
    return [(one.first, one.reason) for one in periods_of(found, of_what)]


@pytest.mark.parametrize(
    ("events", "further"),
    [
        ((), []),
        ((event(9, "overhaul", note="new rings"),), [(9, f"overhaul on {night_of(9)}: new rings")]),
        # Before the first night, or after the last.
        ((event(-5, "overhaul"), event(N, "overhaul")), []),
        ((event(5, "note", note="filter changed"),), []),
        # Its other hash begins no further one.
        ((event(9, "oil_change", oil="vg46"),), [(9, f"oil change on {night_of(9)}")]),
    ],
)
def test_what_begins_an_era(events: tuple[Event, ...], further: list[tuple[int, str]]) -> None:
    found = history(named(motor(), "M1", events=events))
    assert begins(found) == [(0, "first nights"), *further]
    for place, reason in further:
        assert period_at(periods_of(found), place - 1).reason == "first nights"
        assert period_at(periods_of(found), place).reason == reason


def test_other_settings_of_the_statistics_begin_one() -> None:
    models = dict.fromkeys(range(12, N), "other")
    found = history(models=models)
    assert begins(found) == [(0, "first nights"), (12, f"other settings from {night_of(12)}")]
    # A night without statistics is of none.
    assert begins(history(models=models | {12: ""}))[1][0] == 13


def test_a_reset_is_of_the_leakage_or_of_a_sensor() -> None:
    every, ring, zero = reset(5), reset(8, "K_piston_ring"), reset(11, "flow_zero")
    found = history(None, every, ring, zero)
    assert [first for first, _ in begins(found)] == [0, 5, 8]
    assert [first for first, _ in begins(found, "flow_zero")] == [0, 5, 11]
    assert [first for first, _ in begins(found, "pressure_zero")] == [0, 5]
    assert begins(found)[1][1] == f"reset from {night_of(5)}"


def test_every_night_is_one_until_a_motor_was_silent_for_long() -> None:
    records = blank_records([night_of(0), night_of(3)])
    records["known"] = True
    until = night_of(3 + LONGEST_SILENCE + 50)
    found = every_night(records, until)
    assert found["night"].tolist() == [
        night_of(0) + dt.timedelta(days=n) for n in range(4 + LONGEST_SILENCE)
    ]
    assert found["known"].nonzero()[0].tolist() == [0, 3]
    assert len(every_night(records, night_of(-1))) == 0
    # Once more, as a run finds them kept: blank nights are no nights of a log.
    assert every_night(found, until).tobytes() == found.tobytes()

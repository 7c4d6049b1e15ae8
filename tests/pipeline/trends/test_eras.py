"""Eras: what begins a new baseline."""

from __future__ import annotations

import datetime as dt

from pipeline.config import MotorSpec
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.eras import era_at, eras_of
from pipeline.trends.nights.history import LONGEST_SILENCE, History, blank_records, every_night
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
    return [(one.first, one.reason) for one in eras_of(found, of_what)]


def test_without_any_event_there_is_one() -> None:
    assert begins(history()) == [(0, "first nights")]


def test_events_begin_one_with_their_words() -> None:
    spec = named(motor(), "M1", events=[event(9, "overhaul", note="new rings")])
    expected = f"overhaul on {night_of(9)}: new rings"
    assert begins(history(spec)) == [(0, "first nights"), (9, expected)]
    assert era_at(eras_of(history(spec)), 8).reason == "first nights"
    assert era_at(eras_of(history(spec)), 9).reason == expected


def test_an_event_before_the_first_night_or_after_the_last_begins_none() -> None:
    early = named(motor(), "M1", events=[event(-5, "overhaul"), event(N, "overhaul")])
    assert begins(history(early)) == [(0, "first nights")]


def test_a_note_begins_none() -> None:
    noted = named(motor(), "M1", events=[event(5, "note", note="filter changed")])
    assert begins(history(noted)) == [(0, "first nights")]


def test_another_oil_begins_one_and_its_other_hash_no_further_one() -> None:
    spec = named(motor(), "M1", events=[event(9, "oil_change", oil="vg46")])
    assert begins(history(spec)) == [(0, "first nights"), (9, f"oil change on {night_of(9)}")]


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

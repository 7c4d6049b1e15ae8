"""Changes of state: each has a row, and what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from typing import Any

import pytest

from pipeline.trends.rows.alarm_rows import alarm_rows, new_rows, without_past
from tests.pipeline.trends.nights import night_of

Rows = list[dict[str, Any]]


def states(*states: str, first: int = 0, news: Sequence[int] = (), advice: str = "") -> Rows:
    """States of the leakage in nights in a row, in columns of `nights`."""
    return [
        {
            "motor_id": "M1",
            "night": night_of(place),
            "state": state,
            "cause": None,
            "sentence": f"it is {state}",
            "advice": advice,
            "detected_on": night_of(place) if place in news else None,
            "still_rising": False,
        }
        for place, state in enumerate(states, start=first)
    ]


def rows_of(nights: Rows, published: Sequence[dict[str, Any]] = ()) -> Rows:
    return alarm_rows({"leakage": nights}, published)


def brief(rows: Rows) -> list[tuple[int, str, str, str | None]]:
    return [
        ((row["night"] - night_of(0)).days, row["from_state"], row["to_state"], row["closed_as"])
        for row in rows
    ]


WORN = ("insufficient", "ok", "ok", "warning", "alarm", "alarm", "ok")


def test_every_change_has_one_row_that_joins_the_one_before() -> None:
    rows = rows_of(states(*WORN))
    assert brief(rows) == [
        (1, "insufficient", "ok", None),
        (3, "ok", "warning", None),
        (4, "warning", "alarm", None),
        (6, "alarm", "ok", "recovered"),
    ]
    assert rows[1]["id"] == f"M1 {night_of(3)} leakage"


def test_made_again_they_are_the_same() -> None:
    rows = rows_of(states(*WORN))
    assert rows_of(states(*WORN), rows) == rows
    late = [row for row in rows if row["night"] >= night_of(4)]
    assert rows_of(states(*WORN[4:], first=4), rows) == late


def test_night_by_night_they_are_those_of_one_run() -> None:
    rows: Rows = []
    for place, state in enumerate(WORN):
        rows += rows_of(states(state, first=place), rows)
    assert rows == rows_of(states(*WORN))


def test_a_further_change_in_a_state_in_force_has_a_row() -> None:
    rows = rows_of(states("ok", "warning", "warning", "warning", news=(1, 3)))
    assert brief(rows)[1:] == [(1, "ok", "warning", None), (3, "warning", "warning", None)]


def test_what_late_data_take_back_stays_and_is_closed() -> None:
    before = rows_of(states(*WORN))
    after = rows_of(states("insufficient", *["ok"] * 6), before)
    raised = [row for row in before if row["to_state"] in ("warning", "alarm")]
    assert all(row in after for row in raised)
    closing = after[-1]
    assert brief([closing]) == [(5, "alarm", "ok", "recomputed")]
    assert closing["sentence"] == (
        f"recomputed: what was raised on {night_of(4)} is not in the figures as they are now"
    )
    assert rows_of(states("insufficient", *["ok"] * 6), after) == after


def test_an_alarm_that_comes_out_otherwise_says_what_it_was() -> None:
    before = rows_of(states(*WORN))
    after = rows_of(states("insufficient", "ok", "ok", "warning", "common_cause"), before[:3])
    assert brief(after)[-1] == (4, "warning", "common_cause", None)
    assert after[-1]["sentence"] == "it is common_cause; before its data changed: it is alarm"


def test_what_is_raised_a_night_later_by_better_data_is_not_raised_twice() -> None:
    before = rows_of(states("ok", "warning", "warning"))
    after = rows_of(states("ok", "ok", "warning", "alarm"), before)
    assert brief(after)[1:] == [(1, "ok", "warning", None), (3, "warning", "alarm", None)]


def test_a_row_ends_on_what_to_do_once() -> None:
    before = rows_of(states("ok", "alarm", advice="Look at it."))
    assert before[0]["sentence"] == "baseline set: it is ok"
    assert before[1]["sentence"] == "it is alarm. Look at it."
    after = rows_of(states("ok", "warning", advice="Plan a look."), before)
    assert after[1]["sentence"] == (
        "it is warning; before its data changed: it is alarm. Look at it. Plan a look."
    )


def test_a_sensor_has_rows_of_its_own() -> None:
    sensor = [row | {"cause": "flow_zero"} for row in states("ok", "warning")]
    rows = alarm_rows({"leakage": states("ok", "ok"), "flow_zero": sensor}, [])
    assert [(row["id"].split()[-1], row["to_state"]) for row in rows] == [
        ("leakage", "ok"),
        ("flow_zero", "ok"),
        ("flow_zero", "warning"),
    ]


def row(place: int, before: str, after: str, cause: str | None = None) -> dict[str, Any]:
    return {
        "id": f"M1 {night_of(place)} {cause or 'leakage'}",
        "night": night_of(place),
        "from_state": before,
        "to_state": after,
        "cause": cause,
        "sentence": "so",
        "closed_as": None,
    }


LAST = night_of(20)


@pytest.mark.parametrize(
    ("rows", "published", "places"),
    [
        pytest.param([row(21, "ok", "warning")], [], [21], id="a new night"),
        pytest.param([row(5, "ok", "warning")], [], [5], id="a past night that is in force"),
        pytest.param(
            [row(5, "ok", "warning"), row(9, "warning", "ok")], [], [], id="one that is over"
        ),
        pytest.param(
            [row(7, "ok", "warning")], [row(5, "ok", "warning")], [], id="the same, otherwise dated"
        ),
        pytest.param(
            [row(5, "ok", "warning"), row(8, "warning", "ok")],
            [row(5, "ok", "warning")],
            [8],
            id="one that is taken back",
        ),
    ],
)
def test_what_of_the_past_is_notified(rows: Rows, published: Rows, places: list[int]) -> None:
    new = new_rows(rows, published)
    found: list[dt.date] = [one["night"] for one in without_past(rows, new, published, LAST)]
    assert found == [night_of(place) for place in places]


def test_rows_are_new_where_they_say_something_else() -> None:
    before = row(5, "ok", "warning")
    assert new_rows([before], [before]) == []
    other = before | {"sentence": "in other words"}
    assert new_rows([other], [before]) == [other]

"""Changes of state: each has a row, and what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from pipeline.trends.nights.trend_record import Record
from pipeline.trends.rows.alarm_rows import (
    MARKS,
    NightState,
    alarm_rows,
    change_of_rules,
    marked,
    new_alarms,
    rules_now,
)
from tests.pipeline.trends.nights import motor, night_of

Rows = list[dict[str, Any]]


def course(*states: str, first: int = 0, **more: Any) -> dict[str, list[NightState]]:
    """States of the leakage in nights in a row."""
    nights = [
        NightState(
            night_of(place),
            dt.datetime.combine(night_of(place), dt.time(6), dt.UTC),
            state,
            "change" if state in ("warning", "alarm") else "baseline",
            f"it is {state}",
            is_news=place in more.get("news", ()),
            advice=more.get("advice", ""),
        )
        for place, state in enumerate(states, start=first)
    ]
    return {"leakage": nights}


def told(states: dict[str, list[NightState]], published: Sequence[dict[str, Any]] = ()) -> Rows:
    return alarm_rows("M1", states, published)


def brief(rows: Rows) -> list[tuple[int, str, str, str]]:
    return [
        ((row["night"] - night_of(0)).days, row["from_state"], row["to_state"], row["way"])
        for row in rows
    ]


WORN = ("insufficient", "ok", "ok", "warning", "alarm", "alarm", "ok")


def test_every_change_has_one_row_that_joins_the_one_before() -> None:
    rows = told(course(*WORN))
    assert brief(rows) == [
        (1, "insufficient", "ok", "baseline"),
        (3, "ok", "warning", "change"),
        (4, "warning", "alarm", "change"),
        (6, "alarm", "ok", "recovered"),
    ]
    # The time is the end of the night, never the clock.
    assert rows[1]["time"] == dt.datetime.combine(night_of(3), dt.time(6), dt.UTC)
    assert {row["indicator"] for row in rows} == {"leakage"}


def test_made_again_they_are_the_same() -> None:
    rows = told(course(*WORN))
    assert told(course(*WORN), rows) == rows
    late = [row for row in rows if row["night"] >= night_of(4)]
    assert told(course(*WORN[4:], first=4), rows) == late


def test_night_by_night_they_are_those_of_one_run() -> None:
    rows: Rows = []
    for place, state in enumerate(WORN):
        rows += told(course(state, first=place), rows)
    assert rows == told(course(*WORN))


def test_a_further_change_that_is_told_in_a_state_that_stands_has_a_row() -> None:
    rows = told(course("ok", "warning", "warning", "warning", news=(1, 3)))
    assert brief(rows)[1:] == [
        (1, "ok", "warning", "change"),
        (3, "warning", "warning", "change"),
    ]


def test_what_late_data_take_back_stays_and_is_closed() -> None:
    before = told(course(*WORN))
    after = told(course("insufficient", *["ok"] * 6), before)
    kept = [row for row in before if row["to_state"] in ("warning", "alarm")]
    assert all(row in after for row in kept)
    closing = after[-1]
    assert brief([closing]) == [(5, "alarm", "ok", "recomputed")]
    assert closing["reason"] == (
        f"recomputed: what was raised on {night_of(4)} is not in the figures as they are now"
    )
    again = told(course("insufficient", *["ok"] * 6), after)
    assert again == after


def test_an_alarm_that_comes_out_otherwise_says_what_it_was() -> None:
    before = told(course(*WORN))
    after = told(course("insufficient", "ok", "ok", "warning", "common_cause"), before[:3])
    assert brief(after)[-1] == (4, "warning", "common_cause", "baseline")
    assert after[-1]["reason"] == "it is common_cause; before its data changed: it is alarm"


def test_what_is_told_a_night_later_by_better_data_is_not_told_twice() -> None:
    before = told(course("ok", "warning", "warning"))
    after = told(course("ok", "ok", "warning", "alarm"), before)
    assert brief(after)[1:] == [(1, "ok", "warning", "change"), (3, "warning", "alarm", "change")]


def test_an_indicator_that_is_no_longer_watched_is_closed() -> None:
    gone = {"night": night_of(2), "indicator": "K_piston_ring", "to_state": "alarm"}
    rows = [row for row in told(course("ok", first=3), [gone]) if row["indicator"] != "leakage"]
    assert brief(rows) == [(3, "alarm", "insufficient", "recomputed")]


def test_alarms_are_new_only_once() -> None:
    def row(state: str, way: str = "change", night: int = 0, **more: Any) -> dict[str, Any]:
        said = {"night": night_of(night), "indicator": "x", "to_state": state, "way": way}
        return said | {"is_silent": None} | more

    fresh = row("alarm", night=1)
    assert new_alarms([row("warning"), fresh], [row("warning")]) == [fresh]
    closed = row("ok", "recomputed")
    assert new_alarms([closed], [row("ok", "recovered")]) == [closed]
    assert new_alarms([row("warning", reason="in other words")], [row("warning")]) == []
    assert new_alarms([row("warning", is_silent=True)], []) == []


def test_a_row_ends_on_what_to_do_once() -> None:
    before = told(course("ok", "alarm", advice="Look at it."))
    assert before[-1]["reason"] == "it is alarm. Look at it."
    assert told(course("ok", "alarm", advice="Look at it."), before) == before
    (_, after) = told(course("ok", "warning", advice="Plan a look."), before)
    assert after["reason"] == (
        "it is warning; before its data changed: it is alarm. Look at it. Plan a look."
    )


Row = dict[str, Any]

LAST = dt.date(2026, 3, 31)
SPEC = motor()
RULES = rules_now(SPEC)
NOW = Record("", LAST, rules=RULES)
OLD = Record("", LAST, rules={**RULES, "trends": 0})
CHANGE = f"trends 0 to {RULES['trends']}"


def row(day: int, before: str, after: str, indicator: str = "K_piston_ring", **more: Any) -> Row:
    night = dt.date(2026, 3, 1) + dt.timedelta(days=day - 1)
    said = {"way": "level", "path": "piston_ring", "reason": f"{after} since day {day}"}
    return {"night": night, "indicator": indicator, "from_state": before, "to_state": after} | (
        said | dict.fromkeys(MARKS) | more
    )


BASELINE = row(15, "insufficient", "ok")
RAISED = row(20, "ok", "warning")


def marks(found: Row) -> tuple[Any, ...]:
    return tuple(found[name] for name in MARKS)


def test_versions_are_compared_by_name() -> None:
    assert change_of_rules(None, RULES) == ""
    assert change_of_rules(NOW, RULES) == ""
    assert change_of_rules(OLD, RULES) == CHANGE


def test_another_form_of_a_motors_model_is_a_change_of_its_rules() -> None:
    free = rules_now(replace(SPEC, roller_is_free=True))
    assert change_of_rules(NOW, free) == "scale of the rollers fixed to free"
    gone = row(22, "warning", "ok", way="recovered")
    assert [one["is_silent"] for one in marked([RAISED, gone], [BASELINE], NOW, free)] == [True] * 2


def test_the_same_rules_mark_nothing() -> None:
    assert [marks(one) for one in marked([BASELINE, RAISED], [BASELINE], NOW, RULES)] == [
        (None,) * 3
    ] * 2


def test_an_alarm_that_stands_and_was_never_told_is_told_once() -> None:
    first = marked([BASELINE, RAISED], [BASELINE], OLD, RULES)
    assert [marks(one) for one in first] == [(None,) * 3, (CHANGE, "ok", False)]
    # The next runs find it published, and leave its marks.
    assert marked([BASELINE, RAISED], first, NOW, RULES) == first
    assert marked([BASELINE, RAISED], first, OLD, RULES) == first


GONE = row(22, "warning", "ok", way="recovered")
SILENT = (CHANGE, "ok", True)


@pytest.mark.parametrize(
    ("rows", "published", "expected"),
    [
        pytest.param(
            [RAISED, row(24, "ok", "warning")], [BASELINE, row(24, "ok", "warning")],
            [SILENT, (None,) * 3], id="told on another night",
        ),
        pytest.param(
            [RAISED | {"reason": "more than 10 %"}], [RAISED], [(CHANGE, "warning", True)],
            id="other words alone",
        ),
        pytest.param([RAISED, GONE], [BASELINE], [SILENT] * 2, id="came and went"),
        pytest.param(
            [RAISED, row(21, "warning", "ok", way="recomputed")], [BASELINE, RAISED],
            [(None,) * 3, (CHANGE, "warning", False)], id="withdrawn: it is told",
        ),
        pytest.param(
            [RAISED, row(32, "warning", "alarm")], [RAISED], [(None,) * 3] * 2,
            id="nights after the last one: as ever",
        ),
        pytest.param(
            [row(15, "insufficient", "ok", "flow_zero")], [], [(CHANGE, "insufficient", True)],
            id="a baseline of a new indicator",
        ),
    ],
)  # fmt: skip
def test_what_of_the_past_is_told(rows: list[Row], published: list[Row], expected: object) -> None:
    assert [marks(one) for one in marked(rows, published, OLD, RULES)] == expected

"""A change of rules tells what stands, once, and marks what it would have told of past nights."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from typing import Any

import pytest

from pipeline.trends.nights.trend_record import Record
from pipeline.trends.rows.alarm_rows import MARKS, change_of_rules, marked, rules_now
from tests.pipeline.trends.nights import motor

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
    assert change_of_rules(Record("", LAST), RULES) == "those of an older version"


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


def test_an_alarm_that_was_told_on_another_night_is_not_told_again() -> None:
    told = row(24, "ok", "warning")
    early, kept = marked([RAISED, told], [BASELINE, told], OLD, RULES)
    assert marks(early) == (CHANGE, "ok", True)
    assert kept == told


def test_other_words_alone_are_silent() -> None:
    (found,) = marked([RAISED | {"reason": "more than 10 %"}], [RAISED], OLD, RULES)
    assert marks(found) == (CHANGE, "warning", True)


def test_an_alarm_that_came_and_went_is_silent() -> None:
    gone = row(22, "warning", "ok", way="recovered")
    assert [marks(one) for one in marked([RAISED, gone], [BASELINE], OLD, RULES)] == [
        (CHANGE, "ok", True),
        (CHANGE, "ok", True),
    ]


def test_a_withdrawn_alarm_is_told() -> None:
    closed = row(21, "warning", "ok", way="recomputed")
    kept, found = marked([RAISED, closed], [BASELINE, RAISED], OLD, RULES)
    assert kept == RAISED
    assert marks(found) == (CHANGE, "warning", False)


@pytest.mark.parametrize("state", ["alarm", "ok"])
def test_nights_after_the_last_one_are_told_as_ever(state: str) -> None:
    tonight = row(32, "warning", state)
    assert marks(marked([RAISED, tonight], [RAISED], OLD, RULES)[1]) == (None,) * 3


def test_a_baseline_of_a_new_indicator_is_silent() -> None:
    new = row(15, "insufficient", "ok", "flow_zero")
    assert marks(marked([new], [], OLD, RULES)[0]) == (CHANGE, "insufficient", True)

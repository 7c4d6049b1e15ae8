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

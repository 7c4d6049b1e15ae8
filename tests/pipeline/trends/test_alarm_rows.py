"""Changes of state: each has a row, and what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.trends.decisions import Decision, read_decisions, record_decision
from pipeline.trends.motor_states import alarm_rows, new_rows, without_past
from tests.pipeline.trends.nights import night_of

Rows = list[dict[str, Any]]
Brief = tuple[int, str, str, str | None]

WORN = ("insufficient", "ok", "ok", "warning", "alarm", "alarm", "ok")
OF_WORN: list[Brief] = [
    (1, "insufficient", "ok", None),
    (3, "ok", "warning", None),
    (4, "warning", "alarm", None),
    (6, "alarm", "ok", "recovered"),
]


def rows_of(
    *states: str, published: Rows | None = None, first: int = 0, news: Sequence[int] = ()
) -> Rows:
    """Rows of states of the leakage in nights in a row; `news` are nights of a detection."""
    nights = [
        {
            "motor_id": "M1",
            "night": night_of(place),
            "state": state,
            "cause": None,
            "sentence": f"it is {state}",
            "advice": f"Look at the {state}." if state == "alarm" else "",
            "detected_on": night_of(place) if place in news else None,
            "still_rising": False,
        }
        for place, state in enumerate(states, start=first)
    ]
    return alarm_rows({"leakage": nights}, published or [])


def brief(rows: Rows) -> list[Brief]:
    return [
        ((row["night"] - night_of(0)).days, row["from_state"], row["to_state"], row["closed_as"])
        for row in rows
    ]


@pytest.mark.parametrize(
    ("before", "states", "news", "expected"),
    [
        pytest.param((), WORN, (), OF_WORN, id="each joins the one before"),
        pytest.param(
            (),
            ("ok", "warning", "warning", "warning"),
            (1, 3),
            [(1, "ok", "warning", None), (3, "warning", "warning", None)],
            id="a further change in a state in force",
        ),
        pytest.param(
            ("ok", "warning", "warning"),
            ("ok", "ok", "warning", "alarm"),
            (),
            [(1, "ok", "warning", None), (3, "warning", "alarm", None)],
            id="raised a night later by better data: not twice",
        ),
        pytest.param(
            WORN,
            ("insufficient", *["ok"] * 6),
            (),
            [*OF_WORN[:3], (5, "alarm", "ok", "recomputed")],
            id="what late data take back stays, and is closed",
        ),
        pytest.param(
            WORN,
            ("insufficient", "ok", "ok", "warning", "common_cause"),
            (),
            [*OF_WORN[:2], (4, "warning", "common_cause", None)],
            id="an alarm that comes out otherwise",
        ),
    ],
)
def test_changes_of_state(
    before: tuple[str, ...], states: tuple[str, ...], news: tuple[int, ...], expected: list[Brief]
) -> None:
    published = rows_of(*before)
    rows = rows_of(*states, published=published, news=news)
    assert brief(rows)[-len(expected) :] == expected
    assert brief(rows_of(*states, published=rows, news=news)) == brief(rows)
    raised = {row["id"] for row in published if row["to_state"] in ("warning", "alarm")}
    assert raised <= {row["id"] for row in rows}


def test_words_of_a_row_end_on_what_to_do_once() -> None:
    alarm = rows_of("ok", "alarm")
    assert [row["sentence"] for row in alarm] == [
        "baseline set: it is ok",
        "it is alarm. Look at the alarm.",
    ]
    otherwise = rows_of("ok", "warning", published=alarm)[-1]["sentence"]
    assert otherwise == "it is warning; before its data changed: it is alarm. Look at the alarm"
    taken_back = rows_of("ok", "ok", "ok", published=alarm)[-1]["sentence"]
    assert taken_back.startswith(f"recomputed: what was raised on {night_of(1)} is not in")


def row(place: int, before: str, after: str, cause: str | None = None) -> dict[str, Any]:
    key = {"id": f"M1 {night_of(place)} {cause or 'leakage'}", "night": night_of(place)}
    state = {"from_state": before, "to_state": after, "cause": cause, "sentence": "so"}
    return key | state | {"closed_as": None}


RAISED, CLOSED = row(5, "ok", "warning"), row(8, "warning", "ok")


@pytest.mark.parametrize(
    ("rows", "published", "places"),
    [
        pytest.param([row(21, "ok", "warning")], [], [21], id="a new night"),
        pytest.param([RAISED], [], [5], id="a past night that is in force"),
        pytest.param([RAISED, CLOSED], [], [], id="one that is over"),
        pytest.param([row(7, "ok", "warning")], [RAISED], [], id="the same, otherwise dated"),
        pytest.param([RAISED, CLOSED], [RAISED], [8], id="one that is taken back"),
        pytest.param([RAISED], [RAISED], [], id="nothing new"),
        pytest.param(
            [RAISED, row(6, "ok", "warning", "flow_zero")], [RAISED], [6], id="a sensor's own"
        ),
    ],
)
def test_what_of_the_past_is_notified(rows: Rows, published: Rows, places: list[int]) -> None:
    new = new_rows(rows, published)
    nights = [row["night"] for row in without_past(rows, new, published, night_of(20))]
    assert nights == [night_of(place) for place in places]
    assert new_rows([RAISED | {"sentence": "in other words"}], [RAISED]) != []


# What people say


WHEN = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
NOTE = 'rings worn; "really", said µ—Å\n2nd line'
SAID = Decision(
    "M1", "K_piston_ring", WHEN, "finding", dt.date(2026, 2, 17), "confirmed", NOTE, "piston_ring"
)


def test_the_oldest_is_first_however_many_write_at_once(tmp_path: Path) -> None:
    assert read_decisions(tmp_path) == ()
    assert list(tmp_path.iterdir()) == []  # where nothing was said nothing is made
    decisions = [
        replace(SAID, motor_id=f"M{number}", time=WHEN + dt.timedelta(hours=-number))
        for number in range(40)
    ]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda decision: record_decision(tmp_path, decision), decisions))
    assert read_decisions(tmp_path) == tuple(reversed(decisions))

"""Rows of `alarms`: every change of state, with its reason; what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.config import MotorSpec
from pipeline.config.hashes import FIGURES_VERSION, READING_VERSION, STATISTICS_VERSION
from pipeline.schema import ALARM_CONTENT
from pipeline.trends.nights.trend_record import TRENDS_VERSION, Record
from pipeline.trends.rows.motor_states import CHANGED

Row = dict[str, Any]

RECOMPUTED, INSUFFICIENT = "recomputed", "insufficient"
RAISED = ("warning", "alarm")
MARKS = ("rules", "state_before_rules", "is_silent")
# Why an indicator is ok again, by the state before.
WHY_OK = {
    INSUFFICIENT: "a baseline was taken",
    "stale": "there are blocks again",
    "common_cause": "the oil circuit is back where it was",
}


@dataclass(frozen=True, slots=True)
class NightState:
    """State of an indicator in a night, with the way into it and the reason in words.

    `is_news`: a change was told in this night, whatever the state before. `advice` says what to do;
    a row that is made of the night ends on it, as mail and web hook tell rows alone.
    """

    night: dt.date
    time: dt.datetime  # the end of the night
    state: str
    way: str
    reason: str
    path: str | None = None
    deviation_percent: float | None = None
    is_news: bool = False
    advice: str = ""


def alarm_rows(
    motor_id: str, states: Mapping[str, Sequence[NightState]], published: Sequence[Row]
) -> list[Row]:
    """Changes of state in some nights, together with what had been raised in them before.

    `states` has by indicator its states in nights in a row, up to the motor's last; `published` all
    rows of the motor so far: those of the nights before say which state was told last.
    """
    by_indicator: dict[str, dict[dt.date, Row]] = {}
    for row in published:
        by_indicator.setdefault(row["indicator"], {})[row["night"]] = row
    nights = next(iter(states.values()))
    gone = [
        NightState(one.night, one.time, INSUFFICIENT, RECOMPUTED, "no longer watched by itself")
        for one in nights
    ]
    # Indicators that are no longer watched are closed.
    every = {name: states.get(name, gone) for name in [*states, *sorted(by_indicator)]}
    return [
        row
        for name, course in every.items()
        for row in _of_indicator(motor_id, name, course, by_indicator.get(name, {}))
    ]


def _of_indicator(
    motor_id: str, name: str, course: Sequence[NightState], published: Mapping[dt.date, Row]
) -> list[Row]:
    before = [night for night in published if night < course[0].night]
    told = str(published[max(before)]["to_state"]) if before else INSUFFICIENT
    last_raised = max(
        (night for night in before if published[night]["to_state"] in RAISED), default=None
    )
    rows, earlier = [], told
    for one in course:
        old = published.get(one.night)
        raised = old if old is not None and old["to_state"] in RAISED else None
        row, advice = None, ""
        has_changed = one.state not in (earlier, told)
        if has_changed or (one.is_news and one.state in CHANGED):
            row, advice = _change(motor_id, name, one, told), one.advice
            if raised is not None and raised["to_state"] != one.state:
                said = str(raised["reason"]).removesuffix(".")
                row["reason"] += f"; before its data changed: {said}"
        elif raised is not None:
            row = raised
        elif told != one.state:
            what = "told before" if last_raised is None else f"raised on {last_raised}"
            what = f"what was {what} is not in the figures as they are now"
            row = _row(motor_id, name, one, told)
            row |= {"reason": f"recomputed: {what}", "way": RECOMPUTED, "path": None}
        if row is not None:
            rows.append(row | {"reason": f"{row['reason']}. {advice}"} if advice else row)
            told = row["to_state"]
            last_raised = one.night if told in RAISED else last_raised
        earlier = one.state
    return rows


def _change(motor_id: str, name: str, one: NightState, before: str) -> Row:
    """The row of a change of state."""
    row = _row(motor_id, name, one, before)
    if one.state == "ok":
        why = WHY_OK.get(before, "back where it was")
        way = "baseline" if before == INSUFFICIENT else "recovered"
        return row | {"reason": f"{why}: {one.reason}", "way": way}
    return row | {"reason": one.reason, "way": one.way}


def _row(motor_id: str, name: str, one: NightState, before: str) -> Row:
    return {
        "motor_id": motor_id,
        "night": one.night,
        "time": one.time,
        "indicator": name,
        "from_state": before,
        "to_state": one.state,
        "deviation_percent": one.deviation_percent,
        "path": one.path,
    }


def rules_now(spec: MotorSpec) -> dict[str, int | str]:
    """Versions of the rules that make a motor's trends from logs, and the form of its model."""
    return {
        "reading": READING_VERSION,
        "statistics": STATISTICS_VERSION,
        "figures": FIGURES_VERSION,
        "trends": TRENDS_VERSION,
        "scale of the rollers": "free" if spec.roller_is_free else "fixed",
    }


def change_of_rules(record: Record | None, now: Mapping[str, int | str]) -> str:
    """Change since a record was written, such as ``trends 5 to 6``; empty: none."""
    if record is None:
        return ""
    return ", ".join(
        f"{name} {record.rules.get(name, '?')} to {version}"
        for name, version in now.items()
        if record.rules.get(name) != version
    )


def marked(
    rows: Sequence[Row],
    published: Sequence[Row],
    record: Record | None,
    now: Mapping[str, int | str],
) -> list[Row]:
    """Rows of `alarms` with the marks of a change of rules since the record, if there is one.

    Rules change with the program, and with a motor whose first nights decide anew on its rollers. A
    receiver is notified of a past night only where the state that stands is not the one told last.

    A row that says what its published one said keeps the marks of that.
    """
    change = change_of_rules(record, now)
    last_night = dt.date.min if record is None else record.last_night
    before = {(row["night"], row["indicator"]): row for row in published}
    last = {row["indicator"]: row["night"] for row in rows if row["night"] <= last_night}
    found = []
    for row in rows:
        night, name = row["night"], row["indicator"]
        old = before.get((night, name))
        marks: Row = dict.fromkeys(MARKS)
        if old is not None and all(row[one] == old.get(one) for one in ALARM_CONTENT):
            marks = {one: old.get(one) for one in MARKS}
        elif change and night <= last_night:
            then, told = (_told(published, name, one) for one in (night, last_night))
            is_news = told != row["to_state"] and (told in CHANGED or row["to_state"] in CHANGED)
            is_silent = not (is_news and night == last[name])
            marks = {"rules": change, "state_before_rules": then, "is_silent": is_silent}
        found.append(row | marks)
    return found


def _told(published: Sequence[Row], name: str, night: dt.date) -> str:
    """State of an indicator in a night, as it was told."""
    rows = [(row["night"], row["to_state"]) for row in published if row["indicator"] == name]
    return max((row for row in rows if row[0] <= night), default=(night, INSUFFICIENT))[1]


def new_alarms(rows: Sequence[Row], published: Sequence[Row]) -> list[Row]:
    """Rows that say something which was not said before, as far as receivers are told of them."""

    def said(row: Row) -> tuple[object, ...]:
        return row["night"], row["indicator"], row["to_state"], row["way"] == RECOMPUTED

    made = {row["night"] for row in rows}
    before = {said(row) for row in published if row["night"] in made}
    return [row for row in rows if not row["is_silent"] and said(row) not in before]

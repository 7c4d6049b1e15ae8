"""Changes of the rules by which trends are made: what they make of past nights is not told again.

Rules change with the program, and with a motor whose first nights decide anew on its rollers.

A receiver is told of a past night only where the state that stands is not the one it was told last.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.config import MotorSpec
from pipeline.config.hashes import FIGURES_VERSION, READING_VERSION, STATISTICS_VERSION
from pipeline.schema import ALARM_CONTENT
from pipeline.trends.nights.trend_record import TRENDS_VERSION, Record
from pipeline.trends.rows.alarm_rows import INSUFFICIENT
from pipeline.trends.states.standing import CHANGED

Row = dict[str, Any]

MARKS = ("rules", "state_before_rules", "is_silent")


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
    if record.rules is None:
        return "those of an older version"
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

"""Rows of `alarms`: every change of state, in words; what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

from pipeline.schema import ALARM_CONTENT, Row
from pipeline.trends.decisions import LEAKAGE, SENSORS
from pipeline.trends.motor_states import ACTIONABLE, CHANGED

RECOMPUTED, RECOVERED, INSUFFICIENT = "recomputed", "recovered", "insufficient"
RAISED = ("warning", "alarm")
# Why a motor or a sensor is ok again, by the state before.
WHY_OK = {
    INSUFFICIENT: "baseline set",
    "stale": "there are blocks again",
    "common_cause": "the oil circuit is back where it was",
}
CHANGES = ("leakage_change_percent", "leakage_change_lower", "leakage_change_upper")


def what_of(row: Mapping[str, Any]) -> str:
    """Return what a row of `alarms` is of: the leakage, or the zero of a sensor."""
    return str(row["cause"]) if row["cause"] in SENSORS else LEAKAGE


def alarm_rows(states: Mapping[str, Sequence[Row]], published: Sequence[Row]) -> list[Row]:
    """Return changes of state in some nights, together with what had been raised in them before.

    `states` has by what they are of the states in nights in a row, up to the motor's last;
    `published` are all rows of the motor so far.
    """
    known: dict[str, dict[dt.date, Row]] = {name: {} for name in states}
    for row in published:
        known[what_of(row)][row["night"]] = row
    return [row for name, nights in states.items() for row in _changes(name, nights, known[name])]


def _changes(name: str, nights: Sequence[Row], published: Mapping[dt.date, Row]) -> Iterator[Row]:
    before = [label for label in published if label < nights[0]["night"]]
    reported = str(published[max(before)]["to_state"]) if before else INSUFFICIENT
    raised_on = max(
        (night for night in before if published[night]["to_state"] in RAISED), default=None
    )
    earlier = reported
    for night in nights:
        label, state = night["night"], night["state"]
        old = published.get(label)
        raised = old if old is not None and old["to_state"] in RAISED else None
        row = None
        if state not in (earlier, reported) or (_is_detected(night) and state in CHANGED):
            row = _row(name, night, reported, _words(night, reported, raised))
            if state == "ok" and reported != INSUFFICIENT:
                row["closed_as"] = RECOVERED
        elif raised is not None:
            row = raised
        elif reported != state:
            what = "reported before" if raised_on is None else f"raised on {raised_on}"
            words = f"recomputed: what was {what} is not in the figures as they are now"
            row = _row(name, night, reported, words) | {"closed_as": RECOMPUTED}
            row["cause"] = name if name in SENSORS else None
        if row is not None:
            yield row
            reported = row["to_state"]
            raised_on = label if reported in RAISED else raised_on
        earlier = state


def _is_detected(night: Row) -> bool:
    """Return True in the night in which a change was detected, whatever the state before."""
    return night.get("detected_on") == night["night"] and not night["still_rising"]


def _words(night: Row, before: str, raised: Row | None) -> str:
    """Return what is reported of a change of state; it ends on what to do."""
    words = str(night["sentence"])
    if night["state"] == "ok":
        words = f"{WHY_OK.get(before, 'back where it was')}: {words}"
    if raised is not None and raised["to_state"] != night["state"]:
        words += f"; before its data changed: {str(raised['sentence']).removesuffix('.')}"
    is_order = night["state"] in ACTIONABLE and night["advice"]
    return f"{words}. {night['advice']}" if is_order else words


def _row(name: str, night: Row, before: str, words: str) -> Row:
    motor_id, label = night["motor_id"], night["night"]
    return {
        "id": f"{motor_id} {label} {name}",
        "motor_id": motor_id,
        "night": label,
        "from_state": before,
        "to_state": night["state"],
        "cause": night["cause"],
        **{change: night.get(change) for change in CHANGES},
        "sentence": words,
        "closed_as": None,
    }


def new_rows(rows: Sequence[Row], published: Sequence[Row]) -> list[Row]:
    """Return rows that say something which was not published before."""
    content = itemgetter(*ALARM_CONTENT)
    before = {row["id"]: content(row) for row in published}
    return [row for row in rows if before.get(row["id"]) != content(row)]


def without_past(
    rows: Sequence[Row], new: Sequence[Row], published: Sequence[Row], last_night: dt.date
) -> list[Row]:
    """Return the new rows to notify people of: of past nights those of the state in force."""
    newest = {what_of(row): row for row in rows if row["night"] <= last_night}
    notified = []
    for row in new:
        what, state = what_of(row), row["to_state"]
        reported = max(
            ((old["night"], old["to_state"]) for old in published if what_of(old) == what),
            default=(last_night, INSUFFICIENT),
        )[1]
        is_in_force = row is newest.get(what) and state != reported
        is_news = is_in_force and (state in CHANGED or reported in CHANGED)
        if row["night"] > last_night or is_news:
            notified.append(row)
    return notified

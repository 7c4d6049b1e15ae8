"""Rows of `alarms`: every change of state, with its reason; what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.config import MotorSpec
from pipeline.config.hashes import FIGURES_VERSION, READING_VERSION, STATISTICS_VERSION
from pipeline.schema import ALARM_CONTENT
from pipeline.trends.figures.indicators import MODEL_MISFIT, TEMPERATURE_EFFECT
from pipeline.trends.nights.segments import segment_at
from pipeline.trends.nights.trend_record import TRENDS_VERSION, Record
from pipeline.trends.states.standing import CHANGED, RAISED, Standing
from pipeline.trends.states.temperature_watch import NOT_TOLD
from pipeline.trends.why.reasons import path_behind, path_named, way_of, why_state

Row = dict[str, Any]

RECOMPUTED = "recomputed"
INSUFFICIENT = "insufficient"
MARKS = ("rules", "state_before_rules", "is_silent")
# Why an indicator is ok again, by the state before.
WHY_OK = {
    INSUFFICIENT: "a baseline was taken",
    "stale": "there is a trusted figure again",
    "duty_outside": "its duty is one that the baseline has seen",
    "common_cause": "the oil circuit is back where it was",
}
# What is judged by rules of its own, in words; the others are zeros of sensors.
OF_OWN_RULES = {
    MODEL_MISFIT: "the model's misfit",
    TEMPERATURE_EFFECT: "the effect of temperature",
}


def alarm_rows(
    standing: Standing, places: Sequence[int], published: Sequence[Row] = ()
) -> list[Row]:
    """Changes of state in some nights, together with what had been raised in them before."""
    rows: list[Row] = []
    by_indicator: dict[str, dict[dt.date, Row]] = {}
    for row in published:
        by_indicator.setdefault(row["indicator"], {})[row["night"]] = row
    names = [*standing.states, *sorted(by_indicator.keys() - standing.states.keys())]
    for name in names:
        rows += _of_indicator(standing, name, places, by_indicator.get(name, {}))
    return rows


def _of_indicator(
    standing: Standing, name: str, places: Sequence[int], published: Mapping[dt.date, Row]
) -> list[Row]:
    states = standing.states.get(name, (INSUFFICIENT,) * len(standing.history))
    first = standing.label(places[0])
    before = [night for night in published if night < first]
    told = str(published[max(before)]["to_state"]) if before else INSUFFICIENT
    last_raised = max(
        (night for night in before if published[night]["to_state"] in RAISED), default=None
    )
    rows = []
    for place in places:
        state, earlier = states[place], states[place - 1] if place else INSUFFICIENT
        label = standing.label(place)
        old = published.get(label)
        raised = old if old is not None and old["to_state"] in RAISED else None
        row = None
        if state != earlier:
            row = _change(standing, name, place, earlier, state)
            if raised is not None and raised["to_state"] != state:
                row["reason"] += f"; before its data changed: {raised['reason']}"
        elif raised is not None:
            row = raised
        elif told != state:
            what = "told before" if last_raised is None else f"raised on {last_raised}"
            what = f"what was {what} is not in the figures as they are now"
            row = _closing(standing, name, place, told, state, what)
        if label == standing.history.nights[-1]:
            later = [said for night, said in sorted(published.items()) if night > label]
            row = _with_withdrawn(standing, name, place, state, row, later)
        if row is not None:
            rows.append(row)
            told = row["to_state"]
            last_raised = label if told in RAISED else last_raised
    return rows


def _change(standing: Standing, name: str, place: int, before: str, after: str) -> Row:
    """The row of a change of state."""
    row = _row(standing, name, place, before, after)
    if name in standing.by_own_rules:
        return row | _by_own_rules(standing, name, place, before, after)
    watched = standing.watched[name]
    deviation = float(watched.found.deviation[place])
    row["deviation_percent"] = None if math.isnan(deviation) else 100.0 * deviation
    if after == "ok":
        why = WHY_OK.get(before, "back below its levels")
        return row | {"reason": why, "way": "baseline" if before == INSUFFICIENT else "recovered"}
    if after == INSUFFICIENT:
        return row | {
            "reason": f"a new baseline begins: {watched.segment(place).reason}",
            "way": "baseline",
        }
    path = path_behind(standing, name, place)
    return row | {
        "reason": why_state(standing, name, place, path),
        "way": way_of(standing, name, place) if after in RAISED else after,
        "path": path_named(standing, name, place, path),
    }


def _by_own_rules(standing: Standing, name: str, place: int, before: str, after: str) -> Row:
    one = standing.by_own_rules[name]
    if after == "common_cause":
        return {"reason": one.words(place), "way": after}
    if after == "warning":
        return {"reason": one.words(place), "way": "change" if name == MODEL_MISFIT else "drift"}
    if after == INSUFFICIENT:
        part = segment_at(one.segments, place)
        if place > part.first:
            return {"reason": NOT_TOLD, "way": "baseline"}
        return {"reason": f"a new baseline begins: {part.reason}", "way": "baseline"}
    what = OF_OWN_RULES.get(name, "its zero")
    if before == INSUFFICIENT:
        return {"reason": f"{what} is known", "way": "baseline"}
    return {"reason": f"{what} is back where it was", "way": "recovered"}


def _with_withdrawn(
    standing: Standing, name: str, place: int, state: str, row: Row | None, later: Sequence[Row]
) -> Row | None:
    """The row of the last night, where there is one, once what was told of later ones is gone."""
    raised = [one for one in later if one["to_state"] in RAISED]
    if not raised and (not later or later[-1]["to_state"] == state):
        return row
    what = f"the nights after {standing.label(place)} are withdrawn: no log has samples of them"
    what += "".join(f"; {one['to_state']} on {one['night']}: {one['reason']}" for one in raised)
    if row is not None:
        return row | {"reason": f"{row['reason']}; {what}"}
    return _closing(standing, name, place, later[-1]["to_state"], state, what)


def _closing(standing: Standing, name: str, place: int, told: str, state: str, what: str) -> Row:
    """The row that says which state an indicator is in, where published rows say another."""
    row = _row(standing, name, place, told, state)
    return row | {"reason": f"recomputed: {what}", "way": RECOMPUTED}


def _row(standing: Standing, name: str, place: int, before: str, after: str) -> Row:
    return {
        **standing.key(place),
        "time": standing.end_of(place),
        "indicator": name,
        "from_state": before,
        "to_state": after,
        "deviation_percent": None,
        "path": None,
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

    Rules change with the program, and with a motor whose first nights decide anew on its rollers. A
    receiver is told of a past night only where the state that stands is not the one told last.

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

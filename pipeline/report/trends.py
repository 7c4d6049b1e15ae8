"""Trends, alarms, baselines and change points of a motor, where a run has left such tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import polars as pl

from pipeline.report.encoding import numbers
from pipeline.report.words import plain

Payload = dict[str, Any]

# Worst first: the state of a motor is the worst of its indicators'.
STATES = ("alarm", "warning", "common_cause", "stale", "insufficient", "ok")
WITHIN = "all indicators within their limits"
# Of the newest night of an indicator, beside its course.
LATEST = (
    "baseline_mean",
    "slope_per_year",
    "slope_per_year_lower",
    "slope_per_year_upper",
    "slope_per_1000_h",
    "slope_per_1000_h_lower",
    "slope_per_1000_h_upper",
    "provisional",
    "p_value",
    "q_value",
    "state",
    "gated_reason",
    "path",
    "path_probability",
    "days_to_limit",
    "days_to_limit_lower",
    "days_to_limit_upper",
    "days_to_limit_status",
)
COURSES = ("value", "lower", "upper", "baseline_mean", "warning_limit", "alarm_limit", "cusum")


@dataclass(frozen=True, slots=True)
class Standing:
    """The worst state among a motor's indicators in its newest night of trends.

    Attributes
    ----------
    state
        One of `STATES`.
    reason
        Why, in words.
    """

    state: str
    reason: str


def standings(trends: Mapping[str, pl.DataFrame]) -> dict[str, Standing]:
    """The standing of each motor that has trends."""
    rows = trends.get("trends")
    if rows is None:
        return {}
    newest = rows.filter(pl.col("night") == pl.col("night").max().over("motor_id"))
    alarms = _last_words(trends.get("alarms"))
    found: dict[str, Standing] = {}
    order = {state: place for place, state in enumerate(STATES)}
    for row in newest.sort("motor_id", "indicator").to_dicts():
        motor_id, state = row["motor_id"], row["state"]
        known = found.get(motor_id)
        if state not in order or (known and order[known.state] <= order[state]):
            continue
        said = None if state == "ok" else alarms.get((motor_id, row["indicator"], state))
        told = WITHIN if state == "ok" else f"{plain(row['indicator'])}: {plain(state)}"
        found[motor_id] = Standing(state, said or told)
    return found


def _last_words(alarms: pl.DataFrame | None) -> dict[tuple[str, str, str], str]:
    """The newest reason for each motor, indicator and state that was entered."""
    if alarms is None:
        return {}
    return {
        (row["motor_id"], row["indicator"], row["to_state"]): row["reason"]
        for row in alarms.sort("time").to_dicts()
    }


def trend_payload(motor_id: str, trends: Mapping[str, pl.DataFrame]) -> Payload:
    """What a motor's page shows of its trends; empty lists where there is nothing.

    Parameters
    ----------
    motor_id
        The motor.
    trends
        The tables of trends by name, of all motors.
    """
    own = {
        name: rows.filter(pl.col("motor_id") == motor_id).drop("run_id", "motor_id", strict=False)
        for name, rows in trends.items()
    }
    return {
        "indicators": _indicators(own.get("trends")),
        **{name: _records(own.get(name)) for name in ("alarms", "baselines")},
        "change_points": _records(_as_seen_last(own.get("change_points"))),
    }


def _as_seen_last(changes: pl.DataFrame | None) -> pl.DataFrame | None:
    """Change points as the newest night saw them, at the nights of the changes."""
    if changes is None or changes.is_empty():
        return None
    newest = changes.filter(pl.col("night") == pl.col("night").max())
    return newest.drop("night").rename({"change_night": "night"})


def _indicators(rows: pl.DataFrame | None) -> list[Payload]:
    if rows is None:
        return []
    return [
        _indicator(part)
        for part in rows.sort("indicator", "night").partition_by("indicator", maintain_order=True)
    ]


def _indicator(rows: pl.DataFrame) -> Payload:
    last = rows.row(-1, named=True)
    return {
        "indicator": last["indicator"],
        "unit": last["unit"],
        "nights": [night.isoformat() for night in rows["night"]],
        "state": rows["state"].to_list(),
        **{
            name: numbers(rows[name].cast(pl.Float64).to_numpy())
            for name in _present(COURSES, rows)
        },
        "latest": {name: last[name] for name in _present(LATEST, rows) if last[name] is not None},
    }


def _present(names: Iterable[str], rows: pl.DataFrame) -> list[str]:
    return [name for name in names if name in rows.columns]


def _records(rows: pl.DataFrame | None) -> list[Payload]:
    if rows is None:
        return []
    return [
        {name: _plain_value(value) for name, value in row.items() if value is not None}
        for row in rows.to_dicts()
    ]


def _plain_value(value: Any) -> Any:
    return value.isoformat() if hasattr(value, "isoformat") else value

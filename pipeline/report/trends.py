"""Trends, alarms, baselines, change points and decisions of a motor, as its page shows them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import polars as pl

from pipeline.report.encoding import numbers, whole_numbers
from pipeline.report.status import ORDER, motor_state
from pipeline.report.tables import History
from pipeline.thinning import keep_extremes
from pipeline.trends.decisions import Decision
from pipeline.trends.words import name_of

Payload = dict[str, Any]

# A motor has some fifteen indicators; of each no more nights are drawn than that, extremes kept.
PLOTTED_NIGHTS = 600
WITHIN = "all indicators within their limits"
# Of the newest night of an indicator, beside its course.
LATEST = (
    "baseline_mean",
    "deviation_percent",
    "slope_per_year",
    "slope_per_year_lower",
    "slope_per_year_upper",
    "slope_per_1000_h",
    "slope_per_1000_h_lower",
    "slope_per_1000_h_upper",
    "n_slope",
    "provisional",
    "q_value",
    "state",
    "state_reason",
    "gated_reason",
    "path",
    "path_probability",
    "path_reason",
    "days_to_limit",
    "days_to_limit_lower",
    "days_to_limit_upper",
    "days_to_limit_status",
)
COURSES = (
    "value",
    "lower",
    "upper",
    "baseline_mean",
    "warning_limit",
    "alarm_limit",
    "cusum",
    "cusum_limit",
)


@dataclass(frozen=True, slots=True)
class Standing:
    """How a motor stands by the alarm rules.

    Attributes
    ----------
    state
        One of `pipeline.report.status.ORDER`.
    reason
        Why, in words, and what somebody said of it.
    sensor_health
        ok, drifted or unknown.
    deviation_percent
        How far the leakage is from its baseline; None where there is none.
    leakage_is_known, leakage_night
        Whether the reference leakage is known now, and the last night that it was.
    change_start
        First night of the newest change that stands told; None where none does.
    """

    state: str
    reason: str
    sensor_health: str = "unknown"
    deviation_percent: float | None = None
    leakage_is_known: bool = False
    leakage_night: dt.date | None = None
    change_start: dt.date | None = None


def standings(history: History) -> dict[str, Standing]:
    """The standing of each motor that has trends, the same that `motor-leakage status` prints."""
    trends = history.trends.get("trends")
    if trends is None:
        return {}
    fits = {part["motor_id"][0]: part for part in history.fits.partition_by("motor_id")}
    found = {}
    for rows in trends.partition_by("motor_id"):
        motor_id = rows["motor_id"][0]
        said = [one for one in history.decisions if one.motor_id == motor_id]
        own_fits = fits.get(motor_id, history.fits.clear())
        state = motor_state(motor_id, rows, own_fits, said)
        reason = state.reason or (WITHIN if state.state == "ok" else "")
        if state.acknowledged:
            reason += f" (acknowledged: {state.acknowledged})"
        found[motor_id] = Standing(
            state=state.state,
            reason=reason,
            sensor_health=state.sensor_health or "unknown",
            deviation_percent=state.deviation_percent,
            leakage_is_known=state.leakage_l_per_min is not None,
            leakage_night=state.leakage_night,
            change_start=state.change_start,
        )
    return found


def trend_payload(motor_id: str, history: History) -> Payload:
    """What a motor's page shows of its trends; empty lists where there is nothing."""
    own = {
        name: rows.filter(motor_id=motor_id).drop("run_id", "motor_id")
        for name, rows in history.trends.items()
    }
    return {
        "order": ORDER,
        "indicators": _indicators(own.get("trends")),
        "alarms": _records(own.get("alarms")),
        "baselines": _baselines_in_use(own.get("baselines")),
        "change_points": _newest_change_points(own.get("change_points")),
        "decisions": _decisions(motor_id, history.decisions),
    }


def _indicators(rows: pl.DataFrame | None) -> list[Payload]:
    """Those that ask for attention first; before others those that alarms are raised on."""
    if rows is None:
        return []
    ordered = rows.sort("indicator", "night")
    indicators = [
        _indicator(part) for part in ordered.partition_by("indicator", maintain_order=True)
    ]
    return sorted(
        indicators,
        key=lambda one: (ORDER.index(one["latest"]["state"]), "n_slope" not in one["latest"]),
    )


def _indicator(rows: pl.DataFrame) -> Payload:
    last = rows.row(-1, named=True)
    columns = {name: rows[name].cast(pl.Float64).to_numpy() for name in COURSES}
    places = keep_extremes(np.column_stack([columns["value"], columns["cusum"]]), PLOTTED_NIGHTS)
    states = rows["state"].to_list()
    return {
        "indicator": last["indicator"],
        "name": name_of(last["indicator"]),
        "unit": last["unit"],
        "days": whole_numbers(rows["night"].to_physical().to_numpy()[places]),
        # A digit for each night: the place of its state in the order of urgency.
        "states": "".join(str(ORDER.index(states[place])) for place in places.tolist()),
        **{name: numbers(values[places]) for name, values in columns.items()},
        "latest": {name: last[name] for name in LATEST if last[name] is not None},
    }


def _baselines_in_use(rows: pl.DataFrame | None) -> list[Payload]:
    """The baseline of each indicator that was frozen last."""
    if rows is None:
        return []
    return _records(rows.sort("indicator", "night").unique("indicator", keep="last"))


def _newest_change_points(rows: pl.DataFrame | None) -> list[Payload]:
    """Change points as the newest night sees them."""
    if rows is None:
        return []
    newest = pl.col("night") == pl.col("night").max().over("indicator")
    return _records(rows.filter(newest).sort("indicator", "change_night"))


def _decisions(motor_id: str, decisions: Sequence[Decision]) -> list[Payload]:
    return [_plain(asdict(one).items()) for one in decisions if one.motor_id == motor_id]


def _records(rows: pl.DataFrame | None) -> list[Payload]:
    return [] if rows is None else [_plain(row.items()) for row in rows.to_dicts()]


def _plain(items: Iterable[tuple[str, Any]]) -> Payload:
    """Values as JSON has them, dates as text; those that are absent are left out."""
    return {
        name: value.isoformat() if hasattr(value, "isoformat") else value
        for name, value in items
        if value is not None
    }

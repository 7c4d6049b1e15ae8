"""Trends, baselines, change points and changes of state of a motor, as its page shows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import polars as pl

from pipeline.report.encoding import numbers, whole_numbers
from pipeline.report.history import MotorHistory
from pipeline.report.tables import ReportTables
from pipeline.report.words import plain
from pipeline.schema import ALARMS, BASELINES, CHANGE_POINTS, TRENDS
from pipeline.thinning import keep_extremes
from pipeline.trends.rows import latest_states
from pipeline.trends.rows.motor_states import ORDER, LookStanding, MotorState
from pipeline.trends.states.words import limit_dates, name_of

Payload = dict[str, Any]

# A motor has some fifteen indicators; of each no more nights are drawn than that, extremes kept.
PLOTTED_NIGHTS = 600
# Indicators that the first screen shows.
FIRST_SCREEN = ("gap_change_", "leakage_")
# Of changes of state a page lists the newest.
SHOWN_CHANGES = 200
# Of the newest night of an indicator, beside its course.
LATEST = (
    "deviation_percent",
    "slope_per_year",
    "slope_per_year_lower",
    "slope_per_year_upper",
    "slope_per_1000_h",
    "slope_per_1000_h_lower",
    "slope_per_1000_h_upper",
    "n_slope",
    "q_value",
    "state",
    "state_reason",
    "gated_reason",
    "path",
    "path_probability",
    "path_reason",
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


def motor_states(
    history: ReportTables, motors: Iterable[str], looks: Mapping[str, LookStanding]
) -> dict[str, MotorState]:
    """The state of each motor, the same that `motor-leakage status` prints."""
    found = latest_states.motor_states(
        [*motors], history.rows(TRENDS), history.fits, history.decisions
    )
    return {one.motor_id: replace(one, look=looks.get(one.motor_id)) for one in found}


def trend_payload(motor: MotorHistory, history: ReportTables) -> Payload:
    """Trends of a motor for its page; empty lists where there are none."""
    baselines, change_points = (
        history.rows(table).filter(motor_id=motor.motor_id).drop("run_id", "motor_id")
        for table in (BASELINES, CHANGE_POINTS)
    )
    return {
        "order": ORDER,
        "indicators": _indicators(motor),
        "baselines": _baselines_in_use(baselines),
        "change_points": _newest_change_points(change_points),
    }


def changes_of_state(motor_id: str, history: ReportTables) -> list[dict[str, Any]]:
    """A motor's newest rows of `alarms`, the newest first."""
    rows = history.rows(ALARMS).filter(motor_id=motor_id)
    return rows.sort("time", "indicator", descending=[True, False]).head(SHOWN_CHANGES).to_dicts()


def _indicators(motor: MotorHistory) -> list[Payload]:
    """Those that ask for attention first; before others those that alarms are raised on."""
    indicators = [
        _indicator(rows) for name, rows in motor.trends.items() if not name.startswith(FIRST_SCREEN)
    ]
    return sorted(
        indicators,
        key=lambda one: (ORDER.index(one["latest"]["state"]), "n_slope" not in one["latest"]),
    )


def _indicator(rows: pl.DataFrame) -> Payload:
    last = rows.row(-1, named=True)
    columns = {name: rows[name].cast(pl.Float64).to_numpy() for name in COURSES}
    places = keep_extremes([columns["value"], columns["cusum"]], PLOTTED_NIGHTS)
    states = rows["state"].to_list()
    return {
        "indicator": last["indicator"],
        "name": _name(last["indicator"]),
        "unit": last["unit"],
        "days": whole_numbers(rows["night"].to_physical().to_numpy()[places]),
        # A digit for each night: the place of its state in the order of urgency.
        "states": "".join(str(ORDER.index(states[place])) for place in places.tolist()),
        **{name: numbers(values[places]) for name, values in columns.items()},
        "latest": {name: last[name] for name in LATEST if last[name] is not None},
        "limitDates": limit_dates(last),
    }


def _name(indicator: str) -> str:
    """An indicator's name for analysts, who know K."""
    path = indicator.removeprefix("K_")
    return name_of(indicator) if path == indicator else f"K of the {plain(path)}"


def _baselines_in_use(rows: pl.DataFrame) -> list[Payload]:
    """The baseline of each indicator that was frozen last."""
    return _records(rows.sort("indicator", "night").unique("indicator", keep="last"))


def _newest_change_points(rows: pl.DataFrame) -> list[Payload]:
    """Change points as the newest night sees them."""
    newest = pl.col("night") == pl.col("night").max().over("indicator")
    return _records(rows.filter(newest).sort("indicator", "change_night"))


def _records(rows: pl.DataFrame) -> list[Payload]:
    """Rows as JSON has them, dates as text; what is absent is left out."""
    return [
        {
            name: value.isoformat() if hasattr(value, "isoformat") else value
            for name, value in row.items()
            if value is not None
        }
        for row in rows.to_dicts()
    ]

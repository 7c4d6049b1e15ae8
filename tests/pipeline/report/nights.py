"""Rows of `fits`, `watch` and `trends` made by hand, and the history that they come to."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from typing import Any
from zoneinfo import ZoneInfo

import polars as pl

from pipeline.report.fleet_page import FleetRow
from pipeline.report.pages import page_of
from pipeline.report.tables import MotorHistory
from pipeline.schema import BASELINES, FITS, TRENDS, WATCH, frame

Row = dict[str, Any]
FIRST = dt.date(2026, 1, 1)
ONE_DAY = dt.timedelta(days=1)


def fit(number: int, **values: Any) -> Row:
    """A fitted night, the first one being number 0."""
    row = {"motor_id": "M", "motor_type": "CB560", "night": FIRST + number * ONE_DAY}
    row |= {"flushing_mode": "none", "is_primary": True, "status": "ok", "kept_share": 0.97}
    return row | {"mean_flow_l_per_min": 5.0} | values


def unfitted(number: int, status: str, reason: str) -> Row:
    """A night without a fit."""
    return fit(number, status=status, reason=reason, kept_share=None, mean_flow_l_per_min=None)


def trend(number: int, indicator: str, value: float | None, **more: Any) -> Row:
    """A row of `trends`."""
    row = {"motor_id": "M", "night": FIRST + number * ONE_DAY, "indicator": indicator}
    return row | {"value": value} | more


def watch(number: int, leakage: float | None, **more: Any) -> Row:
    """A row of `watch`."""
    row = {"motor_id": "M", "night": FIRST + number * ONE_DAY, "state": "ok"}
    return row | {"own_leakage_l_per_min": leakage} | more


def baseline(mean: float) -> Row:
    """A row of `baselines` of the first two nights."""
    row = {"motor_id": "M", "night": FIRST + ONE_DAY, "indicator": "leakage", "mean": mean}
    return row | {"start": FIRST, "end": FIRST + ONE_DAY}


def history(
    fits: Sequence[Row],
    watches: Sequence[Row] = (),
    trends: Sequence[Row] = (),
    motor_id: str = "M",
    baselines: Sequence[Row] = (),
) -> MotorHistory:
    """The history of the one motor that the rows are of."""
    indicators = {row["indicator"] for row in trends}
    courses = frame(TRENDS, trends).sort("night")
    return MotorHistory(
        motor_id,
        frame(FITS, fits).sort("night"),
        frame(WATCH, watches).sort("night"),
        {name: courses.filter(pl.col("indicator") == name) for name in indicators},
        frame(BASELINES, baselines),
    )


def fleet_page(rows: Sequence[FleetRow], undelivered: Sequence[str] = ()) -> str:
    """The fleet's page of some rows."""
    facts = dict.fromkeys(("first", "newest", "made"))
    facts |= {"name": "F", "zone": ZoneInfo("UTC"), "old_after_nights": 7}
    facts |= {"undelivered": undelivered}
    return page_of("fleet.html", facts=facts, rows=rows, counts=[])

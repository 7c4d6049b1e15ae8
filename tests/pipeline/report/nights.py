"""Rows of `fits`, `watch` and `trends` made by hand, and the history that they come to."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from typing import Any

from pipeline.report.history import MotorHistory, motor_histories
from pipeline.report.tables import ReportTables
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
    tables = ReportTables(
        fits=frame(FITS, fits).sort("motor_id", "night"),
        trends={
            "trends": frame(TRENDS, trends),
            "watch": frame(WATCH, watches),
            "baselines": frame(BASELINES, baselines),
        },
    )
    (motor,) = motor_histories(tables, [motor_id])
    return motor

"""Rows of `fits` and `trends` made by hand, and the history that they come to."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from typing import Any

from pipeline.report.history import MotorHistory, motor_histories
from pipeline.report.tables import ReportTables
from pipeline.schema import FITS, TRENDS, frame

Row = dict[str, Any]
FIRST = dt.date(2026, 1, 1)
ONE_DAY = dt.timedelta(days=1)


def fit(number: int, leakage: float | None = 1.4, **values: Any) -> Row:
    """A fitted night, the first one being number 0."""
    row = {"motor_id": "M", "motor_type": "CB560", "night": FIRST + number * ONE_DAY}
    row |= {"flushing_mode": "none", "is_primary": True, "status": "ok", "kept_share": 0.97}
    for end, factor in (("l_per_min", 1.0), ("lower", 0.99), ("upper", 1.01)):
        row[f"reference_leakage_{end}"] = None if leakage is None else factor * leakage
    return row | values


def unfitted(number: int, status: str, reason: str) -> Row:
    """A night without a fit."""
    return fit(number, None, status=status, reason=reason, kept_share=None)


def trend(number: int, indicator: str, value: float | None, **more: Any) -> Row:
    """A row of `trends`."""
    row = {"motor_id": "M", "night": FIRST + number * ONE_DAY, "indicator": indicator}
    return row | {"value": value, "state": "ok"} | more


def history(fits: Sequence[Row], trends: Sequence[Row] = (), motor_id: str = "M") -> MotorHistory:
    """The history of the one motor that the rows are of."""
    tables = ReportTables(
        fits=frame(FITS, fits).sort("motor_id", "night"),
        trends={"trends": frame(TRENDS, trends)},
    )
    (motor,) = motor_histories(tables, [motor_id])
    return motor

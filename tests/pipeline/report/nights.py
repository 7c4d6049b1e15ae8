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
    return {
        "motor_id": "M",
        "motor_type": "CB560",
        "night": FIRST + number * ONE_DAY,
        "flushing_mode": "none",
        "is_primary": True,
        "status": "ok",
        "reference_leakage_l_per_min": leakage,
        "reference_leakage_lower": None if leakage is None else 0.99 * leakage,
        "reference_leakage_upper": None if leakage is None else 1.01 * leakage,
        "kept_share": 0.97,
    } | values


def unfitted(number: int, status: str, reason: str) -> Row:
    """A night without a fit."""
    row = fit(number, None, status=status, reason=reason)
    return row | {"kept_share": None}


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

"""A fleet of which a run has judged thirty nights: worn, healthy and young motors."""

from __future__ import annotations

import datetime as dt
import shutil
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import polars as pl

from pipeline.report.build import KnownMotor, ReportRequest, build_report
from pipeline.schema import ALARMS, BASELINES, CHANGE_POINTS, TRENDS, frame
from pipeline.store.encoding import write_table
from pipeline.store.tables import night_file
from pipeline.trends.nights.decisions import Decision, record_decision
from tests.pipeline.report.conftest import change_table, rows_with

NIGHTS = ["2026-01-02", "2026-01-03", "2026-01-04"]

KEY = {"motor_id": "CB560-01", "indicator": "K_piston_ring"}
RING, OWN = 5e-14, 2.0
NOTE = "a new ring <b>is ordered</b>"
REASON = "piston ring gap +14 % [13, 16] since 2 January 2026; reference leakage +1 %"
# As a run leaves them that has judged thirty nights; the demo's three are too few.


def levels(mean: float) -> dict[str, float]:
    return {"baseline_mean": mean, "warning_limit": 1.15 * mean, "alarm_limit": 1.3 * mean}


def raised(mean: float, times: float, reason: str) -> dict[str, Any]:
    """An alarm of an indicator at some times its baseline."""
    value = {"value": times * mean, "lower": (times - 0.1) * mean, "upper": (times + 0.1) * mean}
    alarm = {"state": "alarm", "state_reason": reason, "gated_reason": None}
    return value | levels(mean) | alarm


# Too few nights since the change for days to a limit; its levels stand.
COURSE = {"deviation_percent": 50.0, "limit": None, "days_to_limit_status": "already_crossed"}
COURSE |= {"cusum": 9.0, "cusum_limit": 7.0, "slope_per_year": 4e-14}
COURSE |= {"slope_per_year_lower": 3e-14, "slope_per_year_upper": 5e-14}
OWN_REASON = "leakage at the motor's own conditions +60 % [50, 70] since 2 January 2026"
JUDGED: dict[tuple[str, str], dict[str, Any]] = {
    ("CB400-01", f"K_{path}"): levels(RING) | {"state": "ok", "state_reason": None}
    for path in ("piston_ring", "balance_piston", "balance_sleeve")
}
JUDGED["CB560-01", "K_piston_ring"] = raised(RING, 1.5, REASON) | COURSE
JUDGED["CB1120-02", "own_reference_leakage"] = raised(OWN, 1.6, OWN_REASON)


def judged(rows: pl.DataFrame) -> pl.DataFrame:
    """Trends with an alarm of a ring, one at the motor's own conditions, and a healthy motor."""
    for (motor, indicator), figures in JUDGED.items():
        rows = rows_with(motor, pl.col("indicator") == indicator, **figures)(rows)
    gaps = [
        {"motor_id": motor, "indicator": f"gap_change_{path}", "night": rows["night"][0]}
        | {"value": value, "lower": value - 1.0, "upper": value + 1.0, "unit": "%", "state": "ok"}
        for motor, path, value in (
            ("CB560-01", "piston_ring", 14.5),
            ("CB400-01", "piston_ring", 0.4),
            ("CB400-01", "balance_sleeve", -0.3),
        )
    ]
    return pl.concat([rows, frame(TRENDS, gaps)])


def judged_report(fitted_output: Path, output: Path) -> Path:
    """The report of a fleet with a worn, a healthy, a one-pressure and young motors."""
    shutil.copytree(fitted_output / "tables", output / "tables")
    change_table(output, "trends", judged)
    nights = [dt.date.fromisoformat(night) for night in NIGHTS]
    change = KEY | {"night": nights[2], "change_night": nights[1], "size_percent": 50.0}
    alarm = KEY | {"night": nights[2], "time": dt.datetime(2026, 1, 4, 6, tzinfo=dt.UTC)}
    alarm |= {"from_state": "ok", "to_state": "alarm", "reason": REASON}
    baseline = KEY | {"night": nights[1], "start": nights[0], "end": nights[1], "mean": RING}
    for table, row in {
        CHANGE_POINTS: change | {"model": "step"},
        ALARMS: alarm,
        BASELINES: baseline,
    }.items():
        write_table(night_file(output, table, nights[2]), frame(table, [row]))
    said = dt.datetime(2026, 1, 5, 9, tzinfo=dt.UTC)
    record_decision(
        output,
        Decision(KEY["motor_id"], KEY["indicator"], said, "acknowledged", nights[2], note=NOTE),
    )
    paths = ("piston_ring", "balance_piston", "balance_sleeve", "cam_roller")
    known = {"CB560-01": KnownMotor("CB560", paths=paths)}
    made = dt.datetime(2026, 1, 5, 11, tzinfo=dt.UTC)
    zone = ZoneInfo("Europe/Stockholm")
    build_report(ReportRequest(output, output / "report", known=known, made=made, zone=zone))
    return output / "report"

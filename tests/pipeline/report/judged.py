"""A fleet whose watch has told of a worn motor, beside a healthy one and young ones."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import replace
from pathlib import Path

from pipeline.report.build import build_report
from pipeline.schema import ALARMS, BASELINES, TRENDS, WATCH, frame
from pipeline.trends.nights.decisions import Decision, record_decision
from pipeline.trends.rows.motor_states import MotorState
from tests.pipeline.report.conftest import demo_fleet
from tests.pipeline.report.states import SENTENCES, publish_latest, state_of, watched
from tests.pipeline.written import write_nights

NIGHTS = ["2026-01-02", "2026-01-03", "2026-01-04"]
WORN, HEALTHY = "CB560-01", "CB400-01"
YOUNG = ("CB1120-01", "CB1120-02", "CB400-02", "CB560-02")
NOTE = "new sleeves <b>are ordered</b>"
REASON = SENTENCES["alarm"]


def states() -> list[MotorState]:
    """As a run leaves them that has watched thirty nights; the demo's three are too few."""
    young = [MotorState(one, "insufficient", "3 of 8 nights", "Wait.") for one in YOUNG]
    return [state_of(WORN, "alarm", acknowledged=NOTE), state_of(HEALTHY), *young]


def judged_report(fitted_output: Path, output: Path) -> Path:
    """The report of a fleet with a worn, a healthy and young motors."""
    shutil.copytree(fitted_output / "tables", output / "tables")
    shutil.rmtree(output / "tables" / "watch", ignore_errors=True)
    nights = [dt.date.fromisoformat(night) for night in NIGHTS]
    gaps = ((WORN, "balance_sleeve", 6.5), (HEALTHY, "piston_ring", 0.4))
    for place, night in enumerate(nights):
        watch = [watched(WORN, place, "alarm"), watched(HEALTHY, place)]
        write_nights(output, WATCH, frame(WATCH, [one.row for one in watch]))
        rows = [
            {"motor_id": motor, "indicator": f"gap_change_{path}", "night": night, "unit": "%"}
            | {"value": value, "lower": value - 1.0, "upper": value + 1.0}
            for motor, path, value in gaps
        ]
        write_nights(output, TRENDS, frame(TRENDS, rows))
    baseline = {"night": nights[1], "start": nights[0], "end": nights[1], "mean": 2.0}
    rows = [baseline | {"motor_id": one, "indicator": "leakage"} for one in (HEALTHY, WORN)]
    write_nights(output, BASELINES, frame(BASELINES, rows))
    alarm = {"motor_id": WORN, "indicator": "leakage", "night": nights[2], "reason": REASON}
    alarm |= {"time": dt.datetime(2026, 1, 4, 6, tzinfo=dt.UTC)}
    alarm |= {"from_state": "ok", "to_state": "alarm"}
    write_nights(output, ALARMS, frame(ALARMS, [alarm]))
    publish_latest(output, states())
    said = dt.datetime(2026, 1, 5, 9, tzinfo=dt.UTC)
    record_decision(output, Decision(WORN, "leakage", said, "acknowledged", nights[2], note=NOTE))
    seen = Decision(WORN, "", said, "finding", nights[2], None, "", "balance_sleeve", "piston_ring")
    record_decision(output, seen)
    fleet = demo_fleet(output)
    nights_of = fleet.settings.nights.model_copy(update={"time_zone": "Europe/Stockholm"})
    settings = fleet.settings.model_copy(update={"nights": nights_of})
    made = dt.datetime(2026, 1, 5, 11, tzinfo=dt.UTC)
    build_report(replace(fleet, settings=settings), output / "report", made=made)
    return output / "report"

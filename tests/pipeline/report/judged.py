"""A fleet whose watch has told of a worn motor, beside a healthy one and young ones."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.report.build import build_report
from pipeline.schema import ALARMS, LATEST, TRENDS, frame
from pipeline.schema import NIGHTS as NIGHT_TABLE
from pipeline.store.tables import read_table, whole_file
from pipeline.trends.decisions import Decision, record_decision
from tests.pipeline.report.conftest import demo_fleet
from tests.pipeline.written import night_file, write_nights, write_table

NIGHTS = ["2026-01-02", "2026-01-03", "2026-01-04"]
WORN, HEALTHY = "CB560-01", "CB400-01"
YOUNG = ("CB1120-01", "CB1120-02", "CB400-02", "CB560-02")
NOTE = "new sleeves <b>are ordered</b>"
REASON = "leakage +21 % [17, 25] tonight, since 4 January 2026 [3, 5]: balance sleeve"
HEADLINE = "Leakage +21 % [17, 25] since 4 January 2026, balance sleeve."
ADVICE = "Inspect the balance piston, the balance sleeve and the piston ring at the next stop."
ONSET, DETECTED, NEWEST = (dt.date(2026, 1, day) for day in (4, 5, 7))
Row = dict[str, Any]
# Figures of a night of a motor that has not changed, and what is otherwise in the worn one.
FIGURES: Row = {
    "state": "ok",
    "sentence": "no change detected since 2 January 2026",
    "advice": "Nothing to do.",
    "evidence": 2.5,
    "evidence_limit": 9.1,
    "model_error_percent": 0.4,
    "leakage_change_percent": 1.0,
    "leakage_change_lower": -1.0,
    "leakage_change_upper": 3.0,
    "own_leakage_l_per_min": 2.02,
    "own_leakage_lower": 1.98,
    "own_leakage_upper": 2.06,
    "own_pressure_bar": 150.0,
    "own_temperature_c": 48.0,
    "own_speed_rpm": 26.0,
    "detection_limit_percent": 3.0,
    "alarm_level_percent": 30.0,
    "baseline_start": dt.date(2026, 1, 2),
    "baseline_end": dt.date(2026, 1, 3),
}
CHANGED: Row = {
    "state": "alarm",
    "sentence": REASON,
    "advice": ADVICE,
    "evidence": 31.0,
    "cause": "balance_sleeve",
    "cause_probability": 0.95,
    "candidates": [
        {"cause": "balance_sleeve", "probability": 0.95},
        {"cause": "all_gaps", "probability": 0.04},
    ],
    "leakage_change_percent": 21.0,
    "leakage_change_lower": 17.0,
    "leakage_change_upper": 25.0,
    "own_leakage_l_per_min": 2.42,
    "own_leakage_lower": 2.34,
    "own_leakage_upper": 2.5,
    "onset": ONSET,
    "detected_on": DETECTED,
    "still_rising": False,
}
YOUNGER: Row = {
    "state": "insufficient",
    "sentence": "3 of 8 nights",
    "advice": "Wait.",
    "own_leakage_l_per_min": None,
}
OF_MOTOR = {WORN: FIGURES | CHANGED, HEALTHY: FIGURES} | dict.fromkeys(YOUNG, FIGURES | YOUNGER)


def publish_latest(output: Path, note: str | None = None) -> None:
    """Write `latest` as a run leaves it that has watched thirty nights; `note` is on the alarm."""
    dates = {"night": NEWEST, "last_fit_night": NEWEST, "state_since": DETECTED}
    ended = {"last_sample": dt.datetime.combine(NEWEST, dt.time(5), dt.UTC), "data_age_nights": 0}
    of_each = {"status": "ok", "flushing_mode": "none", "motor_type": "CB560", "run_id": "r"}
    rows = [{"motor_id": name} | of_each | dates | ended | of for name, of in OF_MOTOR.items()]
    rows[0]["acknowledged"] = note
    write_table(whole_file(output, LATEST), frame(LATEST, rows))


def judged_report(fitted_output: Path, output: Path) -> Path:
    """The report of a fleet with a worn, a healthy and young motors."""
    shutil.copytree(fitted_output / "tables", output / "tables")
    nights = [dt.date.fromisoformat(night) for night in NIGHTS]
    path = night_file(output, NIGHT_TABLE, nights[0])
    published = read_table(path, NIGHT_TABLE).drop("run_id").to_dicts()
    for row in published:
        if (motor := row["motor_id"]) in (WORN, HEALTHY):
            row |= OF_MOTOR[motor]
    write_nights(output, NIGHT_TABLE, frame(NIGHT_TABLE, published))
    gaps = ((WORN, "balance_sleeve", 6.5), (HEALTHY, "piston_ring", 0.4))
    for place, night in enumerate(nights):
        rows = [
            {"motor_id": motor, "indicator": f"gap_change_{path}", "night": night, "unit": "%"}
            | {"value": value, "lower": value - 1.0, "upper": value + 1.0}
            for motor, path, value in gaps
        ]
        rows += [
            {"motor_id": motor, "indicator": "own_leakage", "night": night, "unit": "l/min"}
            | {"value": 2.0 + 0.1 * place, "baseline_mean": 2.0}
            for motor, *_ in gaps
        ]
        write_nights(output, TRENDS, frame(TRENDS, rows))
    alarm = {name: value for name, value in OF_MOTOR[WORN].items() if name in ALARMS.schema}
    alarm |= {"id": f"{WORN} {nights[2]} leakage", "motor_id": WORN, "night": nights[2]}
    alarm |= {"from_state": "ok", "to_state": "alarm"}
    write_nights(output, ALARMS, frame(ALARMS, [alarm]))
    publish_latest(output, NOTE)
    when = dt.datetime(2026, 1, 5, 9, tzinfo=dt.UTC)
    record_decision(output, Decision(WORN, "leakage", when, "acknowledged", nights[2], note=NOTE))
    seen = Decision(WORN, "", when, "finding", nights[2], None, "", "balance_sleeve", "piston_ring")
    record_decision(output, seen)
    fleet = demo_fleet(output)
    nights_of = fleet.settings.nights.model_copy(update={"time_zone": "Europe/Stockholm"})
    settings = fleet.settings.model_copy(update={"nights": nights_of})
    made = dt.datetime(2026, 1, 5, 11, tzinfo=dt.UTC)
    build_report(
        replace(fleet, settings=settings), output / "report", made=made, config="fleet.toml"
    )
    return output / "report"

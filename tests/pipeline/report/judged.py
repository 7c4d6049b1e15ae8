"""A fleet whose watch has told of a worn motor, beside a healthy one and young ones."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import replace
from pathlib import Path

from pipeline.report.build import build_report
from pipeline.schema import ALARMS, TRENDS, frame
from pipeline.schema import NIGHTS as NIGHT_TABLE
from pipeline.store.tables import read_table
from pipeline.trends.decisions import Decision, record_decision
from pipeline.trends.motor_states import MotorState
from tests.pipeline.report.conftest import demo_fleet
from tests.pipeline.report.states import (
    FIGURES,
    SENTENCES,
    alarm_row,
    night_row,
    publish_latest,
    state_of,
)
from tests.pipeline.report.states import WORN as WORN_FIGURES
from tests.pipeline.written import night_file, write_nights

NIGHTS = ["2026-01-02", "2026-01-03", "2026-01-04"]
WORN, HEALTHY = "CB560-01", "CB400-01"
YOUNG = ("CB1120-01", "CB1120-02", "CB400-02", "CB560-02")
NOTE = "new sleeves <b>are ordered</b>"
REASON = SENTENCES["alarm"]
HEADLINE = "Leakage +21 % [17, 25] since 4 January 2026, balance sleeve."


def states() -> list[MotorState]:
    """As a run leaves them that has watched thirty nights; the demo's three are too few."""
    waiting = {"sentence": "3 of 8 nights", "advice": "Wait.", "own_leakage_l_per_min": None}
    young = [state_of(name, "insufficient", **waiting) for name in YOUNG]
    return [state_of(WORN, "alarm", acknowledged=NOTE), state_of(HEALTHY), *young]


def judged_report(fitted_output: Path, output: Path) -> Path:
    """The report of a fleet with a worn, a healthy and young motors."""
    shutil.copytree(fitted_output / "tables", output / "tables")
    nights = [dt.date.fromisoformat(night) for night in NIGHTS]
    gaps = ((WORN, "balance_sleeve", 6.5), (HEALTHY, "piston_ring", 0.4))
    path = night_file(output, NIGHT_TABLE, nights[0])
    published = read_table(path, NIGHT_TABLE).drop("run_id").to_dicts()
    figures = FIGURES.keys() | WORN_FIGURES.keys() | {"state", "sentence", "advice"}
    judged = {WORN: "alarm", HEALTHY: "ok"}
    for row in published:
        if state := judged.get(row["motor_id"]):
            made = night_row(row["motor_id"], 0, state)
            row |= {name: made[name] for name in figures - {"status"} if name in made}
    for place, night in enumerate(nights):
        own = [row for row in published if row["night"] == night]
        write_nights(output, NIGHT_TABLE, frame(NIGHT_TABLE, own))
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
    alarm = alarm_row(
        WORN,
        nights[2],
        "ok",
        "alarm",
        sentence=REASON,
        **{name: of for name, of in WORN_FIGURES.items() if name in ALARMS.schema},
    )
    write_nights(output, ALARMS, frame(ALARMS, [alarm]))
    publish_latest(output, states())
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

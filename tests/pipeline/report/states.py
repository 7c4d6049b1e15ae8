"""States of motors with rows of `nights` made by hand, and an output of a worn motor."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pipeline.schema import LATEST, frame
from pipeline.store.tables import whole_file
from pipeline.trends.motor_states import MotorState
from tests.pipeline.written import write_table

Row = dict[str, Any]
LAST = 5


def night_of(place: int) -> dt.date:
    """Label of a night by its place."""
    return dt.date(2026, 1, 2) + dt.timedelta(days=place)


SENTENCES = {
    "ok": "no change detected since 2 January 2026",
    "alarm": "leakage +21 % [17, 25] tonight, since 4 January 2026 [3, 5]: balance sleeve",
}
ADVICE = {
    "ok": "Nothing to do.",
    "alarm": "Inspect the balance piston, the balance sleeve and the piston ring at the next stop.",
}
FIGURES = {
    "status": "ok",
    "flushing_mode": "none",
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
    "baseline_start": night_of(0),
    "baseline_end": night_of(1),
}
WORN = {
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
    "onset": night_of(2),
    "detected_on": night_of(3),
    "still_rising": False,
}


def night_row(motor: str, night: int = LAST, state: str = "ok", **more: Any) -> Row:
    """A row of `nights`: of a motor that has not changed, or of one with a worn sleeve."""
    words = {
        "sentence": SENTENCES.get(state, f"it is {state}"),
        "advice": ADVICE.get(state, "Do something."),
    }
    key = {"motor_id": motor, "night": night_of(night), "state": state, "motor_type": "CB560"}
    end = dt.datetime.combine(night_of(night), dt.time(5), dt.UTC)
    figures = FIGURES | (WORN if state == "alarm" else {}) | {"last_sample": end}
    return key | words | figures | more


def state_of(motor: str, state: str = "ok", **more: Any) -> MotorState:
    """The state of a motor whose newest row of `nights` is that."""
    last = {"last_fit_night": night_of(LAST), "data_age_nights": 0, "state_since": night_of(3)}
    return MotorState(dict.fromkeys(LATEST.schema) | night_row(motor, LAST, state) | last | more)


def publish_latest(output: Path, states: Iterable[MotorState]) -> None:
    """Write the table `latest`."""
    rows = [{**state.row, "run_id": "r"} for state in states]
    write_table(whole_file(output, LATEST), frame(LATEST, rows))


def alarm_row(motor: str, night: dt.date, before: str, after: str, **more: Any) -> Row:
    """A row of `alarms` of the leakage."""
    key = {"id": f"{motor} {night} leakage", "motor_id": motor, "night": night}
    return key | {"from_state": before, "to_state": after, "sentence": "it grew"} | more

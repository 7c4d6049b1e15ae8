"""States of motors with rows of `watch` made by hand, and an output of a worn motor."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.schema import ALARMS, FITS, LATEST, WATCH, Table, frame
from pipeline.store.tables import whole_file, write_table
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows.motor_states import MotorState, latest_rows
from pipeline.trends.rows.watch_rows import WatchRow
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.written import write_nights

LAST = 5


def night_of(place: int) -> dt.date:
    """Label of a night by its place."""
    return dt.date(2026, 1, 2) + dt.timedelta(days=place)


SENTENCES = {
    "ok": "no change of more than 3 % since 2 January 2026",
    "alarm": "leakage +21 % [17, 25] tonight, since 4 January 2026 [3, 5]: balance sleeve",
}
ADVICE = {"ok": "Nothing to do.", "alarm": "Look at the balance sleeve at the next stop."}
FIGURES = {
    "evidence": 2.5,
    "evidence_limit": 9.1,
    "lack_of_fit": 0.004,
    "model_verdict": "supported",
    "tonight_change": 0.01,
    "tonight_change_lower": -0.01,
    "tonight_change_upper": 0.03,
    "own_leakage_l_per_min": 2.02,
    "own_leakage_lower": 1.98,
    "own_leakage_upper": 2.06,
    "own_pressure_bar": 150.0,
    "own_temperature_c": 48.0,
    "own_speed_rpm": 26.0,
    "smallest_change": 0.03,
    "baseline_start": night_of(0),
    "baseline_end": night_of(1),
}
WORN = {
    "evidence": 31.0,
    "cause": "balance_sleeve",
    "cause_probability": 0.95,
    "candidates": "balance_sleeve 0.95; all_gaps 0.04",
    "tonight_change": 0.21,
    "tonight_change_lower": 0.17,
    "tonight_change_upper": 0.25,
    "own_leakage_l_per_min": 2.42,
    "own_leakage_lower": 2.34,
    "own_leakage_upper": 2.5,
    "since": night_of(2),
    "told_on": night_of(3),
    "goes_on": False,
}


def watched(motor: str, night: int = LAST, state: str = "ok", **more: Any) -> WatchRow:
    """A row of `watch`: of a motor that has not changed, or of one with a worn sleeve."""
    words = (SENTENCES.get(state, f"it is {state}"), ADVICE.get(state, "Do something."))
    figures = FIGURES | (WORN if state == "alarm" else {}) | more
    return WatchRow(motor, night_of(night), state, *words, **figures)


def state_of(motor: str, state: str = "ok", **more: Any) -> MotorState:
    """The state of a motor whose newest row of `watch` is that."""
    row = watched(motor, state=state)
    found = MotorState(motor, state, row.sentence, row.advice, row)
    return replace(found, last_good_night=night_of(LAST), state_since=night_of(3), **more)


def publish_latest(output: Path, states: Iterable[MotorState]) -> None:
    """Write the table `latest`."""
    write_table(whole_file(output, LATEST), frame(LATEST, latest_rows(states, "r")))


def publish(output: Path, table: Table, rows: Iterable[dict[str, Any]]) -> None:
    """Write rows to the files of their nights."""
    write_nights(output, table, frame(table, [{"run_id": "r"} | row for row in rows]))


def said(night: int, kind: str = "acknowledged", **more: Any) -> Decision:
    when = dt.datetime(2026, 2, 1, night, tzinfo=dt.UTC)
    return Decision("M1", "leakage", when, kind, night_of(night), **more)  # type: ignore[arg-type]


COURSE = ["ok", "ok", "warning", "warning", "alarm", "alarm"]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A fleet of M1, whose sleeve is worn, with the tables that status reads."""
    header = 'name = "Tests"\n[folders]\nlogs = "../logs"\noutput = "../out"\n'
    write_configs(tmp_path, {"M1": motor_toml("M1", "CB560")}, {}, fleet=header)
    output = tmp_path / "out"
    fit = {"motor_id": "M1", "motor_type": "CB560", "status": "ok"}
    publish(output, FITS, [fit | {"night": night_of(night)} for night in range(LAST + 1)])
    publish(output, WATCH, [watched("M1", n, one).row for n, one in enumerate(COURSE)])
    alarm = {"motor_id": "M1", "indicator": "leakage", "way": "change", "reason": "it grew"}
    moves = ((2, "ok", "warning"), (4, "warning", "alarm"))
    publish(
        output,
        ALARMS,
        [
            alarm
            | {"night": night_of(night), "from_state": before, "to_state": after}
            | {"time": dt.datetime(2026, 1, 2 + night, 6, tzinfo=dt.UTC)}
            for night, before, after in moves
        ],
    )
    publish_latest(output, [state_of("M1", "alarm")])
    return output

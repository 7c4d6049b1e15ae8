"""Rows of `trends` and `fits` of which states are made, and an output of a worn motor."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.schema import ALARMS, FITS, TRENDS, frame
from pipeline.store.encoding import write_table
from pipeline.store.tables import night_file
from pipeline.trends.nights.decisions import Decision
from tests.pipeline.trends.nights import configure, night_of

LAST = 5
NAMES = ("reference_leakage", "K_piston_ring")


def trend(motor: str, night: int, name: str, state: str = "ok", **more: Any) -> dict[str, Any]:
    row = {"run_id": "r", "motor_id": motor, "night": night_of(night), "indicator": name}
    row |= {"value": 1.4, "deviation_percent": 0.0, "n_slope": 30, "sensor_health": "ok"}
    reason = None if state == "ok" else f"{name} is {state}"
    return row | {"state": state, "state_reason": reason} | more


def rows_of(motor: str, **states: list[str]) -> pl.DataFrame:
    """Trends of some nights: a state for each night and indicator."""
    rows = [
        trend(motor, night, name, state)
        for name in NAMES
        for night, state in enumerate(states.get(name, ["ok"] * (LAST + 1)))
    ]
    return frame(TRENDS, rows)


def fits_of(motor: str, nights: int = LAST + 1) -> pl.DataFrame:
    row = {"run_id": "r", "motor_id": motor, "motor_type": "CB560", "status": "ok"}
    return frame(FITS, [row | {"night": night_of(night)} for night in range(nights)])


def said(night: int, kind: str = "acknowledged", **more: Any) -> Decision:
    when = dt.datetime(2026, 2, 1, night, tzinfo=dt.UTC)
    return Decision("M1", "K_piston_ring", when, kind, night_of(night), **more)  # type: ignore[arg-type]


WORN = ["ok", "ok", "warning", "warning", "alarm", "alarm"]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A fleet of M1, whose rings are worn, with the tables that status reads."""
    configure(tmp_path)
    output = tmp_path / "out"
    trends, fits = rows_of("M1", K_piston_ring=WORN), fits_of("M1")
    for night in range(LAST + 1):
        for table, rows in ((TRENDS, trends), (FITS, fits)):
            own = rows.filter(night=night_of(night))
            write_table(night_file(output, table, night_of(night)), own)
    for night, before, after in ((2, "ok", "warning"), (4, "warning", "alarm")):
        row = {"run_id": "r", "motor_id": "M1", "night": night_of(night), "way": "level"}
        row |= {"time": dt.datetime(2026, 1, 2 + night, 6, tzinfo=dt.UTC), "reason": "it grew"}
        row |= {"indicator": "K_piston_ring", "from_state": before, "to_state": after}
        write_table(night_file(output, ALARMS, night_of(night)), frame(ALARMS, [row]))
    return output

"""What `status` and `ack` rest on: the newest alarm, durations, a meaning of each state."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest
import typer

from pipeline.cli.arguments import duration
from pipeline.errors import UsageError
from pipeline.report.status import last_alarm
from pipeline.report.words import STATES
from pipeline.schema import ALARMS, frame
from pipeline.trends.motor_states import ACTIONABLE, CHANGED, ORDER
from tests.pipeline.written import write_nights


def test_a_silent_motor_is_acknowledged_and_not_inspected(tmp_path: Path) -> None:
    nights = {"alarm": dt.date(2026, 1, 6), "stale": dt.date(2026, 1, 7)}
    rows = [
        {"id": state, "motor_id": "M1", "night": night, "from_state": "ok", "to_state": state}
        | {"sentence": "it grew", "run_id": "r"}
        for state, night in nights.items()
    ]
    write_nights(tmp_path, ALARMS, frame(ALARMS, rows))
    assert last_alarm(tmp_path, "M1", "leakage", ACTIONABLE) == nights["stale"]
    assert last_alarm(tmp_path, "M1", "leakage", CHANGED) == nights["alarm"]
    with pytest.raises(UsageError, match="alarms so far: none"):
        last_alarm(tmp_path, "M2", "leakage", ACTIONABLE)


@pytest.mark.parametrize("text", ["", "h", "26", "-1h", "0h", "infh", "nanh", "1y", "26 h ours"])
def test_a_duration_that_is_none(text: str) -> None:
    with pytest.raises(typer.BadParameter):
        duration(text)


def test_every_state_has_a_meaning() -> None:
    assert set(STATES) == set(ORDER)

"""Metrics: names that must be escaped, what is not known, and a folder that is absent."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.errors import StoreError
from pipeline.intraday.check import MotorCheck
from pipeline.notification.outbox import Backlog
from pipeline.run.notification import (
    HEAD,
    intraday_metrics_file,
    intraday_metrics_text,
    metrics_text,
    write_metrics,
)
from pipeline.schema import LATEST
from pipeline.trends.motor_states import MotorState

WHEN = dt.datetime(2026, 3, 2, 6, tzinfo=dt.UTC)
FLEET: Any = SimpleNamespace(name='Mill "A"\\ north')


def test_what_is_of_the_fleet_and_what_is_not_known() -> None:
    none = dict.fromkeys(LATEST.schema)
    risen = {"motor_id": "M1", "state": "alarm", "leakage_change_percent": 21.0}
    young = {"motor_id": "M2", "state": "insufficient"}
    states = [MotorState(none | risen), MotorState(none | young)]
    backlogs = [Backlog("hook", WHEN, 3, WHEN, None)]
    text = metrics_text(FLEET, states, [], {"trends_s": 0.25}, backlogs, WHEN)
    fleet = 'fleet="Mill \\"A\\"\\\\ north"'
    assert f'motor_leakage_undelivered_changes{{{fleet},receiver="hook"}} 3.0\n' in text
    assert f'motor_leakage_stage_duration_seconds{{{fleet},stage="trends"}} 0.25\n' in text
    assert f"last_good_run_timestamp_seconds{{{fleet}}} {WHEN.timestamp()!r}\n" in text
    # What is not known has no sample.
    assert "model_error_percent{" not in text
    assert text.count("leakage_change_percent{") == 1


def test_an_absent_folder_is_not_made(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="is no folder"):
        write_metrics(tmp_path / "absent" / "fleet.prom", HEAD)
    assert list(tmp_path.iterdir()) == []


def test_the_intraday_check_has_a_file_of_its_own() -> None:
    assert intraday_metrics_file(Path("/a/mill.prom")) == Path("/a/mill-intraday.prom")
    risen = MotorCheck("M1", "risen", "+82 %", end_us=round(WHEN.timestamp() * 1e6))
    checks = [risen, MotorCheck("M2", "not_judged", "no new samples")]
    lines = intraday_metrics_text(FLEET, checks).splitlines()
    states = [line for line in lines if "intraday_state{" in line and line.endswith(" 1.0")]
    assert 'motor="M1",state="risen"' in states[0]
    assert 'motor="M2",state="not_judged"' in states[1]
    (judged,) = (line for line in lines if line.startswith("motor_leakage_intraday_judged"))
    assert judged.endswith(f" {WHEN.timestamp()!r}")

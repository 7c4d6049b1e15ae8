"""Metrics: what Prometheus's own tool takes, and a folder that is absent, full or foreign."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pytest

from pipeline.config import Fleet
from pipeline.config.settings import Settings
from pipeline.errors import StoreError
from pipeline.intraday.check import MotorCheck
from pipeline.notification.outbox import Backlog
from pipeline.run.metrics import (
    HEAD,
    intraday_metrics_file,
    intraday_metrics_text,
    metrics_text,
    write_metrics,
)
from pipeline.run.tasks import MotorOutcome
from pipeline.schema import LATEST
from pipeline.trends.rows.motor_states import MotorState

WHEN = dt.datetime(2026, 3, 2, 6, tzinfo=dt.UTC)
LEAKAGE = ("l_per_min", "lower", "upper")
NAME = 'Mill "A"\\ north'


@dataclass(frozen=True)
class SomeFleet:
    name: str = NAME
    settings: Settings = Settings()  # noqa: RUF009 - frozen


@dataclass(frozen=True)
class SomeOutcome:
    motor_id: str = "M1"
    n_standing: int = 2


def metrics() -> str:
    """Metrics of a fleet of one motor."""
    figures = {"leakage_change_percent": 21.0, "evidence": 31.0, "evidence_limit": 9.1}
    figures |= {"leakage_change_lower": 19.0, "leakage_change_upper": 23.0}
    figures |= {f"own_leakage_{name}": n for name, n in zip(LEAKAGE, (1.4, 1.3, 1.5), strict=True)}
    none = dict.fromkeys(LATEST.schema)
    risen = none | figures | {"motor_id": "M1", "state": "alarm", "last_sample": WHEN}
    young = none | {"motor_id": "M2", "state": "insufficient"}
    return metrics_text(
        cast(Fleet, SomeFleet()),
        [MotorState(risen), MotorState(young)],
        [cast(MotorOutcome, SomeOutcome())],
        {"motors_s": 1.5, "trends_s": 0.25},
        [Backlog("hook", WHEN, 3, WHEN, None)],
        WHEN,
    )


def test_what_is_of_the_fleet_and_what_is_not_known() -> None:
    text, fleet = metrics(), 'fleet="Mill \\"A\\"\\\\ north"'
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
    end_us = round(WHEN.timestamp() * 1e6)
    checks = [
        MotorCheck("M1", "risen", "+82 %", end_us=end_us),
        MotorCheck("M2", "not_judged", "no new samples"),
    ]
    lines = intraday_metrics_text(cast(Fleet, SomeFleet()), checks).splitlines()
    assert lines[0] == HEAD
    states = [line for line in lines if "intraday_state{" in line and line.endswith(" 1.0")]
    assert len(states) == 2
    assert 'motor="M1",state="risen"' in states[0]
    assert 'motor="M2",state="not_judged"' in states[1]
    (judged,) = (line for line in lines if line.startswith("motor_leakage_intraday_judged"))
    assert judged.endswith(f" {WHEN.timestamp()!r}")

"""Isolation in a run: a night, or trends, that take their worker along cost no others."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import pipeline.run.fleet
import pipeline.run.publishing
from pipeline.config import Execution, load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.run.motor_task import run_motor
from pipeline.run.publishing import run_trends
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.trends.tasks import TrendOutcome, TrendTask
from tests.conftest import OwnFleet
from tests.pipeline.misbehaviour import MISBEHAVIOUR
from tests.pipeline.run.demo_runs import output_of, rows

GOOD, BAD = "CB400-01", "CB400-02"


def fit(fleet_file: Path, monkeypatch: pytest.MonkeyPatch, what: str, night: str) -> RunResult:
    """Run a fleet in which one motor misbehaves in a night."""

    def run_or_misbehave(task: MotorTask) -> MotorOutcome:
        if task.spec.motor_id == BAD:
            misbehave_at(night, what)
        return run_motor(task)

    fleet = load_fleet(fleet_file)
    timeout_s = 15.0 if what.startswith("hang") else 60.0
    limits = Execution(workers=1, timeout_s=timeout_s, memory_limit_mib=1500)
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.run.fleet, "run_motor", run_or_misbehave)
        return run_fleet(RunRequest(replace(fleet, execution=limits)))


def misbehave_at(night: str, what: str) -> None:
    """In a worker: have the fit of a night misbehave."""
    import pipeline.run.motor_task as module

    fit_night = module.fit_night

    def fit_or_misbehave(spec: Any, here: Any, channels: Any) -> Any:
        if str(here.date) == night and spec.motor_id == BAD:
            MISBEHAVIOUR[what]()
        return fit_night(spec, here, channels)

    module.fit_night = fit_or_misbehave


def fits(output: Path) -> pl.DataFrame:
    return rows(output, "fits", BAD).filter(pl.col("is_primary"))


@pytest.mark.parametrize(
    ("what", "code"),
    [
        ("kill", "worker_died"),
        pytest.param("hang_in_c", "task_timeout", marks=pytest.mark.full),
        pytest.param("eat_with_numpy", "task_memory", marks=pytest.mark.full),
        pytest.param("panic", "internal", marks=pytest.mark.full),
    ],
)
def test_a_night_that_takes_its_worker_along_costs_no_other_night(
    own_fleet: OwnFleet,
    fitted_output: Path,
    monkeypatch: pytest.MonkeyPatch,
    what: str,
    code: str,
) -> None:
    fleet = own_fleet(BAD)
    (outcome,) = fit(fleet, monkeypatch, what, "2026-01-03").outcomes
    assert (outcome.status, outcome.error_code) == ("failed", code)
    assert dict(outcome.counts) == {"ok": 2, "failed": 1}
    found, before = fits(output_of(fleet)), fits(fitted_output)
    nights = rows(output_of(fleet), "nights", BAD).sort("night")
    assert nights["error_code"].to_list() == [None, code, None]
    assert nights["reason"][1]
    assert_frame_equal(found[:1], before[:1])
    (row,) = rows(output_of(fleet), "run_motors", BAD).to_dicts()
    assert row["message"].startswith("night 2026-01-03: ")
    # Nothing is tried again by itself; asked for, it is done.
    again = replace(load_fleet(fleet), execution=Execution(backend="sequential"))
    assert run_fleet(RunRequest(again)).n_nights == 0
    assert run_fleet(RunRequest(again, retry=True)).failed == ()
    assert_frame_equal(fits(output_of(fleet)), before)


def test_trends_that_take_their_worker_along_cost_their_motor_alone(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = own_fleet(GOOD, BAD)

    def run_or_die(task: TrendTask) -> TrendOutcome:
        from pipeline.trends.course import Course

        step = Course.step

        def die(course: Course) -> None:
            if course.spec.motor_id == BAD:
                MISBEHAVIOUR["segfault"]()
            step(course)

        Course.step = die  # type: ignore[method-assign]
        return run_trends(task)

    monkeypatch.setattr(pipeline.run.publishing, "run_trends", run_or_die)
    limits = Execution(workers=1, timeout_s=60.0, memory_limit_mib=1500)
    result = run_fleet(RunRequest(replace(load_fleet(fleet), execution=limits)))
    assert [one.motor_id for one in result.failed] == [BAD]
    (row,) = rows(output_of(fleet), "run_motors", BAD).to_dicts()
    assert (row["status"], row["error_code"]) == ("failed", "worker_died")
    assert re.match(
        rf"trends: its worker process ended with SIGSEGV\(-11\), at {BAD}", row["message"]
    )
    # Its fits are there, and the trends of the other.
    nights = rows(output_of(fleet), "nights", BAD)
    assert nights["status"].to_list() == ["ok"] * 3
    assert set(rows(output_of(fleet), "trends")["motor_id"]) == {GOOD}

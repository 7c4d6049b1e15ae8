"""Isolation in a run: a night, or trends, that take their worker along cost no others."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import pipeline.run.fleet
import pipeline.run.publishing
from pipeline.config import Execution, load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from tests.conftest import OwnFleet
from tests.pipeline.misbehaviour import Misbehaving
from tests.pipeline.run.demo_runs import output_of, rows

GOOD, BAD = "CB400-01", "CB400-02"


LIMITS = Execution(workers=1, timeout_s=60.0, memory_limit_mib=1500)


def run_with(fleet_file: Path, limits: Execution) -> RunResult:
    return run_fleet(RunRequest(replace(load_fleet(fleet_file), execution=limits)))


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
    timeout_s = 15.0 if what.startswith("hang") else 60.0
    with monkeypatch.context() as patched:
        bad = Misbehaving(BAD, what, "2026-01-03")
        patched.setattr(pipeline.run.fleet, "run_motor", bad.fit)
        limits = LIMITS.model_copy(update={"timeout_s": timeout_s})
        (outcome,) = run_with(fleet, limits).outcomes
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


# A night that does so is in the quick run, and so are the tasks of `test_isolation`.
@pytest.mark.full
def test_trends_that_take_their_worker_along_cost_their_motor_alone(
    own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = own_fleet(GOOD, BAD)

    monkeypatch.setattr(pipeline.run.publishing, "run_trends", Misbehaving(BAD, "segfault").watch)
    result = run_with(fleet, LIMITS)
    assert [motor.motor_id for motor in result.failed] == [BAD]
    (row,) = rows(output_of(fleet), "run_motors", BAD).to_dicts()
    assert (row["status"], row["error_code"]) == ("failed", "worker_died")
    assert re.match(
        rf"trends: its worker process ended with SIGSEGV\(-11\), at {BAD}", row["message"]
    )
    # Its fits are there, and the trends of the other.
    nights = rows(output_of(fleet), "nights", BAD)
    assert nights["status"].to_list() == ["ok"] * 3
    assert set(rows(output_of(fleet), "trends")["motor_id"]) == {GOOD}

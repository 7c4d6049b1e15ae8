"""A log that blocks is named and costs its night, and no other."""

from __future__ import annotations

import datetime as dt
import os
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import pipeline.logs.files
import pipeline.logs.motor_logs
import pipeline.run.fleet
import pipeline.run.motors
from pipeline.clock import latest_us
from pipeline.config import load_fleet
from pipeline.logs.finding import find_logs
from pipeline.logs.motor_logs import MotorLogs
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.motor_task import run_motor
from pipeline.run.tasks import MotorTask
from pipeline.workers.process import Loss
from tests.pipeline.remembered import processed_of
from tests.pipeline.workshop import DAY, QUICK, Workshop

FIRST = dt.date(2026, 1, 2)
BLOCKS = FIRST + 2 * DAY
SILENCE = Loss("log_no_answer", "it did not answer within 3 s")


def statuses(folder: Path, motor: str) -> list[str]:
    """Outcomes of a motor's published nights, in order of time."""
    found = pl.read_parquet(folder / "out" / "tables" / "nights" / "**" / "*.parquet")
    return found.filter(motor_id=motor).sort("night")["status"].to_list()


def table(folder: Path, name: str) -> pl.DataFrame:
    return pl.read_parquet(folder / "out" / "tables" / name / "**" / "*.parquet")


def opened_all_the_same(task: MotorTask) -> Any:
    """A motor's task to which a pipe looks like a file, as one on a mount that hangs does."""
    pipeline.logs.files.stat.S_ISREG = lambda _: True  # in the worker alone
    return run_motor(task)


def test_a_log_that_does_not_answer_is_named_and_costs_its_night(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shop = Workshop(tmp_path)
    isolated = QUICK.replace("sequential", "loky") + "answer_s = 3.0\n"
    shop.configure(fleet=isolated, motors=("M1", "M2"))
    for motor in ("M1", "M2"):
        for night in (FIRST, FIRST + DAY):
            shop.log(night, motor=motor)
    os.mkfifo(tmp_path / "logs" / "M1" / f"{BLOCKS}.parquet")
    monkeypatch.setattr(pipeline.run.motors, "run_motor", opened_all_the_same)
    result = run_fleet(RunRequest(load_fleet(shop.fleet)))
    m1, m2 = result.outcomes
    assert (m1.status, m1.error_code, m2.status) == ("failed", "log_no_answer", "ok")
    assert statuses(tmp_path, "M1") == ["ok", "ok", "failed"]
    (row,) = table(tmp_path, "log_files").filter(status="failed").to_dicts()
    assert (row["night"], row["error_code"]) == (BLOCKS, "log_no_answer")
    assert row["message"] == (
        f"{BLOCKS}.parquet: did not answer within 3 s (night known by its name)"
    )


# What is known of a log that does not answer


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    made = Workshop.at(tmp_path)
    made.log(FIRST)
    made.run()
    return made


def shelf(workshop: Workshop, *silent: str) -> MotorLogs:
    spec, known = workshop.task().spec, processed_of(workshop.output).files
    return MotorLogs(spec, known, latest_us(), dict.fromkeys(silent, SILENCE))


def test_one_that_was_read_before_is_as_it_was(workshop: Workshop) -> None:
    name = f"M1/{FIRST}.parquet"
    found = shelf(workshop, name)
    assert found.files[name] == processed_of(workshop.output).files[name]
    assert found.news_of(name) is None
    # Its night cannot be made anew, and the next run tries again.
    assert found.content(name) is None
    record = found.files[name]
    assert (record.error_code, record.nights) == ("log_no_answer", (str(FIRST),))
    assert found.news_of(name) == f"changed file {name}"


def test_what_does_not_answer_is_not_looked_at(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    (workshop.logs / "link.parquet").symlink_to(workshop.logs / "folder")
    workshop.configure(files='"M1/*.parquet", "M1/named", "M1/old/*.parquet"')
    spec = workshop.task().spec
    silent = {"M1/link.parquet", "M1/named", "M1/old/*.parquet"}

    is_dir = Path.is_dir

    def looked(path: Path) -> bool:
        assert path.name not in ("link.parquet", "named", "old")
        return is_dir(path)

    monkeypatch.setattr(Path, "is_dir", looked)
    found, absent = find_logs(spec, silent)
    assert list(found) == [f"M1/{FIRST}.parquet", "M1/link.parquet", "M1/named"]
    assert absent == []

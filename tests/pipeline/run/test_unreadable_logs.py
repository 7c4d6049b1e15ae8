"""Logs that are missing, empty or broken, and faults of our own: each costs its night alone."""

from __future__ import annotations

import datetime as dt
import os
from pathlib import Path
from typing import Any

import pytest

import pipeline.logs.files
import pipeline.run.motor_task
from pipeline.logs.finding import find_logs
from pipeline.night.fit_night import NightOutcome, fit_night
from tests.pipeline.simulated import NIGHT
from tests.pipeline.workshop import DAY, Workshop


def test_a_lost_clock_does_not_make_decades_of_holes(workshop: Workshop) -> None:
    workshop.log(dt.date(2000, 1, 3))
    workshop.log(NIGHT)
    outcome = workshop.run()
    assert outcome.nights == (dt.date(2000, 1, 3), NIGHT)
    workshop.log(NIGHT + DAY)
    assert workshop.run().nights == (NIGHT + DAY,)


def test_what_is_no_file_is_reported_and_waited_for_by_nobody(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    odd = workshop.logs / f"odd_{NIGHT + DAY}.parquet"
    odd.symlink_to("/dev/zero")
    for _ in range(2):  # for as long as it lies there
        outcome = workshop.run()
        assert (outcome.status, outcome.error_code) == ("failed", "log_not_readable")
        assert odd.name in (outcome.message or "")
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + DAY: "failed"}
    odd.unlink()
    workshop.log(NIGHT + DAY, odd.name)
    assert workshop.run().nights == (NIGHT + DAY,)
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + DAY: "ok"}


def test_a_fault_of_ours_in_one_night_costs_that_night(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:

    def faulty(spec: Any, night: Any, channels: Any) -> NightOutcome:
        if night.date == NIGHT + DAY:
            raise ZeroDivisionError("not foreseen")
        return fit_night(spec, night, channels)

    for day in range(3):
        workshop.log(NIGHT + day * DAY)
    monkeypatch.setattr(pipeline.run.motor_task, "fit_night", faulty)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "internal")
    assert f"night {NIGHT + DAY}: ZeroDivisionError: not foreseen" in (outcome.message or "")
    assert list(workshop.statuses().values()) == ["ok", "failed", "ok"]


def broken_night(workshop: Workshop) -> Path:
    """A night between two others whose log is damaged, and done as well as it goes."""
    for day in range(3):
        workshop.log(NIGHT + day * DAY, seed=day)
    path = workshop.logs / f"{NIGHT + DAY}.parquet"
    sound = path.read_bytes()
    path.write_bytes(sound[:100] + bytes(len(sound) - 100))
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    path.with_suffix(".sound").write_bytes(sound)
    os.utime(path.with_suffix(".sound"), ns=(state.st_atime_ns, state.st_mtime_ns))
    assert workshop.run().n_standing == 1
    return path


def test_a_failed_night_whose_log_was_removed_fails_no_more(workshop: Workshop) -> None:
    path = broken_night(workshop)
    path.unlink()
    outcome = workshop.run()
    assert (outcome.nights, outcome.n_standing) == ((NIGHT + DAY,), 0)
    assert list(workshop.statuses().values()) == ["ok", "no_new_data", "ok"]
    assert workshop.run().nights == ()
    # Where its log comes back, it is read.
    path.with_suffix(".sound").replace(path)
    assert workshop.run().nights[0] == NIGHT + DAY
    assert set(workshop.statuses().values()) == {"ok"}


def test_a_folder_that_is_not_mounted_heals_no_failure(workshop: Workshop) -> None:
    broken_night(workshop)
    workshop.logs.rename(workshop.logs.with_name("away"))
    assert workshop.run().n_standing == 1
    assert list(workshop.statuses().values()) == ["ok", "failed", "ok"]


def test_what_does_not_answer_is_not_looked_at(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop.log(NIGHT)
    (workshop.logs / "link.parquet").symlink_to(workshop.logs / "folder")
    workshop.configure(files='"M1/*.parquet", "M1/named", "M1/old/*.parquet"')
    spec = workshop.spec
    silent = {"M1/link.parquet", "M1/named", "M1/old/*.parquet"}

    is_dir = Path.is_dir

    def looked(path: Path) -> bool:
        assert path.name not in ("link.parquet", "named", "old")
        return is_dir(path)

    monkeypatch.setattr(Path, "is_dir", looked)
    found, absent, _ = find_logs(spec, silent)
    assert list(found) == [f"M1/{NIGHT}.parquet", "M1/link.parquet", "M1/named"]
    assert absent == []


def test_a_log_of_no_night_is_reported_once_and_stands_in_one_row(workshop: Workshop) -> None:
    workshop.log(NIGHT + DAY)
    (workshop.logs / "x_2099-01-01.parquet").write_bytes(b"junk")
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_parquet")
    again = workshop.run()
    assert (again.status, again.files["failed"]) == ("no_new_data", 1)
    # An older log comes: the row goes where the motor begins now.
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    newest = workshop.rows("log_files").filter(status="failed")
    assert newest.select("path", "night").rows() == [("M1/x_2099-01-01.parquet", None)]

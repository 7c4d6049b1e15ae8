"""The newest night is that of samples: no junk file, future or empty night makes motors stale."""

from __future__ import annotations

import datetime as dt
import os
import shutil
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.config import load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.schema import NIGHTS, Table, frame
from pipeline.store.state import read_state_file
from pipeline.store.tables import read_rows
from pipeline.trends.tasks import NewestNight, newest_night_of
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.trends.nights import DAY, Nights, night_of, part_of, publish
from tests.pipeline.workshop import QUICK, Workshop
from tests.pipeline.written import write_nights

MOTORS = ("M1", "M2")
N = 12
LAST = night_of(N - 1)
JUNK = b"x\n1\n"
NIGHT = dt.date(2026, 3, 2)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two motors whose nights are published, long enough for a baseline, and their trends."""
    folder = tmp_path_factory.mktemp("watched")
    config = write_configs(folder, {name: motor_toml(name) for name in MOTORS}, fleet=QUICK)
    frames = [Nights(spec, N).frames() for spec in load_fleet(config).motors]
    publish(folder / "out", *frames)
    assert run(folder).failed == ()
    return folder


@pytest.fixture
def fleet(watched: Path, tmp_path: Path) -> Path:
    shutil.copytree(watched, tmp_path / "fleet")
    return tmp_path / "fleet"


def run(folder: Path, **asked: Any) -> RunResult:
    return run_fleet(RunRequest(load_fleet(folder / "configs" / "fleet.toml"), **asked))


def at(night: dt.date) -> dt.datetime:
    """Noon after a night."""
    return dt.datetime.combine(night, dt.time(12), dt.UTC)


def rows(folder: Path, table: Table) -> pl.DataFrame:
    return read_rows(folder / "out", table, MOTORS).drop("run_id").sort(table.key)


def junk(folder: Path, name: str, written: dt.datetime | None = None) -> Path:
    path = folder / "logs" / "M1" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(JUNK)
    if written is not None:
        os.utime(path, (written.timestamp(), written.timestamp()))
    return path


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("x_2099-01-01.parquet", None),
        ("x.parquet", dt.datetime(2099, 1, 1, tzinfo=dt.UTC)),
        (f"x_{LAST + 20 * DAY}.parquet", None),
    ],
)
def test_a_junk_file_blinds_nobody(fleet: Path, name: str, written: dt.datetime | None) -> None:
    before = rows(fleet, NIGHTS)
    assert set(before.filter(night=LAST)["state"]) == {"ok"}
    junk(fleet, name, written)
    result = run(fleet)
    assert [one.error_code for one in result.failed] == ["log_not_parquet"]
    assert result.alarms == ()
    nights = rows(fleet, NIGHTS)
    assert_frame_equal(nights.filter(pl.col("status") != "failed"), before)
    assert set(nights["state"]) == set(before["state"])


def test_a_motor_without_logs_is_stale_when_the_others_go_on(fleet: Path) -> None:
    """Nights of another one that are added before its last are no reason."""
    m1, _ = load_fleet(fleet / "configs" / "fleet.toml").motors
    more = Nights(m1, N + 9).frames()
    publish(fleet / "out", part_of(more, N, N + 9))
    run(fleet)
    newest_night = rows(fleet, NIGHTS).filter(night=LAST + 9 * DAY)
    assert dict(newest_night.select("motor_id", "state").iter_rows()) == {"M1": "ok", "M2": "stale"}


# Which night


def tables(output: Path, *nights: tuple[int, str, str, float | None]) -> None:
    """Rows of nights by place, motor, outcome and kept hours."""
    for place in {place for place, *_ in nights}:
        rows = [
            {
                "motor_id": motor_id,
                "night": night_of(place),
                "status": status,
                "last_sample": at(night_of(place)) if hours else None,
            }
            for _, motor_id, status, hours in (night for night in nights if night[0] == place)
        ]
        write_nights(output, NIGHTS, frame(NIGHTS, rows))


def newest(output: Path, latest: dt.date) -> NewestNight | None:
    with read_state_file(output) as state:
        return newest_night_of(state, MOTORS, latest)


def test_the_newest_night_is_the_newest_night_of_which_samples_are_kept(tmp_path: Path) -> None:
    tables(
        tmp_path,
        (0, "M1", "ok", 8.0),
        (1, "M2", "insufficient_data", 0.5),
        (2, "M1", "stood_still", 0.0),
        (3, "M3", "ok", 8.0),  # of no fleet any more
        (4, "M2", "failed", None),
        (5, "M2", "no_new_data", None),
    )
    found = newest(tmp_path, night_of(9))
    assert found == NewestNight(night_of(1), {"M1": night_of(2), "M2": night_of(1)})
    # A motor's own nights with samples count for itself.
    assert (found.of("M1"), found.of("M2"), found.of("M4")) == (
        night_of(2),
        night_of(1),
        night_of(1),
    )


def test_no_night_of_the_future_is_the_newest_night(tmp_path: Path) -> None:
    tables(tmp_path, (0, "M1", "ok", 8.0), (7, "M1", "ok", 8.0))
    found = newest(tmp_path, night_of(6))
    assert found.night == night_of(0)
    assert newest(tmp_path, night_of(0) - DAY) is None


# Logs by the run's clock


def run_at(workshop: Workshop, night: dt.date, **asked: Any) -> Any:
    (outcome,) = run(workshop.folder, clock=at(night), **asked).outcomes
    return outcome


def test_samples_of_the_future_are_refused_by_the_clock_of_the_run(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    ahead = workshop.log(NIGHT + 3 * DAY, "ahead.parquet")
    outcome = run_at(workshop, NIGHT)
    assert (outcome.status, outcome.error_code) == ("failed", "log_time")
    assert workshop.statuses() == {NIGHT: "ok"}
    row = workshop.rows("log_files").filter(path=f"M1/{ahead.name}").row(0, named=True)
    assert (row["night"], row["error_code"]) == (None, "log_time")
    assert run_at(workshop, NIGHT + 3 * DAY, retry=True).status == "ok"
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + 3 * DAY: "ok"} | {
        NIGHT + day * DAY: "no_new_data" for day in (1, 2)
    }


def test_a_log_of_no_night_is_told_once_and_stands_in_one_row(workshop: Workshop) -> None:
    workshop.log(NIGHT + DAY)
    (workshop.logs / "x_2099-01-01.parquet").write_bytes(JUNK)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_parquet")
    again = workshop.run()
    assert (again.status, again.files["failed"]) == ("no_new_data", 1)
    # An older log comes: the row goes where the motor begins now.
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    found = workshop.rows("log_files").filter(status="failed")
    assert found.select("path", "night").rows() == [("M1/x_2099-01-01.parquet", None)]

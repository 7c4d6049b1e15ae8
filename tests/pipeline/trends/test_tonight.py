"""Tonight is told by samples: no junk file, no future and no empty night makes motors stale."""

from __future__ import annotations

import datetime as dt
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import pipeline.run.publishing
from pipeline.config import load_fleet
from pipeline.logs import told_nights
from pipeline.report.explain import explain
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.run.publishing import fleets_tonight
from pipeline.schema import ALARMS, FITS, NIGHT_TABLES, OPERATION, TREND_TABLES, WATCH, Table
from pipeline.store.published import verify_tables
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.nights.tonight import Tonight, tonight_of
from tests.pipeline.remembered import change, forget
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.trends.nights import DAY, Nights, night_of, part_of, publish
from tests.pipeline.workshop import QUICK, Workshop, check_same_figures

MOTORS = ("M1", "M2")
N = 12
LAST = night_of(N - 1)
CENTURY = dt.date(2099, 1, 1)
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
    before = rows(fleet, WATCH)
    assert set(before.filter(night=LAST)["state"]) == {"ok"}
    junk(fleet, name, written)
    result = run(fleet)
    assert [one.error_code for one in result.failed] == ["log_not_parquet"]
    assert result.alarms == ()
    assert_frame_equal(rows(fleet, WATCH), before)


def test_a_motor_without_logs_is_stale_when_the_others_go_on(fleet: Path) -> None:
    """Nights of another one that are added before its last are no reason."""
    m1, _ = load_fleet(fleet / "configs" / "fleet.toml").motors
    more = Nights(m1, N + 9).frames()
    publish(fleet / "out", part_of(more, N, N + 9))
    run(fleet)
    tonight = rows(fleet, WATCH).filter(night=LAST + 9 * DAY)
    assert dict(tonight.select("motor_id", "state").iter_rows()) == {"M1": "ok", "M2": "stale"}


# What an earlier version has published


WRONG = LAST + 10 * DAY


@pytest.fixture(scope="module")
def poisoned(watched: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """After a run as it was before: the junk file's night is published, and everybody's tonight."""
    folder = tmp_path_factory.mktemp("poisoned") / "fleet"
    shutil.copytree(watched, folder)
    junk(folder, f"x_{WRONG}.parquet")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline.run.publishing, "fleets_tonight", lambda *_: Tonight(WRONG))
        run(folder, clock=at(WRONG))
    assert rows(folder, FITS).filter(night=WRONG)["status"].to_list() == ["failed"]
    newest = rows(folder, WATCH).filter(night=WRONG)
    assert newest["state"].to_list() == ["stale"] * 2
    return folder


@pytest.mark.parametrize(
    "gone",
    [
        (),
        ("logs/M1", "ledger"),
        pytest.param(("logs/M1",), marks=pytest.mark.full),
        pytest.param(("kept",), marks=pytest.mark.full),
    ],
)
def test_a_poisoned_fleet_heals_in_the_next_run(
    watched: Path, poisoned: Path, tmp_path: Path, gone: Sequence[str]
) -> None:
    """And all that somebody may have deleted to heal it makes no difference."""
    before = {table: rows(watched, table) for table in (*NIGHT_TABLES, *TREND_TABLES)}
    fleet = tmp_path / "fleet"
    shutil.copytree(poisoned, fleet)
    for name in gone:
        if name == "ledger":
            forget(fleet / "out")
        elif name == "kept":
            change(fleet / "out", "UPDATE trends SET kept = NULL")
        else:
            shutil.rmtree(fleet / name)
    result = run(fleet, clock=at(LAST))
    (m1, _) = result.outcomes
    assert (m1.message or "").endswith(f"withdrawn, as no log has samples of them: {WRONG}")
    for table, told in before.items():
        if table is not ALARMS:
            assert_frame_equal(rows(fleet, table), told)
    # Stale was told: it says what the state is, and that this was none.
    alarms = rows(fleet, ALARMS)
    healed = alarms.filter(way="recomputed")
    assert_frame_equal(alarms.filter(pl.col("way") != "recomputed"), before[ALARMS])
    assert set(healed["motor_id"]) == set(MOTORS)
    assert healed.select("night", "from_state", "to_state").unique().rows() == [
        (LAST, "stale", "ok")
    ]
    assert healed["reason"][0] == (
        f"recomputed: the nights after {LAST} are withdrawn: no log has samples of them"
    )
    assert len(result.alarms) == healed.height
    assert [one for one in verify_tables(fleet / "out") if one.code != "table_unlisted"] == []
    # Once is enough, and nothing is too old to be kept by the night that was none.
    again = run(fleet, clock=at(LAST))
    assert (again.n_nights, again.alarms, again.failed) == (0, (), ())
    tonight = fleets_tonight(load_fleet(fleet / "configs" / "fleet.toml"), at(LAST))
    assert tonight is not None
    assert tonight.night == LAST


# Which night


def tables(output: Path, *nights: tuple[int, str, str, float | None]) -> None:
    """Rows of nights by place, motor, outcome and kept hours."""
    for place in {place for place, *_ in nights}:
        here = [one for one in nights if one[0] == place]
        key = [{"motor_id": one[1], "night": night_of(place)} for one in here]
        fits = [
            one | {"flushing_mode": "none", "is_primary": True, "status": status}
            for one, (_, _, status, _) in zip(key, here, strict=True)
        ]
        kept = [
            one | {"kept_hours": hours}
            for one, (*_, hours) in zip(key, here, strict=True)
            if hours is not None
        ]
        frames = {FITS: fits, OPERATION: kept}
        whole = {
            table.name: pl.DataFrame(some, schema=table.schema, orient="row")
            for table, some in frames.items()
        }
        nothing = {name: of_nothing(name) for name in ("parameters", "block_statistics")}
        publish(output, whole | nothing)


def of_nothing(name: str) -> pl.DataFrame:
    (table,) = (one for one in NIGHT_TABLES if one.name == name)
    return pl.DataFrame(schema=table.schema)


def test_tonight_is_the_newest_night_of_which_samples_are_kept(tmp_path: Path) -> None:
    tables(
        tmp_path,
        (0, "M1", "ok", 8.0),
        (1, "M2", "insufficient_data", 0.5),
        (2, "M1", "stood_still", 0.0),
        (3, "M3", "ok", 8.0),  # of no fleet any more
        (4, "M2", "failed", None),
        (5, "M2", "no_new_data", None),
    )
    found = tonight_of(tmp_path, MOTORS, night_of(9))
    assert found == Tonight(night_of(1), {"M1": night_of(2), "M2": night_of(1)})
    # A motor's own nights with samples count for itself.
    assert (found.of("M1"), found.of("M2"), found.of("M4")) == (
        night_of(2),
        night_of(1),
        night_of(1),
    )


def test_no_night_of_the_future_is_tonight(tmp_path: Path) -> None:
    tables(tmp_path, (0, "M1", "ok", 8.0), (7, "M1", "ok", 8.0))
    found = tonight_of(tmp_path, MOTORS, night_of(6))
    assert found is not None
    assert found.night == night_of(0)
    assert tonight_of(tmp_path, MOTORS, night_of(0) - DAY) is None


def test_without_tables_there_is_none(tmp_path: Path) -> None:
    assert tonight_of(tmp_path, MOTORS, CENTURY) is None
    (tmp_path / "tables" / "fits" / "month=2026-01").mkdir(parents=True)
    (tmp_path / "tables" / "fits" / "month=2026-01" / "strange.parquet").touch()
    assert list(nights_back(tmp_path, FITS)) == []


# Logs by the run's clock


def run_at(workshop: Workshop, night: dt.date, **asked: Any) -> Any:
    (outcome,) = run(workshop.folder, clock=at(night), **asked).outcomes
    return outcome


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop.at(tmp_path)


def test_samples_of_the_future_are_refused_by_the_clock_of_the_run(workshop: Workshop) -> None:
    workshop.log(NIGHT)
    ahead = workshop.log(NIGHT + 3 * DAY, "ahead.parquet")
    outcome = run_at(workshop, NIGHT)
    assert (outcome.status, outcome.error_code) == ("failed", "log_time")
    assert workshop.statuses() == {NIGHT: "ok"}
    row = workshop.rows("input_files").filter(path=f"M1/{ahead.name}").row(0, named=True)
    assert (row["night"], row["error_code"]) == (None, "log_time")
    assert run_at(workshop, NIGHT + 3 * DAY, retry=True).status == "ok"
    assert workshop.statuses() == {NIGHT: "ok", NIGHT + 3 * DAY: "ok"} | {
        NIGHT + day * DAY: "no_new_data" for day in (1, 2)
    }


def test_the_clock_decides_nothing_else(workshop: Workshop, tmp_path: Path) -> None:
    """A backfill of many years ago has the figures that a run of the time would have had."""
    later = Workshop.at(tmp_path / "later")
    for one in (workshop, later):
        one.log(NIGHT)
        one.log(NIGHT + DAY)
        (one.logs / f"{NIGHT + 2 * DAY}.parquet").write_bytes(JUNK)
    run_at(workshop, NIGHT + 2 * DAY)
    run_at(later, dt.date(2050, 1, 1))
    check_same_figures(workshop, later)
    assert workshop.statuses()[NIGHT + 2 * DAY] == "failed"
    for table in ("trends", "alarms", "baselines"):
        assert_frame_equal(workshop.rows(table), later.rows(table))


# Logs of no night


def unread(workshop: Workshop) -> dict[str, dt.date | None]:
    """Night by name of those rows of logs that were not read; each log has one row."""
    found = workshop.rows("input_files")
    assert found["path"].is_unique().all()
    return dict(found.filter(status="failed").select("path", "night").iter_rows())


def test_a_log_of_no_night_stands_under_the_motors_first(workshop: Workshop) -> None:
    workshop.log(NIGHT + DAY)
    path = workshop.logs / "x_2099-01-01.parquet"
    path.write_bytes(JUNK)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_parquet")
    assert "its night would lie more than a day ahead: it is of none" in (outcome.message or "")
    assert unread(workshop) == {"M1/x_2099-01-01.parquet": None}
    assert file_of(workshop, "x_2099-01-01.parquet") == f"{NIGHT:%Y-%m}"
    assert not any("x_2099" in line for line in explain(workshop.output, "M1", NIGHT + DAY))
    # It is told once, as a night that failed is.
    again = workshop.run()
    assert (again.status, again.files["failed"]) == ("no_new_data", 1)
    # An older log comes: the row goes where the motor begins now.
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    assert unread(workshop) == {"M1/x_2099-01-01.parquet": None}
    assert file_of(workshop, "x_2099-01-01.parquet") == f"{NIGHT:%Y-%m}"
    # Other content, still none.
    path.write_bytes(JUNK + JUNK)
    assert workshop.run().status == "failed"
    assert workshop.rows("input_files").filter(status="failed")["size_bytes"].to_list() == [8]


def file_of(workshop: Workshop, name: str) -> str:
    """Label of the table file in which the row of a log stands."""
    (found,) = (
        path.stem
        for path in (workshop.output / "tables" / "input_files").rglob("*.parquet")
        if f"M1/{name}" in pl.read_parquet(path)["path"]
    )
    return found


def test_a_motor_of_nothing_but_such_logs_says_so(workshop: Workshop) -> None:
    (workshop.logs / "x_2099-01-01.parquet").write_bytes(JUNK)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_parquet")
    assert workshop.statuses() == {}
    # Its row comes with the motor's first night.
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    assert unread(workshop) == {"M1/x_2099-01-01.parquet": None}


def test_a_log_is_of_its_night_once_the_motors_logs_reach_there(workshop: Workshop) -> None:
    far = NIGHT + 40 * DAY
    workshop.log(NIGHT)
    (workshop.logs / f"{far}.parquet").write_bytes(JUNK)
    assert workshop.run().counts == {"ok": 1}
    assert unread(workshop) == {f"M1/{far}.parquet": None}
    workshop.log(far - 31 * DAY)
    outcome = workshop.run()
    assert outcome.counts["failed"] == 1
    assert workshop.statuses()[far] == "failed"
    assert unread(workshop) == {f"M1/{far}.parquet": far}
    assert workshop.run().nights == ()


def test_a_junk_file_long_ago_is_withdrawn_and_no_night_before_the_first(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As published by a version that took it for one."""
    workshop.log(NIGHT)
    ago = NIGHT - 40 * DAY
    (workshop.logs / f"{ago}.parquet").write_bytes(JUNK)
    with monkeypatch.context() as patch:
        patch.setattr(told_nights, "FARTHEST_NIGHT", 40_000 * DAY)
        workshop.run()
    assert set(workshop.statuses()) == {ago, NIGHT}
    outcome = workshop.run()
    assert outcome.withdrawn == (ago,)
    assert workshop.statuses() == {NIGHT: "ok"}
    assert workshop.rows("trends")["night"].unique().to_list() == [NIGHT]
    assert unread(workshop) == {f"M1/{ago}.parquet": None}
    assert workshop.run().nights == ()

"""The table `latest`, an output without it, the newest night, and what people said."""

from __future__ import annotations

import datetime as dt
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.schema import LATEST, NIGHTS
from pipeline.store.tables import whole_file
from pipeline.trends.decisions import Decision, read_decisions, record_decision
from pipeline.trends.motor_states import MotorState, published_states
from tests.pipeline.trends.nights import (
    DAY,
    Nights,
    copy_of,
    fleet_of,
    motor,
    named,
    night_of,
    published_trends,
    run,
    step,
)
from tests.pipeline.workshop import Workshop

MOTORS = ("M1", "M2")
N, AT = 20, 14
LAST = night_of(N - 1)
JUNK = b"x\n1\n"


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A motor with a broken sleeve, a healthy one, and their trends."""
    folder = tmp_path_factory.mktemp("watched")
    worn = Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.9)})
    config, _ = fleet_of(folder, worn, Nights(named(motor(), "M2"), N))
    assert run(config).failed == ()
    return folder


@pytest.fixture
def fleet(watched: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A copy of them: the config and the output."""
    return copy_of(watched, tmp_path / "fleet")


def states(output: Path) -> dict[str, MotorState]:
    rows = (dict(state.row) | {"run_id": None} for state in published_states(output, MOTORS))
    return {row["motor_id"]: MotorState(row) for row in rows}


@pytest.mark.parametrize("damage", ["absent", "damaged"])
def test_an_output_without_the_table_is_read_as_the_run_would(
    fleet: tuple[Path, Path], damage: str
) -> None:
    _, output = fleet
    expected = states(output)
    assert expected["M1"].row["cause"] == "balance_sleeve"
    latest = whole_file(output, LATEST)
    latest.write_bytes(b"junk") if damage == "damaged" else latest.unlink()
    assert states(output) == expected


def test_what_was_said_since_the_run_counts(fleet: tuple[Path, Path]) -> None:
    _, output = fleet
    since = states(output)["M1"].row["state_since"]
    when = dt.datetime(2026, 3, 1, tzinfo=dt.UTC)
    early = Decision("M1", "leakage", when, "acknowledged", since - DAY, None, "too early")
    record_decision(output, early)
    assert states(output)["M1"].row["acknowledged"] is None
    record_decision(output, replace(early, night=since, note="rings ordered"))
    assert states(output)["M1"].row["acknowledged"] == "rings ordered"


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("x_2099-01-01.parquet", None),
        ("x.parquet", dt.datetime(2099, 1, 1, tzinfo=dt.UTC)),
        (f"x_{LAST + 20 * DAY}.parquet", None),
    ],
)
def test_a_junk_file_blinds_nobody(
    fleet: tuple[Path, Path], name: str, written: dt.datetime | None
) -> None:
    config, output = fleet
    before = published_trends(output, NIGHTS)
    path = config.parent.parent / "logs" / "M1" / name
    path.parent.mkdir()
    path.write_bytes(JUNK)
    if written is not None:
        os.utime(path, (written.timestamp(), written.timestamp()))
    result = run(config)
    assert [motor.error_code for motor in result.failed] == ["log_not_parquet"]
    assert result.alarms == ()
    nights = published_trends(output, NIGHTS)
    assert_frame_equal(nights.filter(pl.col("status") != "failed"), before)
    assert set(nights["state"]) == set(before["state"])


def test_a_log_of_no_night_is_reported_once_and_stands_in_one_row(workshop: Workshop) -> None:
    night = night_of(50)
    workshop.log(night + DAY)
    (workshop.logs / "x_2099-01-01.parquet").write_bytes(JUNK)
    outcome = workshop.run()
    assert (outcome.status, outcome.error_code) == ("failed", "log_not_parquet")
    again = workshop.run()
    assert (again.status, again.files["failed"]) == ("no_new_data", 1)
    # An older log comes: the row goes where the motor begins now.
    workshop.log(night)
    assert workshop.run().status == "ok"
    newest = workshop.rows("log_files").filter(status="failed")
    assert newest.select("path", "night").rows() == [("M1/x_2099-01-01.parquet", None)]


WHEN = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
NOTE = 'rings worn; "really", said µ—Å\n2nd line'
SAID = Decision(
    "M1", "K_piston_ring", WHEN, "finding", dt.date(2026, 2, 17), "confirmed", NOTE, "piston_ring"
)


def test_the_oldest_is_first_however_many_write_at_once(tmp_path: Path) -> None:
    assert read_decisions(tmp_path) == ()
    assert list(tmp_path.iterdir()) == []  # where nothing was said nothing is made
    decisions = [
        replace(SAID, motor_id=f"M{number}", time=WHEN + dt.timedelta(hours=-number))
        for number in range(40)
    ]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda decision: record_decision(tmp_path, decision), decisions))
    assert read_decisions(tmp_path) == tuple(reversed(decisions))

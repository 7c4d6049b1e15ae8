"""`fit-fleet`: what each option does to the tables; late, changed, damaged and missing logs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.schema import LATEST, NIGHTS, PARAMETERS, QUALITY, TRENDS
from tests.scenarios.command import ROOT
from tests.scenarios.covering import covers
from tests.scenarios.fleets import FIRST, ScenarioFleet, Simulated, make_fleet, table

OF_RUNS = ("run_id",)


@pytest.fixture
def small(tmp_path: Path) -> ScenarioFleet:
    """Two motors, four nights, not fitted yet."""
    motors = (Simulated("A", format="csv"), Simulated("B"))
    return make_fleet(tmp_path, *motors, nights=4, minutes=20.0)


def nights_of(fleet: ScenarioFleet) -> dict[str, list[int]]:
    """Numbers of published nights by motor."""
    rows = fleet.table("nights") if (fleet.output / "tables").exists() else pl.DataFrame()
    found: dict[str, list[int]] = {}
    for row in rows.to_dicts():
        found.setdefault(row["motor_id"], []).append((row["night"] - FIRST).days + 1)
    return found


@covers("fit-fleet --motors --since --until --jobs --output --json")
def test_motors_and_nights_are_those_that_are_chosen(small: ScenarioFleet) -> None:
    elsewhere = small.folder / "elsewhere"
    done = small.run(
        "fit-fleet", "--motors", "B", "--since", small.label(2), "--until", small.label(3),
        "--jobs", 1, "--output", elsewhere, "--json",
    )  # fmt: skip
    assert done.code == 0
    (motor,) = done.events("motor")
    assert (motor["motor_id"], motor["nights"]) == ("B", {"ok": 2})
    files = {"read": 2, "unchanged": 0, "growing": 0, "failed": 0, "left": 2}
    assert motor["files"] == files
    (run,) = done.events("run")
    assert (run["n_motors"], run["n_failed"], run["n_nights"]) == (1, 0, 2)
    assert (run["files"], run["errors"], run["alarms"]) == (files, {}, [])
    assert nights_of(small) == {}
    rows = table(elsewhere, "nights").select("motor_id", "night").rows()
    assert rows == [("B", small.label(2)), ("B", small.label(3))]
    assert table(elsewhere, "runs")["workers"].to_list() == [1]


@covers("fit-fleet --dry-run --redo")
def test_a_dry_run_says_what_a_run_does_and_does_nothing(small: ScenarioFleet) -> None:
    def planned(*arguments: object) -> dict[str, set[str]]:
        done = small.run("fit-fleet", "--dry-run", "--json", *arguments)
        return {
            plan["motor_id"]: {
                f"{night} {work['reason']}" for night, work in plan["nights"].items()
            }
            for plan in done.events("plan")
        }

    new = planned()
    assert {motor: len(nights) for motor, nights in new.items()} == {"A": 4, "B": 4}
    assert nights_of(small) == {}
    small.fitted()
    assert nights_of(small) == {"A": [1, 2, 3, 4], "B": [1, 2, 3, 4]}
    assert planned() == {"A": set(), "B": set()}
    asked = {f"{small.label(night)} asked for" for night in (3, 4)}
    chosen = ("--motors", "A", "--redo", f"{small.label(3)}..{small.label(4)}")
    assert planned(*chosen) == {"A": asked}
    (motor,) = small.run("fit-fleet", *chosen, "--json").events("motor")
    assert motor["nights"] == {"ok": 2}


@covers("fit-fleet --retry")
def test_a_damaged_log_fails_its_night_alone_until_it_is_sound(small: ScenarioFleet) -> None:
    log = small.log("B", 2)
    sound = log.read_bytes()
    log.write_bytes(sound[: len(sound) // 2])
    cut = small.log("A", 3)
    cut.write_bytes(cut.read_bytes()[:-20])
    done = small.run("fit-fleet", "--json")
    assert done.code == 1
    motors = {motor["motor_id"]: motor for motor in done.events("motor")}
    assert motors["A"]["nights"] == {"ok": 4}
    assert motors["B"]["error_code"] in ("log_truncated", "log_not_parquet")
    failed = {row["night"]: row["error_code"] for row in small.nights("B") if row["error_code"]}
    assert failed == {small.label(2): motors["B"]["error_code"]}
    (listed,) = small.table("log_files").filter(pl.col("status") == "failed").to_dicts()
    assert (listed["path"], listed["error_code"]) == (f"B/{log.name}", motors["B"]["error_code"])
    (of_cut,) = small.table("log_files").filter(path=f"A/{cut.name}").to_dicts()
    assert "1 last row without a line end" in of_cut["message"]
    # An unchanged log is not tried again, but where that is asked for; it still stands as failed.
    for arguments, tried in (((), {}), (("--retry",), {"failed": 1})):
        again = small.run("fit-fleet", "--json", *arguments)
        assert again.code == 1
        assert again.events("run")[0]["n_standing"] == 1
        nights = {motor["motor_id"]: motor["nights"] for motor in again.events("motor")}
        assert nights == {"A": {}, "B": tried}
    plain = small.run("fit-fleet", "--retry")
    assert f"B: {motors['B']['error_code']}: " in plain.err
    assert log.name in plain.err
    log.write_bytes(sound)
    assert small.run("fit-fleet").code == 0
    assert {row["status"] for row in small.nights("B")} == {"ok"}


def test_a_late_and_a_changed_log_leave_what_a_run_at_once_does(tmp_path: Path) -> None:
    """A night came late, and a night was half there at first."""
    late = make_fleet(tmp_path / "late", nights=10, minutes=20.0)
    once = late.copy(tmp_path / "once").fitted()
    moved, halved = late.log("M1", 4), late.log("M1", 9)
    contents = {path: path.read_bytes() for path in (moved, halved)}
    moved.unlink()
    rows = pl.read_parquet(halved)
    rows[: rows.height // 2].write_parquet(halved)
    first = late.run("fit-fleet", "--json")
    assert first.events("motor")[0]["nights"] == {"ok": 9, "no_new_data": 1}
    assert "h of log, 0.3 h in the nights before" in late.nights("M1")[8]["log_note"]
    for path, content in contents.items():
        path.write_bytes(content)
    second = late.run("fit-fleet", "--json")
    assert second.events("motor")[0]["files"]["read"] == 2
    for made in (NIGHTS, PARAMETERS, TRENDS, QUALITY, LATEST):
        at_once, by_and_by = (
            fleet.table(made.name).drop(OF_RUNS).sort(made.key) for fleet in (once, late)
        )
        assert_frame_equal(at_once, by_and_by, check_exact=True)


@covers("fit-fleet --fail-on-alarm")
def test_an_alarm_ends_the_run_with_1_where_that_is_asked_for(plant: ScenarioFleet) -> None:
    plant.change("fleet.toml", "[execution]\n", "[alarms]\nalarm_percent = 15.0\n[execution]\n")
    done = plant.run("fit-fleet", "--fail-on-alarm", "--json")
    assert done.code == 1
    states = {row["motor_id"]: row["state"] for row in plant.table("latest").to_dicts()}
    assert states == {"calm": "ok", "broken": "alarm", "worn": "alarm"}
    assert plant.run("fit-fleet", "--fail-on-alarm").code == 0  # nothing new
    raised = plant.table("alarms").filter(pl.col("to_state") == "alarm")
    assert {row["motor_id"] for row in raised.to_dicts()} == {"broken", "worn"}


@pytest.mark.parametrize(
    ("file", "before", "after", "words"),
    [
        ("motors/A.toml", 'oil = "vg68"', 'oil = "vg99"', 'oil: got "vg99"; expected one of vg32'),
        ("motors/B.toml", 'unit = "bar"', 'unit = "kelvin"', "unit: got"),
        ("fleet.toml", "[folders]", "[folders]\nlog = 1", "folders.log"),
        ("fleet.toml", '"../logs"', '"../absent"', "expected a folder"),
        ("fleet.toml", "[folders]", "[folders", "fleet.toml"),
    ],
)
def test_a_broken_config_is_refused_with_its_place(
    small: ScenarioFleet, file: str, before: str, after: str, words: str
) -> None:
    small.change(file, before, after)
    for command in ("fit-fleet", "check", "status"):
        done = small.run(command)
        if command != "status" or "absent" not in after:  # `status` needs no logs
            assert (done.code, done.out) == (2, ""), command
            assert file in done.err
            assert words in done.err
    assert not small.output.exists()


def test_a_fleet_without_a_log(small: ScenarioFleet) -> None:
    for path in (small.folder / "logs").rglob("*.*"):
        path.unlink()
    done = small.run("fit-fleet", "--json")
    assert done.code == 1
    assert {motor["status"] for motor in done.events("motor")} == {"no_new_data"}
    assert nights_of(small) == {}


def test_a_night_too_short_and_one_at_rest(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path, nights=3, minutes=30.0)
    log = fleet.log("M1", 2)
    pl.read_parquet(log)[:120].write_parquet(log)
    still = fleet.log("M1", 3)
    rest = {"speed": pl.lit(0.0), "pressure_difference": pl.lit(12.0)}
    pl.read_parquet(still).with_columns(**rest).write_parquet(still)
    fleet.fitted()
    status = {row["night"]: row["status"] for row in fleet.nights("M1")}
    assert list(status.values()) == ["ok", "insufficient_data", "stood_still"]
    assert all(row["reason"] for row in fleet.nights("M1")[1:])
    words = fleet.run("explain", "M1", fleet.label(3)).out
    assert "stood still" in words


def test_nothing_can_be_published_where_a_file_is(small: ScenarioFleet) -> None:
    (small.folder / "file").write_text("")
    done = small.run("fit-fleet", "--output", small.folder / "file")
    assert (done.code, done.out) == (4, "")
    assert str(small.folder / "file") in done.err


@pytest.mark.parametrize(
    ("number", "code", "backend"),
    [
        (signal.SIGINT, 130, "loky"),
        pytest.param(signal.SIGTERM, 143, "sequential", marks=pytest.mark.full),
        pytest.param(signal.SIGKILL, -9, "loky", marks=pytest.mark.full),
    ],
)
def test_a_second_run_is_turned_away_and_what_is_stopped_goes_on(
    plant: ScenarioFleet,
    shared_plant: ScenarioFleet,
    number: signal.Signals,
    code: int,
    backend: str,
) -> None:
    """By a signal to the run and its workers, as a terminal sends it."""
    plant.output.rename(plant.folder / "before")
    plant.change("fleet.toml", '"sequential"', f'"{backend}"')
    words = ("fit-fleet", "--motors", "broken worn", "--until", str(plant.label(7)))
    command = [sys.executable, "-m", "pipeline.cli", words[0], str(plant.config), *words[1:]]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        while stage_of(plant) != "motors":
            assert process.poll() is None
            time.sleep(0.01)
        # At rest, so that it is not done before the signal, however slow the second one is.
        os.killpg(process.pid, signal.SIGSTOP)
        second = plant.run(*words)
        os.killpg(process.pid, number)
        os.killpg(process.pid, signal.SIGCONT)
        said, _ = process.communicate()
        assert process.returncode == code
    assert ("interrupted; " in said) is (code > 0)
    assert second.code == 3
    assert f"process {process.pid}" in second.err
    plant.change("fleet.toml", f'"{backend}"', '"sequential"')
    assert plant.run(*words).code == 0
    key = ["motor_id", "night", "parameter"]
    made, expected = (
        fleet.table("parameters")
        .filter(pl.col("motor_id").is_in(["broken", "worn"]), pl.col("night") <= plant.label(7))
        .drop(OF_RUNS)
        .sort(key)
        for fleet in (plant, shared_plant)
    )
    assert made.height == expected.height > 0
    assert_frame_equal(made.select(key), expected.select(key))
    assert plant.run("check", "--tables").code == 0


def stage_of(fleet: ScenarioFleet) -> str:
    """What the heartbeat of a run says it is at."""
    try:
        return str(json.loads((fleet.output / "heartbeat.json").read_text())["stage"])
    except FileNotFoundError:
        return ""

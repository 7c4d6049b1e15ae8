"""What is published stays: logs that lose days, are renamed, archived, cut, emptied or replaced."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from tests.scenarios.covering import covers
from tests.scenarios.fleets import DAY, ScenarioFleet, Simulated, make_fleet

TEN_MINUTES = 600
STANDING = ("alarm", "warning")
Fate = Callable[[ScenarioFleet], None]


@pytest.fixture(scope="module")
def _fitted(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    """A motor, four nights."""
    folder = tmp_path_factory.mktemp("stays")
    return make_fleet(folder, format="parquet", nights=4, minutes=30.0).fitted()


@pytest.fixture
def fleet(_fitted: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    """The same, to change at will."""
    return _fitted.copy(tmp_path)


def figures(fleet: ScenarioFleet) -> pl.DataFrame:
    """What nights say of themselves; which run wrote it and what their logs lack is left out."""
    columns = ("motor_id", "night", "status", "first_sample", "logged_hours", "rmse_l_per_min")
    return fleet.table("nights").select(columns)


def rolled(fleet: ScenarioFleet) -> None:
    """Export under one name, that holds the newest days: all nights, then two and a part."""
    rows = [pl.read_parquet(fleet.log("M1", number)) for number in range(1, 5)]
    for number in range(1, 5):
        fleet.log("M1", number).unlink()
    export = fleet.log("M1", 1).with_name("export.parquet")
    pl.concat(rows).write_parquet(export)
    assert fleet.run("fit-fleet").code == 0
    pl.concat([rows[1].tail(TEN_MINUTES), *rows[2:]]).write_parquet(export)


def renamed(fleet: ScenarioFleet) -> None:
    for number in (1, 2):
        fleet.log("M1", number).rename(fleet.log("M1", number).with_name(f"log{number}.parquet"))


def archived(fleet: ScenarioFleet) -> None:
    for number in (1, 2):
        fleet.log("M1", number).unlink()


def truncated(fleet: ScenarioFleet) -> None:
    rows = pl.read_parquet(fleet.log("M1", 2))
    rows[: rows.height // 2].write_parquet(fleet.log("M1", 2))


def emptied(fleet: ScenarioFleet) -> None:
    fleet.log("M1", 2).write_bytes(b"")


def replaced(fleet: ScenarioFleet) -> None:
    """Archive night two; the next file holds ten minutes of it."""
    rows = [pl.read_parquet(fleet.log("M1", number)) for number in (2, 3)]
    fleet.log("M1", 2).unlink()
    pl.concat([rows[0].tail(TEN_MINUTES), rows[1]]).write_parquet(fleet.log("M1", 3))


# By what happens to logs: the exit code, what is said of which nights.
FATES: dict[Fate, tuple[int, dict[int, str]]] = {
    rolled: (0, {1: "no log covers it any more", 2: "its logs hold 2400 samples now, and held"}),
    renamed: (0, {}),
    archived: (0, {}),
    truncated: (0, {2: "its logs hold"}),
    emptied: (1, {2: "M1_2026-01-03.parquet: the file has no bytes"}),
    replaced: (0, {2: "its logs hold 2400 samples now, and held"}),
}


@pytest.mark.parametrize("fate", FATES)
def test_logs_that_lose_what_a_night_was_made_from_change_none(
    fleet: ScenarioFleet, fate: Fate
) -> None:
    before = figures(fleet)
    fate(fleet)
    code, expected = FATES[fate]
    done = fleet.run("fit-fleet", "--json")
    assert done.code == code, done.err
    assert_frame_equal(figures(fleet), before)
    (motor,) = done.events("motor")
    stays = {str(fleet.label(number)): why for number, why in expected.items()}
    assert motor["stays"].keys() == stays.keys(), motor
    for night, why in stays.items():
        assert motor["stays"][night].startswith(why)
    notes = {str(row["night"]): row["log_note"] for row in fleet.nights("M1")}
    for night, why in stays.items():
        assert notes[night].startswith(f"as published: {why}")
    assert all(not note for night, note in notes.items() if night not in stays)
    # Once: the next run has nothing to say of it, but for a log that cannot be read.
    (again,) = fleet.run("fit-fleet", "--json").events("motor")
    assert (again["nights"], again["stays"]) == ({}, {})
    for command in ("check", "status") if expected else ():
        said = fleet.run(command)
        for number, why in expected.items():
            assert f"as published 1 night, {fleet.label(number)}: {why}" in said.out + said.err


@covers("fit-fleet --redo")
def test_a_person_may_ask_for_less(fleet: ScenarioFleet) -> None:
    truncated(fleet)
    done = fleet.run("fit-fleet")
    assert f"M1: as published 1 night, {fleet.label(2)}: its logs hold" in done.err
    before = figures(fleet)
    assert fleet.run("fit-fleet", "--redo", fleet.label(2)).code == 0
    changed = figures(fleet).join(before, on=before.columns, how="anti", nulls_equal=True)
    assert changed["night"].to_list() == [fleet.label(2)]
    assert [row["log_note"] for row in fleet.nights("M1")] == [None] * 4


def test_logs_that_come_back_make_the_night_anew(fleet: ScenarioFleet, tmp_path: Path) -> None:
    before = figures(fleet)
    log = fleet.log("M1", 2)
    shutil.copy(log, tmp_path / "whole")
    truncated(fleet)
    fleet.run("fit-fleet")
    shutil.copy(tmp_path / "whole", log)
    (motor,) = fleet.run("fit-fleet", "--json").events("motor")
    assert (motor["nights"], motor["stays"]) == ({"ok": 1}, {})
    assert_frame_equal(figures(fleet), before)
    assert [row["log_note"] for row in fleet.nights("M1")] == [None] * 4


def test_an_alarm_that_corrected_logs_do_not_show_closes_as_recomputed(
    plant: ScenarioFleet,
) -> None:
    told = plant.folder / "told"
    command = json.dumps(["/bin/sh", "-c", 'cat >> "$0"; echo >> "$0"', str(told)])
    plant.append("fleet.toml", f"[alarms]\ncommand = {command}\n")
    plant.run("fit-fleet")
    alarms = plant.table("alarms").filter(pl.col("motor_id") == "broken").drop("run_id")
    raised = alarms.row(-1, named=True)
    assert raised["to_state"] in STANDING
    sound = replace(plant, motors={"broken": Simulated("broken")})
    for number in range(14, 21):
        sound.write_night("broken", number)
    assert plant.run("fit-fleet").code == 0
    now = plant.table("alarms").filter(pl.col("motor_id") == "broken").drop("run_id")
    assert_frame_equal(now.head(alarms.height), alarms)  # nothing that was raised is gone
    (closing,) = now[alarms.height :].to_dicts()
    assert (closing["from_state"], closing["to_state"]) == (raised["to_state"], "ok")
    assert closing["closed_as"] == "recomputed"
    assert f"what was raised on {raised['night']} is not in the figures" in closing["sentence"]
    assert plant.newest("broken")["state"] == "ok"
    (delivery,) = map(json.loads, told.read_text().splitlines())
    (row,) = delivery["changes"]
    assert (row["id"], row["closed_as"]) == (closing["id"], "recomputed")


# Others are tried in `test_whose_output.py`.
SETTINGS = {
    "motor_type": ("motors/M1.toml", 'motor_type = "CB400"', 'motor_type = "CB560"'),
    "nights.end_hour": ("fleet.toml", "[execution]", "[nights]\nend_hour = 5\n[execution]"),
}


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_corrected_setting_redoes_what_it_can_and_names_the_others(
    fleet: ScenarioFleet, setting: str
) -> None:
    before = figures(fleet)
    archived(fleet)
    fleet.run("fit-fleet")
    fleet.change(*SETTINGS[setting])
    (plan,) = fleet.run("fit-fleet", "--dry-run", "--json").events("plan")
    works = {night: work["work"] for night, work in plan["nights"].items()}
    assert list(works.values()) == ["stay", "stay", "read", "read"]
    (motor,) = fleet.run("fit-fleet", "--json").events("motor")
    assert motor["nights"] == {"ok": 2}
    assert motor["anew"].startswith(f"2 nights made anew: changed setting {setting}")
    assert motor["stays"].keys() == {str(fleet.label(1)), str(fleet.label(2))}
    assert all(why.endswith("its logs are gone") for why in motor["stays"].values())
    assert_frame_equal(figures(fleet).head(2), before.head(2))
    assert fleet.run("fit-fleet", "--json").events("motor")[0]["stays"] == {}


def test_a_refusal_by_the_clock_is_tried_again_once_it_has_passed_the_stamps(
    tmp_path: Path, turn_clock: Callable[[dt.timedelta], None]
) -> None:
    """Nights of which the newest lies three days ahead of a clock that is wrong."""
    first = dt.datetime.now(dt.UTC).date() - 2 * DAY
    fleet = make_fleet(tmp_path, nights=6, minutes=30.0, first_night=first)
    for number in (4, 5):
        fleet.log("M1", number).unlink()
    done = fleet.run("fit-fleet")
    assert done.code == 1
    assert "set the clock that is wrong, this machine's or the logger's" in done.err
    assert fleet.run("fit-fleet", "--json").events("motor")[0]["nights"] == {}
    turn_clock(3 * DAY)
    done = fleet.run("fit-fleet")
    assert done.code == 0, done.err
    assert [row["status"] for row in fleet.nights("M1") if row["last_sample"]] == ["ok"] * 4

"""An output and its fleet: foreign or restored state, motors removed or renamed, silence."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from tests.scenarios.covering import covers
from tests.scenarios.fleets import DAY, ScenarioFleet, Simulated, make_fleet

STANDING = ("alarm", "warning")


@pytest.fixture(scope="module")
def _fitted(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    motors = Simulated("A"), Simulated("B")
    return make_fleet(tmp_path_factory.mktemp("small"), *motors, nights=2, minutes=20.0).fitted()


@pytest.fixture
def small(_fitted: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    """Two motors, two nights, fitted; to change at will."""
    return _fitted.copy(tmp_path / "small")


def nights(fleet: ScenarioFleet) -> pl.DataFrame:
    return fleet.table("nights").drop("run_id")


def test_the_output_of_another_fleet_is_refused(small: ScenarioFleet, tmp_path: Path) -> None:
    other = make_fleet(tmp_path / "other", Simulated("C"), nights=1, minutes=20.0)
    before = nights(small)
    for name in ("Scenario", "Other"):  # other motors; another name
        other.config.write_text(other.config.read_text().replace("Scenario", name))
        done = other.run("fit-fleet", "--output", small.output)
        assert (done.code, "fleet_output" in done.err) == (2, True), done.err
        assert f'"{small.output}" is of the fleet' in done.err or "is of the fleet" in done.err
    other.run("fit-fleet")
    for path in small.output.glob("state.db*"):
        path.unlink()
    shutil.copy(other.output / "state.db", small.output)
    assert small.run("fit-fleet").code == 2
    assert_frame_equal(nights(small), before)
    # Without any state the runs in the tables say whose they are.
    (small.output / "state.db").unlink()
    assert other.run("fit-fleet", "--output", small.output).code == 2
    assert small.run("fit-fleet").code == 0
    assert_frame_equal(nights(small), before, check_row_order=False)


def test_a_fleet_that_is_renamed_says_so(small: ScenarioFleet) -> None:
    small.change("fleet.toml", '"Scenario"', '"New name"')
    assert small.run("fit-fleet").code == 2
    small.change("fleet.toml", "live", 'formerly = "Scenario"\nlive')
    assert small.run("fit-fleet").code == 0


def test_a_restored_state_file_costs_nothing_that_is_published_or_said(
    plant: ScenarioFleet, tmp_path: Path
) -> None:
    log, kept = plant.log("broken", 20), tmp_path / "night"
    old = tmp_path / "state.db"
    shutil.copy(plant.output / "state.db", old)
    plant.run("ack", "broken", "--note", "ordered")
    content = pl.read_parquet(log)
    for number in range(1, 5):
        plant.log("broken", number).unlink()
    log.rename(kept)
    content.write_parquet(log.with_name("again.parquet"))  # something new for the run to publish
    plant.run("fit-fleet")
    plant.run("ack", "broken", "--note", "mounted")  # which no run has published yet
    before = {name: plant.table(name).drop("run_id") for name in ("nights", "alarms", "fits")}
    for path in plant.output.glob("state.db-*"):
        path.unlink()
    shutil.copy(old, plant.output / "state.db")
    done = plant.run("fit-fleet", "--motors", "broken")
    assert done.code == 0, done.err
    for name, rows in before.items():
        assert_frame_equal(plant.table(name).drop("run_id"), rows, check_row_order=False)
    assert plant.newest("broken")["acknowledged"] == "mounted"
    assert plant.table("decisions")["note"].sort().to_list() == ["mounted", "ordered"]
    assert plant.run("check", "--tables").code == 0


@covers("ack --note")
def test_a_motor_that_is_gone_stays_until_a_person_confirms_it(
    plant: ScenarioFleet, caplog: pytest.LogCaptureFixture
) -> None:
    before = plant.newest("broken")
    assert before["state"] in STANDING
    file = plant.config.parent / "motors" / "broken.toml"
    file.rename(plant.folder / "broken.toml")
    plant.run("fit-fleet")
    assert "broken is in the config no more" in caplog.text
    caplog.clear()
    row = plant.newest("broken")
    assert row["state"] == "removed"
    assert before["state"] in row["sentence"]
    assert before["sentence"] in row["sentence"]
    assert "broken\tremoved\t" in plant.run("status").out
    plant.run("report", "--nights", 1)
    assert '<li data-motor="broken">' in (plant.output / "report" / "index.html").read_text("utf-8")
    page = plant.output / "report" / "motors" / "broken.html"
    assert before["sentence"][1:] in page.read_text("utf-8")
    plant.run("fit-fleet")
    assert "in the config no more" not in caplog.text  # once is enough
    assert plant.run("ack", "broken", "--note", "scrapped").code == 0
    assert "broken" not in plant.run("status").out
    plant.run("report", "--nights", 1)
    assert not page.exists()
    plant.run("fit-fleet")
    assert "broken" not in plant.table("latest")["motor_id"].to_list()
    (plant.folder / "broken.toml").rename(file)  # and is there again with all that it had
    plant.run("fit-fleet")
    assert {**plant.newest("broken"), "run_id": ""} == {**before, "run_id": ""}


def rename(plant: ScenarioFleet) -> None:
    """Call the motor `broken` M7."""
    old = plant.config.parent / "motors" / "broken.toml"
    text = old.read_text().replace('motor_id = "broken"', 'motor_id = "M7"\nformerly = "broken"')
    old.with_name("M7.toml").write_text(text)
    old.unlink()


def test_a_renamed_motor_keeps_its_history_and_its_alarm(plant: ScenarioFleet) -> None:
    plant.run("ack", "broken", "--note", "ordered")
    plant.run("fit-fleet")
    names = ("nights", "fits", "blocks", "quality", "trends", "latest")
    before = {name: plant.table(name) for name in names}
    rename(plant)
    for number in range(1, 5):
        plant.log("broken", number).unlink()
    done = plant.run("fit-fleet", "--json")
    assert done.code == 0, done.err
    assert done.events("run")[0]["alarms"] == []
    for name, rows in before.items():
        now = plant.table(name).drop("run_id")
        assert "broken" not in now["motor_id"].to_list()
        moved = rows.drop("run_id").with_columns(
            pl.col("motor_id").replace("broken", "M7").cast(rows["motor_id"].dtype)
        )
        key = [one for one in ("motor_id", "night", "channel", "reason", "indicator",
            "block_start", "flushing_mode") if one in now.columns]  # fmt: skip
        assert_frame_equal(now.sort(key), moved.sort(key), check_exact=True)
    assert plant.newest("M7")["acknowledged"] == "ordered"
    assert plant.run("check", "--tables").code == 0


def test_a_change_that_waits_for_a_receiver_is_sent_once_under_the_new_name(
    plant: ScenarioFleet,
) -> None:
    refused, taken = plant.folder / "refused", plant.folder / "taken"
    script = 'cat > "$0"; [ -e "$1" ] && cat "$0" >> "$1" && echo >> "$1"'
    command = json.dumps(["/bin/sh", "-c", script, str(refused), str(taken)])
    plant.append("fleet.toml", f"[alarms]\ncommand = {command}\n")
    plant.run("fit-fleet")
    plant.change("fleet.toml", "[alarms]\n", "[alarms]\nalarm_percent = 15.0\n")
    plant.run("fit-fleet")
    waiting = json.loads(refused.read_text())["changes"]
    assert {row["motor_id"] for row in waiting} == {"broken", "worn"}
    rename(plant)
    taken.touch()
    for _ in range(2):
        assert plant.run("fit-fleet").code == 0
    lines = taken.read_text().splitlines()
    sent = [row for line in lines for row in json.loads(line)["changes"]]
    names = {"broken": "M7", "worn": "worn"}
    expected = [(names[row["motor_id"]], row["night"], row["to_state"]) for row in waiting]
    assert sorted((row["motor_id"], row["night"], row["to_state"]) for row in sent) == expected
    (fleet,) = plant.run("status", "--json").events("fleet")
    assert [receiver["undelivered"] for receiver in fleet["receivers"]] == [0]


def test_a_plant_without_a_new_night_is_stale_by_the_clock(tmp_path: Path) -> None:
    """Logs of weeks ago; a fleet of a past time is exempt by its config."""
    first = dt.datetime.now(dt.UTC).date() - 30 * DAY
    fleet = make_fleet(tmp_path, nights=9, minutes=20.0, first_night=first)
    for live in (False, True):
        if live:
            fleet.change("fleet.toml", "live = false\n", "")
        assert fleet.run("fit-fleet").code == 0
        assert fleet.newest("M1")["state"] == ("stale" if live else "ok")
        raised = fleet.table("alarms").filter(pl.col("to_state") == "stale")
        assert raised.height == live
        status = fleet.run("status", "--max-age", "26h")
        assert (status.code, "the plant is silent" in status.out + status.err) == (int(live), live)


def test_a_run_without_any_log_is_no_good_run(small: ScenarioFleet) -> None:
    before = small.run("status", "--json").events("fleet")[0]["last_good_run"]
    rows = nights(small)
    (small.folder / "logs").rename(small.folder / "unmounted")
    (small.folder / "logs").mkdir()
    assert small.run("fit-fleet").code == 1
    assert small.run("status", "--json").events("fleet")[0]["last_good_run"] == before
    assert_frame_equal(nights(small), rows)


SETTINGS = {
    "oil": ('oil = "vg68"', 'oil = "vg46"'),
    "scale": ('source = "leakage_flow"', 'source = "leakage_flow"\nscale = 1.1'),
}


@pytest.mark.parametrize("setting", ["oil", pytest.param("scale", marks=pytest.mark.full)])
def test_an_alarm_in_force_outlives_a_setting_whose_older_logs_are_archived(
    plant: ScenarioFleet, setting: str
) -> None:
    before = plant.newest("broken")
    assert before["state"] in STANDING
    plant.run("ack", "broken", "--note", "ordered")
    for number in range(1, 18):
        plant.log("broken", number).unlink()
    plant.run("fit-fleet")
    raised = plant.table("alarms").filter(pl.col("motor_id") == "broken").height
    plant.change("motors/broken.toml", *SETTINGS[setting])
    planned = plant.run("fit-fleet", "--dry-run", "--motors", "broken").out
    assert f"broken: {before['state']} since {before['state_since']} stays in force" in planned
    done = plant.run("fit-fleet", "--motors", "broken", "--json")
    assert done.events("run")[0]["alarms"] == []
    row = plant.newest("broken")
    for column in ("state", "state_since"):
        assert row[column] == before[column], row["sentence"]
    assert row["acknowledged"] == "ordered"
    assert f"in force since {before['state_since']} by the settings of then" in row["sentence"]
    assert plant.table("alarms").filter(pl.col("motor_id") == "broken").height == raised
    # Until people end it: by a finding, an event, or a reset.
    words = ("--note", "tight", "--finding", "not_confirmed")
    assert plant.run("ack", "broken", *words).code == 0
    plant.run("fit-fleet", "--motors", "broken", "--redo", plant.label(20))
    assert plant.newest("broken")["state"] not in STANDING

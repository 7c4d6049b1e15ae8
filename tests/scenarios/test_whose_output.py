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
from tests.scenarios.fleets import DAY, PISTON, SLEEVE, ScenarioFleet, Simulated, make_fleet, step

STANDING = ("alarm", "warning")
LAST = 12  # night of the worn motors


@pytest.fixture(scope="module")
def _fitted(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    motors = Simulated("A"), Simulated("B")
    return make_fleet(tmp_path_factory.mktemp("small"), *motors, nights=2, minutes=20.0).fitted()


@pytest.fixture
def small(_fitted: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    """Two motors, two nights, fitted; to change at will."""
    return _fitted.copy(tmp_path / "small")


@pytest.fixture(scope="module")
def _worn(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    motors = (
        Simulated("broken", step(SLEEVE, at=10, gap=0.15)),
        Simulated("worn", step(PISTON, at=10, gap=0.25)),
    )
    return make_fleet(tmp_path_factory.mktemp("worn"), *motors, nights=LAST).fitted()


@pytest.fixture
def worn(_worn: ScenarioFleet, tmp_path: Path) -> ScenarioFleet:
    """Two motors that are worn from night 10 on; to change at will."""
    return _worn.copy(tmp_path / "worn")


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
    worn: ScenarioFleet, tmp_path: Path
) -> None:
    log, kept = worn.log("broken", LAST), tmp_path / "night"
    old = tmp_path / "state.db"
    shutil.copy(worn.output / "state.db", old)
    worn.run("ack", "broken", "--note", "ordered")
    content = pl.read_parquet(log)
    for number in range(1, 5):
        worn.log("broken", number).unlink()
    log.rename(kept)
    content.write_parquet(log.with_name("again.parquet"))  # something new for the run to publish
    worn.run("fit-fleet")
    worn.run("ack", "broken", "--note", "mounted")  # which no run has published yet
    before = {name: worn.table(name).drop("run_id") for name in ("nights", "alarms", "fits")}
    for path in worn.output.glob("state.db-*"):
        path.unlink()
    shutil.copy(old, worn.output / "state.db")
    done = worn.run("fit-fleet", "--motors", "broken")
    assert done.code == 0, done.err
    for name, rows in before.items():
        assert_frame_equal(worn.table(name).drop("run_id"), rows, check_row_order=False)
    assert worn.newest("broken")["acknowledged"] == "mounted"
    assert worn.table("decisions")["note"].sort().to_list() == ["mounted", "ordered"]
    assert worn.run("check", "--tables").code == 0


@pytest.mark.parametrize(
    "loss",
    [pytest.param("state.db gone", marks=pytest.mark.full), "state.db damaged", "table damaged"],
)
def test_what_people_entered_outlives_the_state_file_or_the_table(
    worn: ScenarioFleet, loss: str
) -> None:
    """Right after it was entered, and where something is entered again; figures stay as well."""
    nights = worn.table("nights").drop("run_id")
    worn.run("ack", "broken", "--note", "seen")
    table = worn.output / "tables" / "decisions" / "decisions.parquet"
    if loss == "table damaged":
        table.write_bytes(b"damaged")
    else:
        for path in worn.output.glob("state*"):
            path.unlink()
    if loss == "state.db damaged":
        (worn.output / "state.db").write_bytes(b"damaged")
        worn.run("fit-fleet", "--motors", "broken")
        assert_frame_equal(worn.table("nights").drop("run_id"), nights, check_row_order=False)
    worn.run("ack", "broken", "--note", "seen again")
    assert worn.table("decisions")["note"].sort().to_list() == ["seen", "seen again"]
    worn.run("fit-fleet", "--motors", "broken")
    assert worn.table("decisions")["note"].sort().to_list() == ["seen", "seen again"]
    assert worn.newest("broken")["acknowledged"] == "seen again"


@covers("ack --note")
def test_a_motor_that_is_gone_stays_until_a_person_confirms_it(
    worn: ScenarioFleet, caplog: pytest.LogCaptureFixture
) -> None:
    before = worn.newest("broken")
    assert before["state"] in STANDING
    file = worn.config.parent / "motors" / "broken.toml"
    file.rename(worn.folder / "broken.toml")
    worn.run("fit-fleet")
    assert "broken is in the config no more" in caplog.text
    caplog.clear()
    row = worn.newest("broken")
    assert row["state"] == "removed"
    assert before["state"] in row["sentence"]
    assert before["sentence"] in row["sentence"]
    assert "broken\tremoved\t" in worn.run("status").out
    worn.run("report", "--nights", 1)
    assert '<li data-motor="broken">' in (worn.output / "report" / "index.html").read_text("utf-8")
    page = worn.output / "report" / "motors" / "broken.html"
    assert before["sentence"][1:] in page.read_text("utf-8")
    worn.run("fit-fleet")
    assert "in the config no more" not in caplog.text  # once is enough
    assert worn.run("ack", "broken", "--note", "scrapped").code == 0
    assert "broken" not in worn.run("status").out
    worn.run("report", "--nights", 1)
    assert not page.exists()
    worn.run("fit-fleet")
    assert "broken" not in worn.table("latest")["motor_id"].to_list()
    (worn.folder / "broken.toml").rename(file)  # and is there again with all that it had
    worn.run("fit-fleet")
    assert {**worn.newest("broken"), "run_id": ""} == {**before, "run_id": ""}


def rename(worn: ScenarioFleet) -> None:
    """Call the motor `broken` M7."""
    old = worn.config.parent / "motors" / "broken.toml"
    text = old.read_text().replace('motor_id = "broken"', 'motor_id = "M7"\nformerly = "broken"')
    old.with_name("M7.toml").write_text(text)
    old.unlink()


def test_a_renamed_motor_keeps_its_history_and_its_alarm(worn: ScenarioFleet) -> None:
    worn.run("ack", "broken", "--note", "ordered")
    worn.run("fit-fleet")
    names = ("nights", "fits", "blocks", "quality", "trends", "latest")
    before = {name: worn.table(name) for name in names}
    rename(worn)
    for number in range(1, 5):
        worn.log("broken", number).unlink()
    done = worn.run("fit-fleet", "--json")
    assert done.code == 0, done.err
    assert done.events("run")[0]["alarms"] == []
    for name, rows in before.items():
        now = worn.table(name).drop("run_id")
        assert "broken" not in now["motor_id"].to_list()
        moved = rows.drop("run_id").with_columns(
            pl.col("motor_id").replace("broken", "M7").cast(rows["motor_id"].dtype)
        )
        key = [one for one in ("motor_id", "night", "channel", "reason", "indicator",
            "block_start", "flushing_mode") if one in now.columns]  # fmt: skip
        assert_frame_equal(now.sort(key), moved.sort(key), check_exact=True)
    assert worn.newest("M7")["acknowledged"] == "ordered"
    assert worn.run("check", "--tables").code == 0


def test_a_change_that_waits_for_a_receiver_is_sent_once_under_the_new_name(
    worn: ScenarioFleet,
) -> None:
    refused, taken = worn.folder / "refused", worn.folder / "taken"
    script = 'cat > "$0"; [ -e "$1" ] && cat "$0" >> "$1" && echo >> "$1"'
    command = json.dumps(["/bin/sh", "-c", script, str(refused), str(taken)])
    worn.append("fleet.toml", f"[alarms]\ncommand = {command}\n")
    worn.run("fit-fleet")
    worn.change("fleet.toml", "[alarms]\n", "[alarms]\nalarm_percent = 15.0\n")
    worn.run("fit-fleet")
    waiting = json.loads(refused.read_text())["changes"]
    assert {row["motor_id"] for row in waiting} == {"broken", "worn"}
    rename(worn)
    taken.touch()
    for _ in range(2):
        assert worn.run("fit-fleet").code == 0
    lines = taken.read_text().splitlines()
    sent = [row for line in lines for row in json.loads(line)["changes"]]
    names = {"broken": "M7", "worn": "worn"}
    expected = [(names[row["motor_id"]], row["night"], row["to_state"]) for row in waiting]
    assert sorted((row["motor_id"], row["night"], row["to_state"]) for row in sent) == expected
    (fleet,) = worn.run("status", "--json").events("fleet")
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


def n_raised(worn: ScenarioFleet) -> int:
    alarms = worn.table("alarms").filter(pl.col("to_state").is_in(STANDING), motor_id="broken")
    return alarms.height


# The night on which it was raised is among those that are archived, or among those made anew.
@pytest.mark.parametrize(
    ("setting", "n_left"),
    [("oil", 1), ("oil", 3), pytest.param("scale", 1, marks=pytest.mark.full)],
)
def test_an_alarm_in_force_outlives_a_setting_whose_older_logs_are_archived(
    worn: ScenarioFleet, setting: str, n_left: int
) -> None:
    before = worn.newest("broken")
    assert before["state"] in STANDING
    worn.run("ack", "broken", "--note", "ordered")
    for number in range(1, LAST - n_left + 1):
        worn.log("broken", number).unlink()
    worn.run("fit-fleet")
    raised = n_raised(worn)
    worn.change("motors/broken.toml", *SETTINGS[setting])
    planned = worn.run("fit-fleet", "--dry-run", "--motors", "broken").out
    assert f"broken: {before['state']} since {before['state_since']} stays in force" in planned
    done = worn.run("fit-fleet", "--motors", "broken", "--json")
    assert done.events("run")[0]["alarms"] == []
    row = worn.newest("broken")
    for column in ("state", "state_since"):
        assert row[column] == before[column], row["sentence"]
    assert row["acknowledged"] == "ordered"
    assert f"in force since {before['state_since']} by the settings of then" in row["sentence"]
    assert n_raised(worn) == raised
    worn.write_night("broken", LAST + 1)
    worn.run("fit-fleet", "--motors", "broken")
    assert worn.newest("broken")["state_since"] == before["state_since"]
    # Until people end it: by a finding, an event, or a reset.
    words = ("--note", "tight", "--finding", "not_confirmed")
    assert worn.run("ack", "broken", *words).code == 0
    worn.run("fit-fleet", "--motors", "broken", "--redo", worn.label(LAST))
    assert worn.newest("broken")["state"] not in STANDING

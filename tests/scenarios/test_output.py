"""The output folder: export, prune, check of tables, and what a run does about damage."""

from __future__ import annotations

import datetime as dt
import os
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet


@covers("export --csv --tables --motors --since --until --output")
def test_csv_has_the_rows_of_the_tables(plant: ScenarioFleet) -> None:
    since, until = plant.label(5), plant.label(7)
    done = plant.run(
        "export", "--csv", "csv", "--tables", "latest,parameters", "--motors", "broken calm",
        "--since", since, "--until", until, "--output", plant.output,
    )  # fmt: skip
    files = sorted(path.name for path in (plant.folder / "csv").iterdir())
    assert files == ["latest.csv", "parameters.csv"]
    published = plant.table("parameters").filter(
        pl.col("motor_id").is_in(["broken", "calm"]) & pl.col("night").is_between(since, until)
    )
    written = pl.read_csv(plant.folder / "csv" / "parameters.csv", schema=published.schema)
    key = ["motor_id", "night", "flushing_mode", "parameter"]
    assert_frame_equal(written.sort(key), published.sort(key))
    assert f"parameters.csv: {published.height} rows" in done.out


@covers("export --separator --decimal --bom")
def test_csv_for_a_spreadsheet_with_a_decimal_comma(plant: ScenarioFleet) -> None:
    done = plant.run(
        "export", "--csv", "csv", "--tables", "latest", "--separator", ";", "--decimal", ",",
        "--bom",
    )  # fmt: skip
    content = (plant.folder / "csv" / "latest.csv").read_bytes()
    assert content.startswith("\ufeffmotor_id;night;".encode())
    written = pl.read_csv(content, separator=";", decimal_comma=True)
    value = "own_leakage_l_per_min"
    published = plant.table("latest").select("motor_id", value).sort("motor_id")
    assert_frame_equal(written.select("motor_id", value).sort("motor_id"), published)
    assert "latest.csv: 3 rows" in done.out


@covers("prune --tables --keep --yes --json --output")
def test_prune_lists_and_then_removes_old_nights_of_heavy_tables(plant: ScenarioFleet) -> None:
    def nights() -> list[dt.date]:
        return plant.table("predictions")["night"].unique().sort().to_list()

    words = ("prune", "--tables", "predictions", "--keep", 5, "--output", plant.output)
    before, states = nights(), plant.table("latest")
    for arguments, removed, left in (((), False, before), (("--yes",), True, before[-5:])):
        (line,) = plant.run(*words, "--json", *arguments).events("prune")
        assert (line["table"], line["n_files"], line["removed"]) == ("predictions", 15, removed)
        assert (line["first_night"], line["last_night"]) == ("2026-01-02", "2026-01-16")
        assert nights() == left
    assert_frame_equal(plant.table("latest"), states)
    # A baseline in force keeps its blocks: a late log would end what was detected.
    plant.run("prune", "--tables", "blocks", "--keep", 5, "--yes")
    calm, left = plant.newest("calm"), set(plant.table("blocks")["night"])
    assert {calm["baseline_start"], calm["baseline_end"], before[-1]} <= left < set(before)
    (plan, *_) = plant.run("fit-fleet", "--dry-run", "--json").events("plan")
    assert plan["nights"] == {}


@covers("check --json --output")
def test_check_looks_at_each_log(plant: ScenarioFleet) -> None:
    def motors(code: int) -> dict[str, dict[str, object]]:
        done = plant.run("check", "--json", "--output", plant.output)
        assert done.code == code
        return {line["motor_id"]: line for line in done.lines if "log_format" in line}

    for motor, line in motors(0).items():
        assert (line["n_files"], line["n_nights"], line["faults"]) == (20, 20, [])
        assert line["log_format"] == plant.motors[motor].format
        assert (line["first"], line["last"]) == ("2026-01-02", "2026-01-21")
        channels = {channel["channel"]: channel for channel in line["channels"]}
        assert 15.0 < channels["pressure_difference"]["median"] < 280.0
        assert round(channels["speed"]["rate_hz"], 3) == 1.0
    plant.log("calm", 7).write_text("time,pressure_difference\n1,2\n")
    plant.change("motors/broken.toml", 'source = "speed"', 'source = "rpm"')
    damaged = motors(1)
    assert "calm_2026-01-08.csv" in str(damaged["calm"]["faults"])
    assert "rpm" in str(damaged["broken"]["faults"])
    assert damaged["worn"]["faults"] == []


@covers("check --json --output")
def test_of_a_large_fleet_a_hundred_motors_are_judged_new_motors_first(
    plant: ScenarioFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.cli.checking.JUDGED_AT_MOST", len(plant.motors) - 1)
    output = ("--output", plant.folder / "anew")
    assert plant.run("fit-fleet", *output, "--motors", "calm", "--since", plant.label(20)).code == 0
    done = plant.run("check", "--json", *output)
    (event,) = [line for line in done.lines if line.get("event") == "judged"]
    assert event["motors"] == sorted(plant.motors.keys() - {"calm"})
    motors = {line["motor_id"]: line for line in done.lines if "log_format" in line}
    assert [name for name, line in motors.items() if not line["channels"]] == ["calm"]
    assert (motors["calm"]["n_nights"], motors["calm"]["forecast"]) == (20, [])


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('unit = "bar"', 'unit = "MPa"', "usual if the log's unit were bar or psi"),
        ('unit = "degC"', 'unit = "K"', "typically -221 °C, which is unusual"),
        ('source = "leakage_flow"', 'source = "speed_rpm"', "speed_rpm"),
    ],
)
def test_check_finds_what_a_config_has_wrong_of_the_logs(
    plant: ScenarioFleet, before: str, after: str, words: str
) -> None:
    plant.change("motors/broken.toml", before, after)
    done = plant.run("check")
    assert done.code == 1
    assert words in done.out + done.err


def test_check_names_logs_of_no_motor_and_columns_that_look_swapped(plant: ScenarioFleet) -> None:
    (plant.folder / "logs" / "stray.csv").write_text("time,a\n")
    text = (plant.config.parent / "motors" / "broken.toml").read_text("utf-8")
    swapped = text.replace('"speed"', '"?"').replace('"oil_temperature"', '"speed"')
    plant.change("motors/broken.toml", text, swapped.replace('"?"', '"oil_temperature"'))
    done = plant.run("check")
    assert "stray.csv" in done.out + done.err
    words = "oil_temperature jumps"
    assert words in done.out
    assert "are columns swapped" in done.out
    # The first run says so as well, of what it reads; the next ones do not.
    options = "--output", plant.folder / "new", "--motors", "broken worn", "--until", "2026-01-04"
    for is_first in (True, False):
        done = plant.run("fit-fleet", *options)
        assert "stray.csv" in done.err
        findings = [line for line in done.err.splitlines() if words in line]
        assert [line.split()[0] for line in findings] == ["broken:"] * is_first


def a_table(plant: ScenarioFleet) -> Path:
    """The newest file of the measured and modelled flow."""
    return max((plant.output / "tables" / "predictions").rglob("*.parquet"))


@covers("check --tables", "fit-fleet --repair")
def test_a_damaged_table_is_detected_and_made_again(plant: ScenarioFleet) -> None:
    path, before = a_table(plant), plant.table("predictions").drop("run_id")
    content, times = path.read_bytes(), path.stat()
    path.write_bytes(content[:-9] + bytes(9))
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # as where a disk fails
    found = plant.run("check", "--tables", "--json")
    assert found.code == 1
    assert found.events("tables")[0]["n_faults"] == 1
    assert "table_altered" in str(found.lines)
    (run,) = plant.run("fit-fleet", "--repair", "--json").events("run")
    assert [fault["code"] for fault in run["damage"]] == ["table_altered"]
    assert run["damage_left"] == []
    after = plant.run("check", "--tables", "--json")
    assert (after.code, after.events("tables")[0]["n_faults"]) == (0, 0)
    assert_frame_equal(plant.table("predictions").drop("run_id"), before, check_row_order=False)

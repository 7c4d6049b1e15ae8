"""Trends of nights that come in parts, with a checkpoint or without; events; a motor that fails."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.schema import BLOCKS, FITS, NIGHTS, PARAMETERS, TREND_TABLES
from pipeline.store.state import open_state
from pipeline.trends.course import Course
from pipeline.trends.tasks import read_checkpoint
from tests.leakage.watch.made_machine import VG_46, VG_68, kinematic_viscosity
from tests.pipeline.calling import rows
from tests.pipeline.written import change, record_of, write_nights
from tests.scenarios.conftest import CHANGE
from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet

# The baseline is whole on night 8, a sleeve breaks on night 14.
PARTS = (0, 9, 15, 20)


def checkpoint_of(output: Path, motor: str) -> bytes:
    with open_state(output) as state:
        return read_checkpoint(state, motor) or b""


def check_trends(fleet: ScenarioFleet, expected: ScenarioFleet, but: str = "") -> None:
    for table in TREND_TABLES:
        made, wanted = (
            rows(output, table.name).drop(but, strict=False)
            for output in (fleet.output, expected.output)
        )
        assert_frame_equal(made, wanted, check_exact=True)


def test_nights_that_come_in_parts_give_what_one_run_gives(
    shared_plant: ScenarioFleet, plant: ScenarioFleet
) -> None:
    """Also where checkpoints are lost, damaged, or of an earlier night, as a backup has them."""
    for folder in (plant.output / "tables", plant.folder / "logs"):
        shutil.rmtree(folder)
        folder.mkdir()
    for table in ("files", "nights", "logs", "trends"):  # what is decided of a motor is kept
        change(plant.output, f"DELETE FROM {table}")
    earlier = b""
    for first, last in pairwise(PARTS):
        come = pl.col("night").is_between(plant.label(first + 1), plant.label(last))
        for table in (NIGHTS, FITS, PARAMETERS, BLOCKS):
            write_nights(plant.output, table, shared_plant.table(table.name).filter(come))
        plant.run("fit-fleet")
        if last == 15:
            content = checkpoint_of(plant.output, "worn")
            damaged = content[:900] + bytes([content[900] ^ 1]) + content[901:]
            for motor, left in (("calm", earlier), ("broken", None), ("worn", damaged)):
                statement = "UPDATE trends SET checkpoint = ? WHERE motor_id = ?"
                change(plant.output, statement, left, motor)
        earlier = checkpoint_of(plant.output, "calm")
    check_trends(plant, shared_plant, but="previous_model_fit_percent")  # which logs make


def test_a_motor_whose_trends_fail_takes_no_other_along(
    shared_plant: ScenarioFleet, plant: ScenarioFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Course.step

    def broken(course: Course) -> None:
        if (course.spec.motor_id, course.place) == ("worn", 12):
            raise ZeroDivisionError("in one motor")
        step(course)

    change(plant.output, "DELETE FROM trends")
    monkeypatch.setattr(Course, "step", broken)
    done = plant.run("fit-fleet")
    assert done.code == 1
    assert "internal: 1 motor" in done.out
    made = {name: record_of(plant.output, name) is not None for name in plant.motors}
    assert made == {"calm": True, "broken": True, "worn": False}
    monkeypatch.undo()
    assert plant.run("fit-fleet").code == 0
    check_trends(plant, shared_plant)


@covers("compare --at --json")
def test_no_night_beyond_another_event_is_compared(others: ScenarioFleet) -> None:
    """Its sleeves were renewed on night 6."""
    (found,) = others.run("compare", "overhauled", "--at", others.label(14), "--json").lines
    assert found["before"] == [str(others.label(number)) for number in range(6, 14)]


def test_a_stated_change_of_oil_is_in_the_leakage_and_no_way_to_a_limit(
    others: ScenarioFleet,
) -> None:
    """Thinner oil leaks more than the alarm level; the motor is as it was."""
    *_, before, at, _, _, _, after = others.nights("refilled")[: CHANGE + 4]
    assert at["night"] == others.label(CHANGE)
    at_c = after["own_temperature_c"]
    thinner = kinematic_viscosity(VG_68, at_c) / kinematic_viscosity(VG_46, at_c)
    figure = "own_leakage_l_per_min"
    assert after[figure] / before[figure] == pytest.approx(thinner, rel=0.03)
    assert after["days_to_limit_status"] in ("insufficient", "no_trend", "not_before")
    trends = others.table("trends").filter(motor_id="refilled", night=after["night"])
    (row,) = trends.filter(indicator="own_leakage").to_dicts()
    assert row["n_nights"] == 5


def test_figures_of_a_night_s_own_fit_are_those_of_the_truth(shared_plant: ScenarioFleet) -> None:
    """Beside a baseline that stays frozen."""
    night = shared_plant.nights("broken")[-1]
    trends = shared_plant.table("trends").filter(motor_id="broken")
    last = {row["indicator"]: row for row in trends.filter(night=night["night"]).to_dicts()}
    for path in ("piston_ring", "balance_sleeve"):
        true = shared_plant.truth().gap_change_percent("broken", path, night)
        assert last[f"gap_change_{path}"]["value"] == pytest.approx(true, abs=1.5)
    for name in ("own_leakage", "reference_leakage"):
        assert last[name]["value"] == night[f"{name}_l_per_min"]
        (frozen,) = trends.filter(indicator=name)["baseline_mean"].drop_nulls().unique()
        risen = last[name]["value"] / frozen - 1.0
        assert risen == pytest.approx(night["leakage_change_percent"] / 100.0, abs=0.03)
    assert last["drain_flow"]["value"] == pytest.approx(night["mean_drain_flow_l_per_min"], rel=0.1)


@pytest.mark.parametrize("content", [None, b"junk"])
def test_without_the_table_latest_status_is_the_same(
    plant: ScenarioFleet, content: bytes | None
) -> None:
    before, path = plant.run("status").out, plant.output / "tables" / "latest" / "latest.parquet"
    path.unlink()
    if content:
        path.write_bytes(content)
    assert plant.run("status").out == before

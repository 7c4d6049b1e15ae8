"""A motor whose nights tell the scale of its rollers: the same tables, whenever they are read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from polars.testing import assert_frame_equal

import pipeline.run.night_plan
from pipeline.config import load_fleet
from pipeline.run.fleet import RunRequest, run_fleet
from tests.pipeline.simulated import NIGHT, motor_toml, write_configs
from tests.pipeline.workshop import DAY, MINI, QUICK, Workshop, check_same_figures

ROLLER = """
[[path]]
name = "cam_roller"
law = "speed_curve"
source = "invented"
count = 8
coefficients = [1.6e-3, 4.0e-3]
speed_range_rpm = [0.0, 125.0]
reference_pressure_bar = 200.0
reference_viscosity_mpa_s = 35.0
"""


@pytest.fixture(autouse=True)
def two_nights_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.run.night_plan, "ROLLER_NIGHTS", 2)


def workshop(folder: Path, fleet: str = QUICK) -> Workshop:
    made = Workshop(folder)
    write_configs(folder, {"M1": motor_toml("M1", "MINI")}, {"MINI": MINI + ROLLER}, fleet)
    made.logs.mkdir(parents=True, exist_ok=True)
    return made


def forms(made: Workshop) -> list[bool]:
    return ["scale_cam_roller" in names for names in made.rows("fits")["coefficient_names"]]


def test_all_nights_change_with_the_decision(tmp_path: Path) -> None:
    one, two = workshop(tmp_path / "one"), workshop(tmp_path / "two")
    for number in range(3):
        two.log(NIGHT + number * DAY, seed=number)
    two.run()
    one.log(NIGHT, seed=0)
    one.run()
    assert forms(one) == [False]
    for number in (1, 2):
        one.log(NIGHT + number * DAY, seed=number)
    one.run()
    assert forms(one) == [True] * 3
    check_same_figures(one, two, "log_files")
    assert_frame_equal(one.rows("trends"), two.rows("trends"), check_exact=True)


def test_a_back_fill_in_parts_decides_with_the_first_that_can(tmp_path: Path) -> None:
    parts, whole = workshop(tmp_path / "parts"), workshop(tmp_path / "whole")
    for number in range(4):
        for one in (parts, whole):
            one.log(NIGHT + number * DAY, seed=number)
    request = RunRequest(load_fleet(parts.fleet))
    run_fleet(replace(request, until=NIGHT + DAY))
    assert forms(parts) == [True] * 2
    run_fleet(replace(request, since=NIGHT + 2 * DAY))
    # Nothing is left to be fitted again.
    assert parts.run().nights == ()
    whole.run()
    check_same_figures(parts, whole, "log_files")


def test_what_is_decided_stands_until_a_new_baseline(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = workshop(tmp_path)
    for number in (1, 2, 3):
        made.log(NIGHT + number * DAY, seed=number)
    made.run()
    # No night would be reason enough any more: neither a late log nor a night made anew reopens it.
    monkeypatch.setattr(pipeline.run.night_plan, "MOST", 1.1)
    made.log(NIGHT, seed=0)
    assert made.run().nights == (NIGHT,)
    assert forms(made) == [True] * 4
    event = f'[[events]]\ndate = {NIGHT + 2 * DAY}\nkind = "overhaul"\n'
    motor = motor_toml("M1", "MINI", more=event)
    write_configs(made.folder, {"M1": motor}, {"MINI": MINI + ROLLER}, QUICK)
    assert made.run().n_refitted == 4
    assert forms(made) == [False] * 4

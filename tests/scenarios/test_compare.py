"""`compare` at a date: a step is certain and named, a healthy motor has not changed."""

from __future__ import annotations

import pytest

from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet

BROKEN = 14  # night of the sleeve's damage


@covers("compare --at --json")
def test_a_step_is_certain_its_size_and_part_are_those_of_the_truth(
    shared_plant: ScenarioFleet,
) -> None:
    at = shared_plant.label(BROKEN)
    (found,) = shared_plant.run("compare", "broken", "--at", at, "--json").lines
    true = shared_plant.true_change_percent(shared_plant.nights("broken")[-1])
    assert 100.0 * found["change_lower"] < true < 100.0 * found["change_upper"]
    assert found["probability"] > 0.99
    assert found["cause"] == "balance_sleeve"
    said = shared_plant.run("compare", "broken", "--at", at).out
    assert "probability of a change above 99 %" in said
    assert "cause: balance sleeve" in said


@covers("compare --at --nights")
def test_more_nights_make_it_no_less_sure(shared_plant: ScenarioFleet) -> None:
    at = shared_plant.label(BROKEN)
    few, all_nights = (
        shared_plant.run("compare", "broken", "--at", at, "--nights", n, "--json").lines[0]
        for n in (8, 60)
    )
    assert (len(few["before"]), len(all_nights["before"])) == (8, BROKEN - 1)
    assert 0.99 < few["probability"] <= all_nights["probability"] + 1e-6


@pytest.mark.parametrize("night", [10, 14])
@covers("compare --at")
def test_a_healthy_motor_has_not_changed(shared_plant: ScenarioFleet, night: int) -> None:
    at = shared_plant.label(night)
    (found,) = shared_plant.run("compare", "calm", "--at", at, "--json").lines
    assert found["probability"] < 0.5
    assert found["change_lower"] < 0.0 < found["change_upper"]
    assert "cause" not in shared_plant.run("compare", "calm", "--at", at).out


@covers("compare --at --output")
def test_too_few_nights_on_a_side_are_refused(shared_plant: ScenarioFleet) -> None:
    at, output = shared_plant.label(4), ("--output", shared_plant.output)
    done = shared_plant.run("compare", "calm", "--at", at, *output)
    assert done.code == 2
    assert (
        "3 nights before and 17 after; a comparison needs 8 before and one after"
        in done.out + done.err
    )

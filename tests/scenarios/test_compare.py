"""`compare` at a date: a step is certain and named, a healthy motor has not changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet, Simulated, make_fleet

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


# The drain's delay


DELAY_S, FAST = 8, {"minutes": 30.0, "nights": 9}
FIGURES = ("own_leakage_l_per_min", "leakage_change_percent", "validation_fit_percent")
MOTORS = (Simulated("late", late_flow=(1, DELAY_S)), Simulated("prompt"))


@pytest.fixture(scope="module")
def unfitted(tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    return make_fleet(tmp_path_factory.mktemp("lines"), *MOTORS, **FAST)


@pytest.fixture(scope="module")
def fleet(unfitted: ScenarioFleet, tmp_path_factory: pytest.TempPathFactory) -> ScenarioFleet:
    return unfitted.copy(tmp_path_factory.mktemp("fitted")).fitted()


def column(fleet: ScenarioFleet, motor: str, name: str) -> list[float]:
    return [row[name] for row in fleet.nights(motor)]


def test_a_delay_is_estimated_and_the_fit_on_unseen_samples_rises(
    unfitted: ScenarioFleet, fleet: ScenarioFleet, tmp_path: Path
) -> None:
    assert column(fleet, "late", "drain_delay_s") == pytest.approx([DELAY_S] * 9, abs=0.5)
    assert set(column(fleet, "prompt", "drain_delay_s")) == {0.0}
    plain = unfitted.copy(tmp_path)
    plain.append("fleet.toml", "[transport_delay]\nfixed_s = 0")
    plain.fitted("--until", plain.label(4))
    fits = (column(one, "late", "validation_fit_percent")[:4] for one in (fleet, plain))
    assert min(after - before for after, before in zip(*fits, strict=True)) > 20
    for name in FIGURES:
        assert column(fleet, "prompt", name)[:4] == column(plain, "prompt", name)


def test_night_by_night_it_is_decided_as_at_once(
    unfitted: ScenarioFleet, fleet: ScenarioFleet, tmp_path: Path
) -> None:
    by_night = unfitted.copy(tmp_path)
    for number in (5, 8, 9):
        until = ("--until", by_night.label(number))
        assert by_night.run("fit-fleet", "--motors", "late", *until).code == 0
    for name in ("drain_delay_s", *FIGURES):
        assert column(by_night, "late", name) == column(fleet, "late", name)
    assert "to be done: 0 nights" in by_night.run("fit-fleet", "--motors", "late", "--dry-run").out


@covers("check --full", "explain", "fit")
def test_check_and_explain_say_what_it_gains(unfitted: ScenarioFleet, fleet: ScenarioFleet) -> None:
    before = unfitted.run("check", "--full").out
    assert before.count("the drain flow lags pressure and speed by 8.0 s in the first nights") == 1
    assert "drain flow paired with inputs 8.0 s before" in fleet.run("check").out
    words = fleet.run("explain", "late", fleet.label(9)).out
    assert "drain flow paired with inputs 8.0 s before: by this night it lags 8.0 s" in words
    # The audit of a night pairs it as it is published.
    assert "paired with inputs 8.0 s before" in fleet.run("fit", "late", fleet.label(9)).out
    assert "drain flow paired" not in fleet.run("explain", "prompt", fleet.label(9)).out


@covers("fit-fleet --redo --motors", "status")
def test_a_delay_of_later_nights_is_proposed_and_applied_on_demand(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path, late_flow=(9, DELAY_S), minutes=20.0, nights=16).fitted()
    assert set(column(fleet, "M1", "drain_delay_s")) == {0.0}
    proposal = f"--redo {fleet.label(9)}..{fleet.label(16)} --motors M1"
    assert proposal in fleet.run("status").err
    assert fleet.run("fit-fleet", *proposal.split()).code == 0
    assert column(fleet, "M1", "drain_delay_s") == pytest.approx([DELAY_S] * 16, abs=0.5)
    assert "--redo" not in fleet.run("status").err

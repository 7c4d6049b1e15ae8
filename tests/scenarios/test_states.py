"""What is said of motors whose truth is known: state, cause, size, onset; and what people say."""

from __future__ import annotations

import datetime as dt
import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from pipeline.demo.fleet import PISTON, RING, SLEEVE
from pipeline.schema import RUNS
from tests.pipeline.written import publisher_of
from tests.scenarios.conftest import CHANGE
from tests.scenarios.covering import covers
from tests.scenarios.fleets import DAY, ScenarioFleet, make_fleet

# By motor of the plant: state, cause, and number of the night of its onset.
PLANT_STATES = {
    "calm": ("ok", None, None),
    "broken": ("warning", SLEEVE, 14),
    "worn": ("warning", PISTON, 11),
}
# Of causes that are no wear: the true change of the flow [%], too, where it is no path's.
OTHER_STATES = {
    "thinner_1": ("alarm", "oil_grade", CHANGE, None),
    "thinner_2": ("alarm", "oil_grade", CHANGE, None),
    "metered": ("warning", "all_flows", CHANGE, 25.0),
    "aged": ("warning", "all_gaps", CHANGE, None),
    "late": ("warning", "channels", CHANGE, 0.0),
    "overhauled": ("ok", None, None, None),
}


@pytest.mark.parametrize("motor", PLANT_STATES)
def test_wear_is_named_sized_and_dated(shared_plant: ScenarioFleet, motor: str) -> None:
    state, cause, onset = PLANT_STATES[motor]
    newest, last = shared_plant.newest(motor), shared_plant.nights(motor)[-1]
    assert (newest["state"], newest["cause"], last["cause"]) == (state, cause, cause)
    true = shared_plant.true_change_percent(last)
    assert last["leakage_change_lower"] < true < last["leakage_change_upper"]
    assert newest["leakage_change_percent"] == last["leakage_change_percent"]
    assert last["sentence"] == newest["sentence"]
    if cause is None or onset is None:
        assert true < newest["detection_limit_percent"]
        assert (newest["onset"], newest["detected_on"], newest["gap_change_percent"]) == (None,) * 3
        return
    began = shared_plant.label(onset)
    assert newest["onset_earliest"] <= began <= newest["onset_latest"]
    assert began < newest["detected_on"] <= began + 4 * DAY
    assert newest["cause_probability"] > 0.9
    gap = shared_plant.truth().gap_change_percent(motor, cause, last)
    assert last["gap_change_lower"] < gap < last["gap_change_upper"]


@pytest.mark.parametrize("motor", OTHER_STATES)
def test_other_causes_are_not_taken_for_wear(others: ScenarioFleet, motor: str) -> None:
    state, cause, onset, change = OTHER_STATES[motor]
    newest, last = others.newest(motor), others.nights(motor)[-1]
    assert (newest["state"], newest["cause"]) == (state, cause)
    if motor.startswith("thinner"):
        assert newest["likely_iso_vg"] == 46
        assert "oil" in newest["sentence"]
    elif cause == "channels":
        # Nothing is said of the leakage by channels that do not belong together.
        assert last["days_to_limit_status"] == "insufficient"
    else:
        true = others.true_change_percent(last) if change is None else change
        assert last["leakage_change_lower"] < true < last["leakage_change_upper"]
    if onset is not None:
        assert newest["onset_earliest"] <= others.label(onset) <= newest["onset_latest"]
    if motor == "overhauled":
        assert newest["baseline_start"] == others.label(6)


def test_flushing_is_no_leakage(demo: ScenarioFleet) -> None:
    """The estimated flushing is that of the truth, and the leakage is without it."""
    motor = "CB1120-01"
    truth = demo.truth().document["motors"][motor]["nights"]
    flows = demo.table("parameters").filter(motor_id=motor, parameter="C_f").drop_nulls("lower")
    held = [
        row["lower"] < truth[str(row["night"])]["C_f_l_per_min"] < row["upper"]
        for row in flows.to_dicts()
    ]
    assert sum(held) > 0.8 * len(held) > 20


def test_a_change_of_the_oil_that_is_stated_carries_the_baseline_across(
    others: ScenarioFleet,
) -> None:
    newest = others.newest("refilled")
    assert (newest["state"], newest["baseline_start"]) == ("ok", others.label(1))
    assert newest["leakage_change_lower"] < 0.0 < newest["leakage_change_upper"]
    assert {row["oil"] for row in others.nights("refilled")[9:]} == {"vg46"}


def test_a_motor_without_logs_is_stale(plant: ScenarioFleet) -> None:
    for number in range(12, 21):
        plant.log("calm", number).unlink()
    for number in range(1, 19):
        plant.log("broken", number).unlink()
    plant.output.rename(plant.folder / "before")
    assert plant.run("fit-fleet", "--motors", "calm broken").code == 0
    newest = plant.newest("calm")
    assert (newest["state"], newest["status"], newest["data_age_nights"]) == (
        "stale",
        "no_new_data",
        9,
    )
    # It has the figures of its newest night with samples.
    last = plant.nights("calm")[10]
    assert newest["last_fit_night"] == last["night"] == plant.label(11)
    assert newest["own_leakage_l_per_min"] == last["own_leakage_l_per_min"] > 0.0
    assert plant.newest("broken")["night"] == newest["night"] == plant.label(20)


@covers("status --max-age --output --json")
def test_status_knows_how_old_the_last_good_run_is(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path, nights=1, minutes=1.0)
    at = ("--output", fleet.output, "--max-age")
    never = fleet.run("status", *at, "26h", "--json")
    assert never.code == 1
    assert {line["state"] for line in never.events("motor")} == {"insufficient"}
    assert never.events("fleet")[0]["last_good_run"] is None
    # By hours ago and how a run ended: whether 26 hours and 2 days are too long. A failure that
    # stands is to be seen, each day.
    for hours, status, codes in (
        (1, "interrupted", [1, 1]),
        (30, "ok", [1, 0]),
        (3, "motors_failed", [1, 0]),
        (2, "ok", [0, 0]),
    ):
        ended = dt.datetime.now(dt.UTC) - dt.timedelta(hours=hours)
        row = {"run_id": str(hours), "started_at": ended, "finished_at": ended, "status": status}
        with publisher_of(fleet.output) as publisher:
            publisher.add(f"{ended:%Y-%m}", {RUNS: [row]})
        ages = [fleet.run("status", *at, age, "--json") for age in ("26h", "2d")]
        assert [done.code for done in ages] == codes
        assert [done.events("fleet")[0]["too_old"] for done in ages] == [*map(bool, codes)]


@covers("explain --output")
def test_explain_says_the_figures_of_the_tables(plant: ScenarioFleet) -> None:
    plant.output.rename(plant.folder / "moved")
    night = plant.label(20)
    out = plant.run("explain", "broken", night, "--output", plant.folder / "moved").out
    (row,) = (
        row for row in ScenarioFleet(plant.folder, output_name="moved").nights("broken")
        if row["night"] == night
    )  # fmt: skip
    assert f"rpm): {_figure(row, 'own_leakage')}" in _joined(out)
    assert row["sentence"][1:] in out
    assert f"training {row['training_fit_percent']:.1f} %" in out
    # The answer stands first, and each part under its title.
    titles = [line for before, line in pairwise(out.splitlines()) if not before]
    others = ["Paths", "Systematic errors", "Fit", "Errors of the fit", "Data"]
    assert titles == ["Leakage", "State", *others]
    assert f"model error {row['model_error_percent']:.1f} % of the flow" in out
    assert f"log broken/{plant.log('broken', 20).name}: ok" in out
    nothing = plant.run("explain", "broken", plant.label(40))
    assert nothing.code == 2
    assert str(plant.label(40)) in nothing.err


@covers("fit --train --validate")
def test_fit_finds_the_truth_of_a_night_and_of_many(plant: ScenarioFleet) -> None:
    before = sorted(plant.output.rglob("*"))
    truth = plant.truth().document["motors"]["broken"]["nights"]
    nights = [plant.label(number) for number in (2, 9, 15, 20)]
    many = plant.run(
        "fit", "broken", "--train", f"{nights[0]}..{nights[1]}",
        "--validate", f"{nights[2]}..{nights[3]}",
    ).out  # fmt: skip
    lower, upper = _interval(many, f"K_{SLEEVE}")
    assert lower < truth[str(nights[0])]["K_m3"][SLEEVE] < upper
    # The sleeve of the later nights is another: they leak more than the fit expects.
    assert float(many.partition("validation: fit ")[2].split(" %")[0]) < 75.0
    one = plant.run("fit", "broken", nights[2]).out
    lower, upper = _interval(one, f"K_{SLEEVE}: identified")
    assert lower < truth[str(nights[2])]["K_m3"][SLEEVE] < upper
    assert "10 of 10 starts end at the proven minimum" in one
    assert sorted(plant.output.rglob("*")) == before


@covers("ack --note --finding --opened --worn --sound --output")
def test_what_people_enter_is_published_and_shown(plant: ScenarioFleet) -> None:
    at = ("--output", plant.output)
    plant.run("ack", "broken", "--note", "sleeve ordered", *at)
    plant.run("ack", "broken", "--note", "as feared", "--finding", "confirmed", *at)
    done = plant.run(
        "ack", "worn", "--note", "scored", "--opened", "2026-02-01", "--worn", PISTON,
        "--sound", "piston ring", *at,
    )  # fmt: skip
    assert "worn: balance_piston; sound: piston_ring" in done.out
    assert plant.run("fit-fleet").code == 0
    columns = ("motor_id", "kind", "night", "finding", "note", "worn", "sound")
    raised = next(row["night"] for row in plant.table("alarms").to_dicts()
        if row["motor_id"] == "broken" and row["to_state"] == "warning")  # fmt: skip
    decisions = set(plant.table("decisions").select(columns).iter_rows())
    opened = ("worn", "finding", plant.label(31), None, "scored", PISTON, RING)
    assert decisions == {
        ("broken", "acknowledged", raised, None, "sleeve ordered", None, None),
        ("broken", "finding", raised, "confirmed", "as feared", None, None),
        opened,
    }
    assert plant.newest("broken")["acknowledged"] == "as feared"
    assert "(acknowledged: as feared)" in plant.run("status", "--long").out


OPENED = "ack broken --note x --opened"
# By what would do nothing, words of its refusal.
REFUSED = {
    "ack M9 --note x": "no motor M9; there are broken, calm, worn",
    "ack calm --note x": "calm",
    "ack broken flow_zero --note x": "has had no alarm of 'flow_zero'; alarms so far: leakage",
    "ack broken --note x --finding yes": "is not one of 'confirmed'",
    "ack broken --note ' '": "expected some words",
    "ack broken": "--note",
    f"{OPENED} 2026-01-06": "expected --opened with --worn or --sound",
    f"{OPENED} 9998-01-06 --worn cam_roller": "which has not come",
    f"{OPENED} '6 May' --worn cam_roller": "expected YYYY-MM-DD",
    f"{OPENED} 2026-01-06 --worn valve": "broken has no part 'valve'; it has balance_p",
    f"{OPENED} 2026-01-06 --worn cam_roller --sound 'cam roller'": "worn or sound, not both",
    "baseline reset broken '5 May' --note x": "got '5 May'; expected YYYY-MM-DD",
    "baseline reset broken 2199-01-01 --note x": "which has not come",
    "baseline reset M9 2026-01-05 --note x": "no motor M9",
    "baseline reset broken 2026-03-01 --note x": "broken has the nights 2026-01-02 to 2026-01-21",
    "baseline reset broken 2026-01-01 --note x": "broken has the nights 2026-01-02 to 2026-01-21",
    "baseline reset broken 2026-01-10 --note ' '": "expected some words",
}


@pytest.mark.parametrize("line", REFUSED)
def test_what_would_do_nothing_is_refused(shared_plant: ScenarioFleet, line: str) -> None:
    command = "baseline reset" if line.startswith("baseline") else "ack"
    done = shared_plant.run(command, *shlex.split(line.removeprefix(command)))
    assert (done.code, done.out) == (2, "")
    assert REFUSED[line] in " ".join(done.err.split())
    assert not shared_plant.table("decisions").height


@covers("baseline reset --note --output")
def test_a_baseline_that_is_reset_begins_again(plant: ScenarioFleet) -> None:
    night, at = plant.label(14), ("--output", plant.output)
    done = plant.run("baseline reset", "broken", night, "--note", "sleeve replaced", *at)
    assert done.out == f"broken: its baseline starts with the night {night}\n"
    plant.run("fit-fleet")
    newest = plant.newest("broken")
    assert (newest["state"], newest["cause"]) == ("insufficient", None)  # 7 of 8 nights
    (row,) = plant.table("decisions").to_dicts()
    assert (row["kind"], row["night"], row["note"]) == ("baseline_reset", night, "sleeve replaced")
    assert plant.newest("worn")["state"] == "warning"


def _joined(text: str) -> str:
    return " ".join(text.split())


def _figure(row: dict[str, Any], name: str) -> str:
    low, high = row[f"{name}_lower"], row[f"{name}_upper"]
    return f"{row[f'{name}_l_per_min']:.4g} l/min [{low:.4g}, {high:.4g}]"


def _interval(text: str, name: str) -> tuple[float, float]:
    """Ends of the interval on the line that begins with a name."""
    line = next(line for line in text.splitlines() if line.strip().startswith(name))
    low, high = line.partition("[")[2].partition("]")[0].split(", ")
    return float(low), float(high)

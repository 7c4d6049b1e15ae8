"""The trend stage in a run: what is published, what is made anew, and what is left alone."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.config.settings import Conditions
from pipeline.schema import NIGHTS, TRENDS
from pipeline.store.state import open_state
from pipeline.trends.comparing import compare_nights
from pipeline.trends.course import Course
from pipeline.trends.decisions import Decision
from pipeline.trends.stage import run_trends
from pipeline.trends.tasks import (
    NewestNight,
    Record,
    TrendTask,
    checkpoint_file,
    circuit_of,
    note_touched,
    read_records,
    trend_hash,
    with_spans,
    write_record,
)
from pipeline.workers.process import Loss
from tests.leakage.watch.made_machine import VG_46, VG_68, kinematic_viscosity
from tests.pipeline.trends.nights import (
    Nights,
    copy_of,
    event,
    fleet_of,
    motor,
    named,
    night_of,
    publish,
    published_trends,
    reset,
    run,
    step,
)

N, AT = 24, 16
RAISED = ["warning", "alarm"]


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one motor, whose sleeve breaks, and the trends that a run made of it."""
    folder = tmp_path_factory.mktemp("trends")
    config, _ = fleet_of(folder, Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.9)}))
    assert run(config).failed == ()
    return folder


@pytest.fixture
def fleet(published: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A copy of that folder: its config and its output."""
    return copy_of(published, tmp_path / "fleet")


def test_figures_stand_beside_a_baseline_that_stays_frozen(published: Path) -> None:
    trends, nights = (published_trends(published / "out", table) for table in (TRENDS, NIGHTS))
    last = trends.filter(night=night_of(N - 1))
    rows = {row["indicator"]: row for row in last.to_dicts()}
    healthy = nights.filter(pl.col("night").is_between(night_of(7), night_of(AT - 1)))
    for name in ("reference_leakage", "own_leakage"):
        column = f"{name}_l_per_min"
        assert (rows[name]["value"], rows[name]["n_nights"]) == (nights[column][-1], N - AT)
        (frozen,) = trends.filter(indicator=name)["baseline_mean"].drop_nulls().unique()
        assert frozen == pytest.approx(healthy[column].median(), rel=0.005)
    # The sleeve leaks 1.9 times as much; the others what they did.
    assert rows["gap_change_balance_sleeve"]["value"] == pytest.approx(23.9, abs=1.5)
    assert rows["gap_change_piston_ring"]["value"] == pytest.approx(0.0, abs=3.0)
    assert rows["drain_flow"]["value"] > 0.0


def test_the_model_of_the_night_before_is_judged_from_stored_blocks(published: Path) -> None:
    nights = published_trends(published / "out", NIGHTS)
    percent = nights["previous_model_fit_percent"].to_list()
    assert percent[0] is None
    # The sleeve of the night before leaks half as much.
    assert min(percent[1:AT]) > max(90.0, percent[AT])
    assert percent[AT + 1] > percent[AT]


def test_no_night_beyond_another_event_is_compared(published: Path) -> None:
    others = (event(4, "overhaul"), event(12, "note"), event(AT + 6, "overhaul"))
    spec = named(motor(), "M1", events=others)
    record, _ = compare_nights(published / "out", spec, night_of(AT), most=60)
    assert record["before"] == [str(night_of(place)) for place in range(4, AT)]
    assert record["after"] == [str(night_of(place)) for place in range(AT, AT + 6)]


def test_nights_without_blocks_hold_then_are_stale_and_never_green(tmp_path: Path) -> None:
    silent = dict.fromkeys(range(AT + 3, AT + 13), "stood_still")
    wear = {"balance_sleeve": step(AT + 15, AT, 0.9)}
    config, output = fleet_of(tmp_path, Nights(motor(), AT + 15, wear, statuses=silent))
    run(config)
    nights = published_trends(output, NIGHTS)
    states = nights["state"].to_list()
    assert {*states[AT + 2 : AT + 10], states[AT + 13]} <= {*RAISED}
    assert states[AT + 10 : AT + 13] == ["stale"] * 3
    stale = nights.row(AT + 11, named=True)
    assert stale["sentence"].startswith(f"no data since {night_of(AT + 2).day} January")
    assert ": stood still; leakage of the balance sleeve" in stale["sentence"]
    assert (stale["leakage_change_percent"], stale["leakage_reason"]) == (None, "stood still")
    assert stale["state_since"] == night_of(AT + 10)


def test_a_stated_change_of_oil_is_no_way_to_a_limit(tmp_path: Path) -> None:
    """Thinner oil leaks more than the alarm level; the motor is as it was."""
    spec = named(motor(), "M1", events=[event(25, "oil_change", oil="vg46")])
    lines = f'[[events]]\ndate = {night_of(25)}\nkind = "oil_change"\noil = "vg46"\n'
    config, output = fleet_of(tmp_path, Nights(spec, 55), more={"M1": lines})
    run(config)
    nights = published_trends(output, NIGHTS)
    assert set(nights["days_to_limit_status"][40:]) <= {"insufficient", "no_trend", "not_before"}
    before, after = nights["own_leakage_l_per_min"][24], nights["own_leakage_l_per_min"][54]
    at_c = nights["own_temperature_c"][54]
    vg_68, vg_46 = (kinematic_viscosity(oil, at_c) for oil in (VG_68, VG_46))
    assert after / before == pytest.approx(vg_68 / vg_46, rel=0.03)


def test_a_motor_whose_flow_is_all_flushing_has_no_leakage_by_any_oil() -> None:
    watch = SimpleNamespace(frozen_leakage_at=lambda *_: 0.0)
    baseline = SimpleNamespace(own=Conditions(100.0, 50.0, 30.0), end=night_of(7), own_leakage=0.0)
    course: Any = SimpleNamespace(
        watch=watch,
        baseline=baseline,
        nights=SimpleNamespace(place_from=lambda _: 7),
        drives_at=lambda *_: np.zeros(1),
    )
    assert Course.first_leakage(course, 20) == 0.0


# Which nights

SPECS = (named(motor(), "A", "t"), named(motor(), "B", "t"))
OTHER_OIL = (named(motor(), "A", "t", [event(20, "oil_change", oil="vg46")]), SPECS[1])
RESET = reset(20, motor_id="A")
ALL = (dt.date.min, night_of(39))


def span(first: int, last: int = 39) -> tuple[dt.date, dt.date]:
    return night_of(first), night_of(last)


@pytest.mark.parametrize(
    ("last", "changed", "decisions", "specs", "expected"),
    [
        pytest.param(None, {"A": 0, "B": None}, (), SPECS, {"A": ALL, "B": ALL}, id="at first"),
        pytest.param(
            37, {"A": 38, "B": None}, (), SPECS, {"A": span(38), "B": span(38)}, id="new nights"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), SPECS, {"A": span(20), "B": span(20)}, id="a late log"
        ),
        pytest.param(
            39, {"A": None, "B": None}, (RESET,), SPECS, {"A": ALL}, id="a reset: that motor"
        ),
        pytest.param(
            39,
            {"A": None, "B": None},
            (replace(RESET, kind="acknowledged"),),
            SPECS,
            {},
            id="an acknowledgement",
        ),
        pytest.param(
            35, {"A": 30}, (), SPECS, {"A": span(30), "B": span(30, 35)}, id="not asked for"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), OTHER_OIL, {"A": ALL}, id="settings of its own: no other"
        ),
    ],
)
def test_which_nights_are_to_be_made(
    tmp_path: Path,
    last: int | None,
    changed: dict[str, int | None],
    decisions: tuple[Decision, ...],
    specs: tuple[object, ...],
    expected: dict[str, tuple[dt.date, dt.date]],
) -> None:
    asked = {name: None if place is None else night_of(place) for name, place in changed.items()}
    assert to_be_made(tmp_path, asked, last, decisions, specs) == expected


def to_be_made(
    output: Path,
    changed: dict[str, dt.date | None],
    last: int | None,
    decisions: tuple[Decision, ...] = (),
    specs: tuple[object, ...] = SPECS,
    touched: tuple[tuple[str, dt.date], ...] = (),
) -> dict[str, tuple[dt.date, dt.date]]:
    """Spans of nights to be made, of motors whose trends are published up to a last one."""
    with open_state(output) as state:
        for spec in SPECS if last is not None else ():
            write_record(state, spec.motor_id, Record(trend_hash(spec, ()), night_of(last)))
        note_touched(state, touched)
        circuit = circuit_of(specs, decisions, read_records(state), {})
    motors = with_spans(circuit, changed, NewestNight(night_of(39)))
    asked = (motor for motor in motors if motor.first is not None)
    return {motor.spec.motor_id: (motor.first, motor.until) for motor in asked}


def test_what_a_broken_run_left_is_done_by_the_next(tmp_path: Path) -> None:
    touched = (("B", night_of(25)), ("B", night_of(31)), ("C", night_of(0)))
    spans = to_be_made(tmp_path, {"A": None, "B": None}, 39, touched=touched)
    assert spans == {"A": span(25), "B": span(25)}


def test_a_broken_motor_takes_no_other_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(tmp_path, *(Nights(spec, 5).frames for spec in SPECS))
    step_of = Course.step

    def broken(course: Course) -> None:
        if course.spec.motor_id == "A" and course.place == 3:
            raise ZeroDivisionError("in one motor")
        step_of(course)

    monkeypatch.setattr(Course, "step", broken)
    staging = tmp_path / "staging"
    staging.mkdir()
    asked = {"A": night_of(0), "B": night_of(0)}
    circuit = with_spans(circuit_of(SPECS, (), {}, {}), asked, NewestNight(night_of(4)))
    outcome = run_trends(TrendTask((circuit,), tmp_path, staging))
    assert outcome.failures == {"A": Loss("internal", "ZeroDivisionError: in one motor")}
    assert [(name, record.last_night) for name, record in outcome.records.items()] == [
        ("B", night_of(4))
    ]
    assert checkpoint_file(staging, "B").exists()

"""The trend stage in a run: what is published, what is made anew, and what is left alone."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.schema import ALARMS, NIGHTS, TREND_TABLES, TRENDS
from pipeline.store.publishing import stage
from pipeline.store.state import open_state
from pipeline.trends.nights.decisions import Decision, record_decision
from pipeline.trends.nights.trend_record import (
    Record,
    note_touched,
    read_records,
    trend_hash,
    write_record,
)
from pipeline.trends.stage import run_trends
from pipeline.trends.states.course import Course
from pipeline.trends.tasks import (
    Circuit,
    NewestNight,
    TrendTask,
    checkpoint_file,
)
from pipeline.workers.process import Loss
from tests.pipeline.remembered import record_of
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
    ramp,
    reset,
    run,
    step,
)
from tests.pipeline.written import publisher_of

N, AT = 24, 16
WORN = Nights(motor(), N + 1, {"balance_sleeve": step(N + 1, AT, 0.9)})


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one motor, whose sleeve breaks, and the trends that a run made of it."""
    folder = tmp_path_factory.mktemp("trends")
    config, _ = fleet_of(folder, WORN, until=N)
    assert run(config).failed == ()
    return folder


@pytest.fixture
def fleet(published: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A copy of that folder: its config and its output."""
    return copy_of(published, tmp_path / "fleet")


def test_wear_that_goes_on_is_told_once_a_state(tmp_path: Path) -> None:
    """A ramp is detected again and again as it grows: no alarm, unless its state changes."""
    worn = Nights(motor(), 60, {"balance_sleeve": ramp(60, 15, 1.2)})
    config, output = fleet_of(tmp_path, worn)
    assert run(config).failed == ()
    watch = published_trends(output, NIGHTS)
    again = watch.filter(pl.col("still_rising") & (pl.col("detected_on") == pl.col("night")))
    assert again.height
    alarms = published_trends(output, ALARMS)
    assert (alarms["from_state"] != alarms["to_state"]).all()
    assert alarms["to_state"].to_list() == ["ok", "warning", "alarm"]
    warnings = alarms.filter(to_state="warning")["night"][1:]
    assert set(again["night"]).isdisjoint(warnings)


def test_a_slope_is_held_against_the_frozen_baseline(fleet: tuple[Path, Path]) -> None:
    """Whatever a night brings, the leakage of the baseline stays what it was frozen at."""
    _, output = fleet
    watch = published_trends(output, NIGHTS)
    trends = published_trends(output, TRENDS)
    for name, column in (
        ("own_leakage", "own_leakage_l_per_min"),
        ("reference_leakage", "reference_leakage_l_per_min"),
    ):
        (frozen,) = trends.filter(indicator=name)["baseline_mean"].drop_nulls().unique()
        healthy = watch.filter(pl.col("night").is_between(night_of(7), night_of(AT - 1)))[column]
        assert frozen == pytest.approx(healthy.median(), rel=0.005)


def test_figures_are_shown_beside_it(fleet: tuple[Path, Path]) -> None:
    _, output = fleet
    trends = published_trends(output, TRENDS).filter(night=night_of(N - 1))
    rows = {row["indicator"]: row for row in trends.to_dicts()}
    watched = published_trends(output, NIGHTS).row(-1, named=True)
    for name, column in (
        ("reference_leakage", "reference_leakage_l_per_min"),
        ("own_leakage", "own_leakage_l_per_min"),
    ):
        assert rows[name]["value"] == watched[column]
        assert rows[name]["n_nights"] == N - AT
    # The sleeve leaks 1.9 times as much; the others what they did.
    assert rows["gap_change_balance_sleeve"]["value"] == pytest.approx(23.9, abs=1.5)
    assert rows["gap_change_piston_ring"]["value"] == pytest.approx(0.0, abs=3.0)
    assert rows["drain_flow"]["value"] > 0.0


@pytest.mark.parametrize("kind", ["reset", "overhaul"])
def test_a_reset_and_an_event_begin_anew_and_close_what_stood(
    fleet: tuple[Path, Path], kind: str
) -> None:
    config, output = fleet
    if kind == "reset":
        record_decision(output, reset(AT, note="new sleeves"))
    else:
        file = config.parent / "motors" / "M1.toml"
        lines = f'[[events]]\ndate = {night_of(AT)}\nkind = "overhaul"\nnote = "new sleeves"\n'
        file.write_text(file.read_text() + lines)
    told = published_trends(output, ALARMS).filter(pl.col("to_state").is_in(["warning", "alarm"]))
    run(config)
    watch = published_trends(output, NIGHTS)
    states = watch["state"].to_list()
    assert states[:AT] == ["insufficient"] * 8 + ["ok"] * (AT - 8)
    assert states[AT:] == ["insufficient"] * 8 + ["ok"] * (N - AT - 8)
    assert f"2 of 8 nights of a baseline since {kind}" in watch["sentence"][AT + 1]
    assert "new sleeves" in watch["sentence"][AT + 1]
    begins = watch["baseline_start"].drop_nulls().unique(maintain_order=True).to_list()
    assert begins == [night_of(0), night_of(AT)]
    # What was raised stays, and is closed.
    alarms = published_trends(output, ALARMS)
    assert set(told["night"]) <= set(alarms["night"])
    assert alarms["to_state"].to_list()[-1] == states[-1]


def test_nights_without_blocks_hold_then_are_stale_and_never_green(tmp_path: Path) -> None:
    silent = range(AT + 3, AT + 13)
    nights = Nights(
        motor(), AT + 15, {"balance_sleeve": step(AT + 15, AT, 0.9)},
        statuses=dict.fromkeys(silent, "stood_still"),
    )  # fmt: skip
    config, output = fleet_of(tmp_path, nights)
    run(config)
    watch = published_trends(output, NIGHTS)
    states = watch["state"].to_list()
    assert set(states[AT + 2 : AT + 10]) <= {"warning", "alarm"}
    assert states[AT + 10 : AT + 13] == ["stale"] * 3
    assert states[AT + 13] in ("warning", "alarm")
    stale = watch.row(AT + 11, named=True)
    assert stale["sentence"].startswith(f"no data since {night_of(AT + 2).day} January")
    assert ": stood still; leakage of the balance sleeve" in stale["sentence"]
    assert (stale["leakage_change_percent"], stale["leakage_reason"]) == (None, "stood still")
    assert stale["state_since"] == night_of(AT + 10)


def test_a_limit_of_the_motor_type_holds_before_there_is_a_baseline(tmp_path: Path) -> None:
    """The placeholders leak 1.371 l/min at the reference conditions."""
    config, output = fleet_of(tmp_path, Nights(motor(), 10))
    types = config.parent / "motor_types" / "CB560.toml"
    types.write_text(types.read_text() + "\n[limits]\nalarm_l_per_min = 1.3\n")
    run(config)
    watch = published_trends(output, NIGHTS)
    assert set(watch["state"]) == {"alarm"}
    assert "beyond the motor type's limit of 1.3 l/min" in watch["sentence"][0]
    assert published_trends(output, ALARMS)["to_state"].to_list() == ["alarm"]
    assert set(watch["alarm_limit_l_per_min"]) == {1.3}


def test_what_is_made_anew_notifies_of_what_is_in_force_and_of_nothing_past(
    fleet: tuple[Path, Path], tmp_path: Path
) -> None:
    """As if the program had raised, by other rules, what its nights do not show now."""
    config, output = fleet
    alarms = published_trends(output, ALARMS)
    raised = alarms.filter(pl.col("to_state").is_in(["warning", "alarm"]))
    early = raised.row(0, named=True) | {"id": f"M1 {night_of(10)} leakage", "night": night_of(10)}
    stage(tmp_path / "trends" / "M1.arrow", {ALARMS: {night_of(10): [early]}})
    with publisher_of(output, "old", tmp_path) as publisher:
        publisher.nights("trends", (ALARMS,), ["M1"])
    with open_state(output) as state:
        write_record(state, "M1", replace(record_of(output, "M1"), trend_hash=""))
    assert run(config).alarms == ()
    after = published_trends(output, ALARMS)
    assert after.filter(night=night_of(10))["to_state"].to_list() == [early["to_state"]]
    closed = after.filter(night=night_of(11))
    assert closed["closed_as"].to_list() == ["recomputed"]
    assert closed["to_state"].to_list() == ["ok"]


def test_the_model_of_the_night_before_is_judged_from_stored_blocks(
    fleet: tuple[Path, Path],
) -> None:
    _, output = fleet
    nights = published_trends(output, NIGHTS)
    percent = nights["previous_model_fit_percent"].to_list()
    assert percent[0] is None
    assert min(percent[1:AT]) > 90.0
    # The sleeve of the night before leaks half as much.
    assert percent[AT] < min(percent[1:AT])
    assert percent[AT + 1] > percent[AT]


# A tank


TANK = [Nights(named(motor(), name, "mill"), N, seed=n) for n, name in enumerate("ABC", 1)]


def test_what_is_said_of_a_motor_moves_nothing_that_the_others_were_told(tmp_path: Path) -> None:
    oil = {"oil": step(N, AT, 0.2)}
    config, output = fleet_of(tmp_path, *(replace(one, wear=oil) for one in TANK))
    run(config)
    before = {table: published_trends(output, table, "B") for table in TREND_TABLES}
    assert set(before[NIGHTS]["state"][AT + 2 :]) == {"common_cause"}
    record_decision(output, reset(AT, motor_id="A"))
    run(config)
    assert published_trends(output, NIGHTS, "A")["state"][AT + 1] == "insufficient"
    for table, told in before.items():
        assert_frame_equal(published_trends(output, table, "B"), told)


# Which nights


SPECS = [named(motor(), name, circuit) for name, circuit in (("A", "t"), ("B", "t"), ("C", ""))]
OTHER_A = named(motor(), "A", "t", [event(20, "oil_change", oil="vg46")])


def task(changed: dict[str, dt.date | None], output: Path, *said: Decision) -> TrendTask:
    with open_state(output) as state:
        circuit = Circuit.of(SPECS[:2], said, read_records(state), {})
    return TrendTask((circuit,), output, output, changed, NewestNight(night_of(39)))


def to_do(one: TrendTask) -> dict[str, tuple[dt.date, dt.date]]:
    (circuit,) = one.circuits
    spans = circuit.spans(one.changed_from, one.newest_night)
    return {name: (begin, end) for name, (begin, end) in spans.items() if begin is not None}


def remember(output: Path, last: int) -> None:
    for spec in SPECS[:2]:
        with open_state(output) as state:
            write_record(state, spec.motor_id, Record(trend_hash(spec, ()), night_of(last)))


def span(first: int, last: int = 39) -> tuple[dt.date, dt.date]:
    return night_of(first), night_of(last)


EVERYTHING = (dt.date.min, night_of(39))
ACKNOWLEDGED = replace(reset(20, motor_id="A"), kind="acknowledged")


@pytest.mark.parametrize(
    ("last", "changed", "said", "expected"),
    [
        pytest.param(
            None, {"A": 0, "B": None}, (), dict.fromkeys("AB", EVERYTHING), id="all at first"
        ),
        pytest.param(
            37, {"A": 38, "B": None}, (), dict.fromkeys("AB", span(38)), id="new nights later"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), dict.fromkeys("AB", span(20)), id="a late log: all"
        ),
        pytest.param(
            39, {"A": None, "B": None}, (reset(20, motor_id="A"),), {"A": EVERYTHING},
            id="what was said of one motor: that motor",
        ),
        pytest.param(39, {"A": None, "B": None}, (ACKNOWLEDGED,), {}, id="an acknowledgement"),
        pytest.param(
            35, {"A": 30}, (), {"A": span(30), "B": span(30, 35)}, id="one not asked for"
        ),
    ],
)  # fmt: skip
def test_which_nights_are_to_be_made(
    tmp_path: Path,
    last: int | None,
    changed: dict[str, int | None],
    said: tuple[Decision, ...],
    expected: dict[str, tuple[dt.date, dt.date]],
) -> None:
    if last is not None:
        remember(tmp_path, last)
    asked = {name: None if one is None else night_of(one) for name, one in changed.items()}
    assert to_do(task(asked, tmp_path, *said)) == expected


def test_what_a_broken_run_left_is_done_by_the_next(tmp_path: Path) -> None:
    remember(tmp_path, 39)
    with open_state(tmp_path) as state:
        note_touched(state, [("B", night_of(25)), ("B", night_of(31)), ("C", night_of(0))])
    assert to_do(task({"A": None, "B": None}, tmp_path)) == dict.fromkeys("AB", span(25))


def test_what_its_own_settings_made_anew_redoes_no_other_motor(tmp_path: Path) -> None:
    """Another oil from a night on, say: its rows are others from there on."""
    remember(tmp_path, 39)
    asked = task({"A": night_of(20), "B": None}, tmp_path)
    other = Circuit.of((OTHER_A, SPECS[1]), (), asked.circuits[0].records, {})
    assert to_do(replace(asked, circuits=(other,))) == {"A": EVERYTHING}


def test_a_broken_motor_takes_no_other_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(tmp_path, *(Nights(spec, 5).frames() for spec in SPECS[:2]))
    real: Callable[[Course], None] = Course.step

    def broken(course: Course) -> None:
        if course.spec.motor_id == "A" and course.place == 3:
            raise ZeroDivisionError("in one motor")
        real(course)

    monkeypatch.setattr(Course, "step", broken)
    (tmp_path / "staging").mkdir()
    asked = {"A": night_of(0), "B": night_of(0)}
    circuit = Circuit.of(SPECS[:2], (), {}, {})
    found = run_trends(
        TrendTask((circuit,), tmp_path, tmp_path / "staging", asked, NewestNight(night_of(4)))
    )
    assert found.failures == {"A": Loss("internal", "ZeroDivisionError: in one motor")}
    assert {name: one.last_night for name, one in found.records.items()} == {"B": night_of(4)}
    assert found.records["B"].last_night == night_of(4)
    assert checkpoint_file(tmp_path / "staging", "B").exists()

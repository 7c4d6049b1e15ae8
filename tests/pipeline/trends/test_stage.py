"""The trend stage in a run: what is published, what is made anew, and what is left alone."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from pipeline.config import load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.run.verification import verify_tables
from pipeline.schema import ALARMS, BASELINES, TREND_TABLES, TRENDS, Table, frame
from pipeline.store.night_files import stage
from pipeline.store.publishing import Publisher
from pipeline.store.tables import read_rows
from pipeline.trends.circuits import Circuit, circuits_of
from pipeline.trends.nights.decisions import Decision, record_decision
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.nights.trend_record import (
    TRENDS_VERSION,
    Record,
    note_touched,
    read_record,
    trend_hash,
    write_record,
)
from pipeline.trends.rows.alarm_rows import rules_now
from pipeline.trends.rows.q_values import with_q_values
from pipeline.trends.stage import new_alarms
from pipeline.trends.tasks import TrendTask, trend_tasks
from pipeline.workers.process import Loss
from tests.pipeline.trends.nights import (
    Nights,
    configure,
    event,
    histories,
    motor,
    named,
    night_of,
    publish,
    reset,
)

QUICK = '[estimation]\nstarting_points = 0\n[execution]\nbackend = "sequential"\n'
N = 33


def run(config: Path) -> RunResult:
    return run_fleet(RunRequest(load_fleet(config)))


def rows(output: Path, table: Table) -> pl.DataFrame:
    return read_rows(output, table, ["M1"]).drop("run_id").sort(table.key)


def files(output: Path) -> dict[Path, int]:
    return {
        path: path.stat().st_mtime_ns
        for table in TREND_TABLES
        for path in (output / "tables" / table.name).rglob("*.parquet")
    }


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one motor whose nights are published, and trends that a run made of them."""
    folder = tmp_path_factory.mktemp("trends")
    config = configure(folder, fleet=QUICK)
    publish(folder / "out", nights_before(N))
    assert run(config).failed == ()
    return folder


def nights_before(place: int) -> dict[str, pl.DataFrame]:
    """Rows of the motor's nights before a place."""
    frames = Nights(motor(), N + 1).frames()
    return {name: one.filter(pl.col("night") < night_of(place)) for name, one in frames.items()}


@pytest.fixture
def fleet(published: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A copy of that folder: its config and its output."""
    folder = tmp_path / "fleet"
    shutil.copytree(published, folder)
    return folder / "configs" / "fleet.toml", folder / "out"


def test_the_first_run_publishes_every_night(fleet: tuple[Path, Path]) -> None:
    _, output = fleet
    trends = rows(output, TRENDS)
    assert trends["night"].unique().sort().to_list() == [night_of(place) for place in range(N)]
    assert trends.n_unique(["night", "indicator"]) == trends.height
    states = trends.filter(indicator="K_piston_ring").sort("night")["state"].to_list()
    # The fifteenth good night makes the first baseline, which serves from the next on.
    assert states == ["insufficient"] * 15 + ["ok"] * 18
    frozen = rows(output, BASELINES).filter(indicator="K_piston_ring")
    assert frozen.select("night", "n", "provisional").rows() == [
        (night_of(14), 15, True),
        (night_of(29), 30, True),
    ]
    assert rows(output, ALARMS)["to_state"].unique().to_list() == ["ok"]
    # The made-up fits were not published by a run; what the stage wrote is proven.
    assert [one for one in verify_tables(output) if one.code != "table_unlisted"] == []
    found = read_record(output, "M1")
    assert found is not None
    assert found.last_night == night_of(N - 1)


def test_a_second_run_has_nothing_to_do(fleet: tuple[Path, Path]) -> None:
    config, output = fleet
    before = files(output)
    assert run(config).alarms == ()
    assert files(output) == before


def test_a_new_night_is_added_and_the_others_stay(fleet: tuple[Path, Path]) -> None:
    config, output = fleet
    before = files(output)
    publish(
        output, {name: one.filter(night=night_of(N)) for name, one in nights_before(N + 1).items()}
    )
    run(config)
    after = files(output)
    assert {path: after[path] for path in before} == before
    assert {path.stem for path in after.keys() - before.keys()} == {str(night_of(N))}


def test_a_reset_makes_all_nights_anew(fleet: tuple[Path, Path]) -> None:
    config, output = fleet
    record_decision(output, replace(reset(31, note="new rings"), indicator="K_piston_ring"))
    run(config)
    trends = rows(output, TRENDS)
    ring = trends.filter(indicator="K_piston_ring", night=night_of(N - 1)).row(0, named=True)
    assert ring["state"] == "insufficient"
    assert ring["state_reason"].startswith("2 of 15 good nights for a baseline (reset from ")
    assert ring["state_reason"].endswith(": new rings)")
    sleeve = trends.filter(indicator="K_balance_sleeve", night=night_of(N - 1)).row(0, named=True)
    assert sleeve["state"] == "ok"
    decisions = pl.read_parquet(output / "tables" / "decisions" / "**" / "*.parquet")
    assert decisions["note"].to_list() == ["new rings"]


def test_a_change_of_rules_tells_what_stands_and_nothing_of_the_past(
    fleet: tuple[Path, Path], tmp_path: Path
) -> None:
    config, output = fleet
    said = {"motor_id": "M1", "indicator": "K_balance_sleeve", "way": "level", "reason": "+9 %"}
    by_old_rules = {
        night_of(place): [
            said | {"night": night_of(place), "from_state": before, "to_state": after}
        ]
        for place, before, after in ((20, "ok", "warning"), (25, "warning", "alarm"))
    }
    stage(tmp_path / "trends" / "M1.arrow", {ALARMS: by_old_rules})
    Publisher(output, tmp_path, "old").nights("trends", (ALARMS,), ["M1"], lambda *_: None)
    record = read_record(output, "M1")
    assert record is not None
    rules = rules_now(motor())
    assert record.rules == rules
    write_record(output, "M1", replace(record, trend_hash="", rules={**rules, "trends": 0}))
    (told,) = run(config).alarms
    assert (told["indicator"], told["from_state"], told["to_state"]) == (
        "K_balance_sleeve",
        "alarm",
        "ok",
    )
    assert told["rules"] == f"trends 0 to {TRENDS_VERSION}"
    alarms = rows(output, ALARMS).filter(indicator="K_balance_sleeve")
    raised = alarms.filter(pl.col("to_state").is_in(["warning", "alarm"]))
    assert raised["night"].to_list() == list(by_old_rules)
    assert alarms.filter(~pl.col("is_silent"))["night"].to_list() == [told["night"]]
    assert run(config).alarms == ()
    assert rows(output, ALARMS).filter(indicator="K_balance_sleeve").equals(alarms)


# Which nights


SPECS = [named(motor(), name, circuit) for name, circuit in (("A", "t"), ("B", "t"), ("C", ""))]


OTHER_A = named(motor(), "A", "t", [event(20, "oil_change", oil="vg46")])


def task(changed: dict[str, dt.date | None], output: Path, *said: Decision) -> TrendTask:
    circuit = Circuit.of(output, SPECS[:2], said)
    return TrendTask((circuit,), output, output, changed, Tonight(night_of(39)))


def to_do(one: TrendTask) -> dict[str, tuple[dt.date, dt.date]]:
    found = histories(*(Nights(spec, 40) for spec in one.specs))
    (circuit,) = one.circuits
    return circuit.nights_to_do(one.changed_from, one.tonight, found)


def remember(output: Path, last: int) -> None:
    for spec in SPECS[:2]:
        write_record(output, spec.motor_id, Record(trend_hash(spec, ()), night_of(last)))


def test_all_nights_are_to_be_made_at_first(tmp_path: Path) -> None:
    everything = (dt.date.min, night_of(39))
    asked = {"A": night_of(0), "B": None}
    assert to_do(task(asked, tmp_path)) == {"A": everything, "B": everything}


def test_only_new_nights_later(tmp_path: Path) -> None:
    remember(tmp_path, 37)
    asked = {"A": night_of(38), "B": None}
    span = (night_of(38), night_of(39))
    assert to_do(task(asked, tmp_path)) == {"A": span, "B": span}


def test_a_late_log_of_one_motor_redoes_its_circuit_from_there(tmp_path: Path) -> None:
    remember(tmp_path, 39)
    asked = {"A": night_of(20), "B": None}
    span = (night_of(20), night_of(39))
    assert to_do(task(asked, tmp_path)) == {"A": span, "B": span}


def test_what_a_broken_run_left_is_done_by_the_next(tmp_path: Path) -> None:
    remember(tmp_path, 39)
    note_touched(tmp_path, "B", night_of(25))
    note_touched(tmp_path, "B", night_of(31))
    span = (night_of(25), night_of(39))
    assert to_do(task({"A": None, "B": None}, tmp_path)) == {"A": span, "B": span}


def test_what_was_said_of_one_motor_redoes_that_motor(tmp_path: Path) -> None:
    remember(tmp_path, 39)
    span = (dt.date.min, night_of(39))
    said = reset(20, motor_id="A")
    assert to_do(task({"A": None, "B": None}, tmp_path, said)) == {"A": span}
    # An acknowledgement changes no figure.
    acknowledged = replace(said, kind="acknowledged")
    assert to_do(task({"A": None, "B": None}, tmp_path, acknowledged)) == {}


def test_what_its_own_settings_made_anew_redoes_no_other_motor(tmp_path: Path) -> None:
    """Another oil from a night on, say: its rows are others from there on."""
    remember(tmp_path, 39)
    circuits = (Circuit.of(tmp_path, (OTHER_A, SPECS[1]), ()),)
    changed = replace(task({"A": night_of(20), "B": None}, tmp_path), circuits=circuits)
    assert to_do(changed) == {"A": (dt.date.min, night_of(39))}
    # Nor a motor that joins with nights of its own.
    (tmp_path / "ledger" / "A" / "trends").unlink()
    assert to_do(task({"A": night_of(0), "B": None}, tmp_path)) == {
        "A": (dt.date.min, night_of(39))
    }


def test_a_motor_that_was_not_asked_for_gets_no_new_nights(tmp_path: Path) -> None:
    remember(tmp_path, 35)
    found = to_do(task({"A": night_of(30)}, tmp_path))
    assert found == {"A": (night_of(30), night_of(39)), "B": (night_of(30), night_of(35))}


def test_a_damaged_record_is_none(tmp_path: Path) -> None:
    remember(tmp_path, 39)
    (tmp_path / "ledger" / "A" / "trends").write_text('{"trend_hash": 1', encoding="utf-8")
    assert read_record(tmp_path, "A") is None
    found = to_do(task({"A": None, "B": None}, tmp_path))
    assert found == {"A": (dt.date.min, night_of(39))}


def test_tasks_hold_whole_circuits(tmp_path: Path) -> None:
    assert [[one.motor_id for one in group] for group in circuits_of(SPECS)] == [["C"], ["A", "B"]]

    def motors(*changed: str) -> list[list[str]]:
        made = trend_tasks(
            SPECS,
            tmp_path,
            tmp_path,
            dict.fromkeys(changed),
            Tonight(night_of(0)),
            (),
            motors_a_task=1,
        )
        return [[spec.motor_id for spec in one.specs] for one in made]

    assert motors("A") == [["A", "B"]]
    assert motors("C", "B") == [["C"], ["A", "B"]]
    assert motors() == []


# Over the fleet


def test_q_values_are_over_the_fleets_slopes_of_one_night() -> None:
    p_values = {"A": 0.001, "B": 0.02, "C": 0.6, "D": None}
    trends = frame(
        TRENDS,
        [
            {
                "run_id": "r",
                "motor_id": name,
                "night": night_of(0),
                "indicator": indicator,
                "p_value": p_value if indicator == "x" else 0.04,
                "q_value": 0.5,
            }
            for name, p_value in p_values.items()
            for indicator in ("x", "y")
        ],
    )
    found = with_q_values(trends, ["A", "B", "D"], 0.05)
    of_x = {row["motor_id"]: row for row in found.filter(indicator="x").to_dicts()}
    # Three slopes that have a p: by Benjamini and Hochberg 3/1 and 3/2 times p.
    assert of_x["A"]["q_value"] == pytest.approx(0.003)
    assert of_x["B"]["q_value"] == pytest.approx(0.03)
    assert (of_x["A"]["is_trend"], of_x["B"]["is_trend"]) == (True, True)
    # What was published of a motor that is not made anew stays.
    assert of_x["C"]["q_value"] == 0.5
    assert of_x["D"]["q_value"] is None
    assert of_x["D"]["is_trend"] is None
    # Each indicator is a family of its own.
    assert found.filter(indicator="y", motor_id="A")["q_value"].to_list() == pytest.approx([0.04])


def test_alarms_are_new_only_once() -> None:
    def row(state: str, way: str = "change", night: int = 0) -> dict[str, object]:
        return {"night": night_of(night), "indicator": "x", "to_state": state, "way": way}

    assert new_alarms([row("warning"), row("alarm", night=1)], [row("warning")]) == [
        row("alarm", night=1)
    ]
    assert new_alarms([row("ok", "recomputed")], [row("ok", "recovered")]) == [
        row("ok", "recomputed")
    ]
    assert new_alarms([row("warning") | {"reason": "in other words"}], [row("warning")]) == []


def test_a_broken_motor_takes_no_other_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pipeline.trends import stage

    publish(
        tmp_path,
        {
            name: pl.concat([Nights(spec, 5).frames()[name] for spec in SPECS[:2]])
            for name in ("fits", "parameters", "operation")
        },
    )
    real = stage.indicators_of

    def broken(history: object, eras: object) -> object:
        if history.spec.motor_id == "A":  # type: ignore[attr-defined]
            raise ZeroDivisionError("in one motor")
        return real(history, eras)  # type: ignore[arg-type]

    monkeypatch.setattr(stage, "indicators_of", broken)
    (tmp_path / "staging").mkdir()
    asked = {"A": night_of(0), "B": night_of(0)}
    circuit = Circuit.of(tmp_path, SPECS[:2], ())
    found = stage.run_trends(
        TrendTask((circuit,), tmp_path, tmp_path / "staging", asked, Tonight(night_of(4)))
    )
    assert found.failures == {"A": Loss("internal", "ZeroDivisionError: in one motor")}
    assert found.nights == {"B": 5}
    assert read_record(tmp_path / "staging", "B") is not None

"""The queries of `docs/queries.md`: their answers are right, on tables with known differences."""

from __future__ import annotations

import datetime as dt
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.schema import (
    ALARMS,
    BASELINES,
    BLOCK_STATISTICS,
    DECISIONS,
    FITS,
    LATEST,
    PARAMETERS,
    QUALITY,
    SENSITIVITIES,
    TRENDS,
    WATCH,
    Table,
    frame,
)
from pipeline.store.tables import night_file, read_table, table_folder, whole_file, write_table
from pipeline.store.views import write_views
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows.motor_states import MotorState, latest_rows
from pipeline.trends.rows.watch_rows import WatchRow
from tests.pipeline.written import write_nights
from tests.query_page import PAGE, answer, questions

EARLIER = dt.timedelta(days=40)
NEWEST = dt.date(2026, 1, 4)
FAILED, THIN, STEADY = "CB560-01", "CB400-01", "CB560-02"

Rows = list[dict[str, Any]]


WORN, SLOW, HEALTHY = "CB560-01", "CB400-02", "CB400-01"
FIRST_OF_WATCH, LAST_OF_WATCH = dt.date(2026, 1, 2), dt.date(2026, 4, 21)
SINCE, TOLD_ON = dt.date(2026, 3, 13), dt.date(2026, 3, 15)
PER_YEAR = 83.6


def watch_rows() -> list[WatchRow]:
    """A sleeve damaged within a day, wear that is alarmed, and a healthy motor: two nights each."""
    told = {"since": SINCE, "told_on": TOLD_ON, "change": 0.38, "goes_on": False}
    states: dict[str, tuple[str, dict[str, Any]]] = {
        WORN: ("alarm", told | {"cause": "balance_sleeve", "tonight_change": 0.4}),
        SLOW: ("warning", told | {"cause": "cannot_be_told", "tonight_change": 0.1}),
        HEALTHY: ("ok", {"tonight_change": 0.0}),
    }
    nights = (LAST_OF_WATCH - dt.timedelta(days=1), LAST_OF_WATCH)
    return [
        WatchRow(motor_id, night, state, f"it is {state}", "Look.", **figures)
        for night in nights
        for motor_id, (state, figures) in states.items()
    ]


def slopes(row: WatchRow) -> Rows:
    """Rows of `trends` of a night: only the slow one has a slope, and days to its limit."""
    key = {"motor_id": row.motor_id, "night": row.night, "indicator": "own_reference_leakage"}
    slope = {"baseline_mean": 2.0, "n_slope": 110, "slope_start": FIRST_OF_WATCH}
    slope |= {"provisional": False, "unit": "l/min"}
    if row.motor_id == SLOW:
        per_year = 0.02 * PER_YEAR
        slope |= {"slope_per_year": per_year, "slope_per_year_lower": 0.9 * per_year}
        slope |= {"slope_per_year_upper": 1.1 * per_year, "slope_per_1000_h": per_year / 4.383}
        slope |= {"days_to_limit": 90.0, "days_to_limit_lower": 60.0, "days_to_limit_upper": 150.0}
        slope |= {"days_to_limit_status": "finite", "limit": 2.6}
    if row.motor_id == WORN:
        slope |= {"slope_per_year": 0.1, "slope_per_year_lower": -0.1}
        slope |= {"days_to_limit_lower": 0.0, "days_to_limit_status": "already_crossed"}
    return [key | slope]


def write_trends(output: Path) -> None:
    """The trend tables of those motors, and what people said of the first."""
    watch = watch_rows()
    raised: dict[str, Any] = {
        "indicator": "leakage",
        "from_state": "ok",
        "to_state": "warning",
        "way": "change",
    }
    raised |= {"time": dt.datetime(2026, 3, 15, 6, tzinfo=dt.UTC), "night": TOLD_ON}
    reset = {"motor_id": WORN, "night": TOLD_ON, "indicator": "leakage", "n": 8}
    reset |= {"start": SINCE + dt.timedelta(days=3), "reason": "reset: sleeves seen"}
    first = reset | {"start": FIRST_OF_WATCH, "night": FIRST_OF_WATCH, "reason": "first nights"}
    rows: dict[Table, Rows] = {
        WATCH: [one.row for one in watch],
        TRENDS: [row for one in watch for row in slopes(one)],
        ALARMS: [raised | {"motor_id": motor_id} for motor_id in (WORN, SLOW)],
        BASELINES: [reset, first, first | {"motor_id": SLOW}],
    }
    for table, own in rows.items():
        whole = frame(table, [{"run_id": "made", **row} for row in own])
        write_nights(output, table, whole)
    states = [
        MotorState(one.motor_id, one.state, one.sentence, one.advice, one)
        for one in watch
        if one.night == LAST_OF_WATCH
    ]
    write_table(whole_file(output, LATEST), frame(LATEST, latest_rows(states, "made")))
    said = [{"run_id": "made", **asdict(one)} for one in decisions()]
    decisions_file = table_folder(output, DECISIONS) / "decisions.parquet"
    write_table(decisions_file, frame(DECISIONS, said).sort(DECISIONS.key))
    write_views(output)


def decisions() -> list[Decision]:
    """The sleeves' alarm was inspected twice, a sensor's once and in vain."""
    when = dt.datetime(2026, 4, 1, tzinfo=dt.UTC)
    first = Decision(WORN, "leakage", when, "finding", TOLD_ON, "not_confirmed", "nothing")
    second = replace(first, time=when + EARLIER, finding="confirmed", note="a sleeve is scored")
    vain = replace(first, motor_id=SLOW)
    seen = replace(first, kind="acknowledged", finding=None, motor_id=HEALTHY)
    return [first, second, vain, seen]


def known(rows: pl.DataFrame, table: Table) -> pl.DataFrame:
    if table is not PARAMETERS:
        return rows
    is_factor = pl.col("parameter").str.starts_with("K_") & (pl.col("verdict") != "fixed")
    verdict = pl.when(is_factor).then(pl.lit("identified")).otherwise("verdict")
    return rows.with_columns(verdict=verdict)


def less_worn(table: Table) -> dict[str, pl.Expr]:
    if table is FITS:
        return {"reference_leakage_l_per_min": 0.8 * pl.col("reference_leakage_l_per_min")}
    if table is PARAMETERS:
        half = pl.when(pl.col("parameter") == "K_piston_ring").then(0.5).otherwise(1.0)
        return {"value": half * pl.col("value")}
    return {}


def with_faults(rows: pl.DataFrame) -> pl.DataFrame:
    failed, thin = pl.col("motor_id") == FAILED, pl.col("motor_id") == THIN
    figures = [
        name
        for name, kind in FITS.schema.items()
        if kind == pl.Float64 or name.endswith(("verdict", "interval_status"))
    ]
    return rows.with_columns(
        pl.when(failed).then(None).otherwise(pl.col(name)).alias(name) for name in figures
    ).with_columns(
        status=pl.when(failed).then(pl.lit("failed")).otherwise("status"),
        error_code=pl.when(failed).then(pl.lit("log_truncated")).otherwise("error_code"),
        kept_share=pl.when(thin).then(0.5).otherwise("kept_share"),
        validation_fit_percent=pl.when(thin)
        .then(pl.col("training_fit_percent") - 30)
        .otherwise("validation_fit_percent"),
    )


QUESTIONS = questions()


@pytest.fixture(scope="module")
def history(fitted_output: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's nights, and 40 days before them the same with known differences.

    Leakage was 20 % less then, K of the rings half; all K count as identified. Of the newest
    night, one motor's log has failed and another's few samples do not fit. The earlier files are
    of an older version, with fewer columns.
    """
    folder = tmp_path_factory.mktemp("history")
    for table in (FITS, PARAMETERS, SENSITIVITIES, QUALITY, BLOCK_STATISTICS):
        for path in table_folder(fitted_output, table).rglob("*.parquet"):
            rows = known(read_table(path, table), table)
            before = rows.with_columns(pl.col("night") - EARLIER, **less_worn(table))
            added = [name for name in list(table.schema)[-2:] if name not in table.key]
            write_nights(folder / "out", table, before.drop(added))
            is_newest = pl.col("night") == NEWEST
            if table is FITS:
                rows = pl.concat([rows.filter(~is_newest), with_faults(rows.filter(is_newest))])
            write_nights(folder / "out", table, rows)
    write_trends(folder / "out")
    return folder


def fits(history: Path, **values: object) -> Rows:
    """Primary rows of `fits` with the given values, of the newer nights."""
    nights = [NEWEST - dt.timedelta(days=day) for day in range(3)]
    newer = read_table(night_file(history / "out", FITS, NEWEST), FITS, wanted={"night": nights})
    rows = newer.filter("is_primary").to_dicts()
    return [row for row in rows if all(row[name] == value for name, value in values.items())]


@pytest.mark.parametrize("number", QUESTIONS)
def test_the_page_shows_the_columns_of_the_answer(
    number: int, history: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(history)
    query, columns = QUESTIONS[number]
    found = answer(query)
    assert tuple(found.columns) == columns
    assert found.height > 0


def test_page_has_the_questions_in_order() -> None:
    assert list(QUESTIONS) == list(range(1, 1 + PAGE.read_text("utf-8").count("\n## ") - 1))


@pytest.fixture
def ask(history: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(history)
    return lambda number: answer(QUESTIONS[number][0]).to_dicts()


def test_6_through_the_ring(ask: Any) -> None:
    rows = ask(6)
    rings = [row for row in rows if row["path"] == "piston_ring"]
    assert len(rings) == 6
    # Twice the K is a gap higher by the cube root of 2.
    assert all(row["leakage_percent"] == pytest.approx(100.0) for row in rings)
    assert all(row["gap_percent"] == pytest.approx(25.992105) for row in rings)
    assert rows[: len(rings)] == rings
    others = rows[len(rings) :]
    assert {row["path"] for row in others} == {"balance_piston", "balance_sleeve"}
    assert all(row["leakage_percent"] == pytest.approx(0.0, abs=1e-9) for row in others)


def test_7_nights_to_distrust(ask: Any) -> None:
    rows = [(row["motor_id"], row["night"], row["why"]) for row in ask(7)]
    assert rows == sorted(rows)
    assert (FAILED, NEWEST, "failed") in rows
    assert {why for motor, night, why in rows if (motor, night) == (THIN, NEWEST)} == {
        "few samples kept",
        "validation",
    }
    assert not [why for motor, _, why in rows if motor == STEADY]
    assert [why for motor, _, why in rows if motor == FAILED].count("no intervals") == 0


def test_8_refused_data(ask: Any, history: Path) -> None:
    rows = ask(8)
    newer = [NEWEST - dt.timedelta(days=day) for day in range(3)]
    path = night_file(history / "out", QUALITY, NEWEST)
    nights = read_table(path, QUALITY, wanted={"night": newer}).to_dicts()
    found = {(row["motor_id"], row["channel"], row["reason"]): row for row in rows}
    assert len(found) == len(rows)
    for key, row in found.items():
        own = [n for n in nights if (n["motor_id"], n["channel"], n["reason"]) == key]
        refused, looked_at = (sum(n[name] for n in own) for name in ("n_refused", "n_samples"))
        assert row["n_refused"] == refused > 0
        assert row["refused_percent"] == pytest.approx(100 * refused / looked_at)
    assert not {"any", "incomplete"} & {row["reason"] for row in rows}
    shares = [row["refused_percent"] for row in rows]
    assert shares == sorted(shares, reverse=True)


def test_9_error_budget(ask: Any, history: Path) -> None:
    rows = [row for row in ask(9) if row["motor_id"] == STEADY]
    assert len(rows) == 3
    (fit,) = fits(history, motor_id=STEADY, night=NEWEST)
    leakage = fit["reference_leakage_l_per_min"]
    known = read_table(
        night_file(history / "out", SENSITIVITIES, NEWEST),
        SENSITIVITIES,
        wanted={"night": [NEWEST]},
    )
    own = known.filter(motor_id=STEADY, indicator="reference_leakage")
    effects = dict(own.select("source", "effect").rows())
    largest = sorted(effects, key=lambda source: -abs(effects[source]))[:3]
    assert [row["source"] for row in rows] == largest
    # The systematic ± is the root of the sum of all squares.
    total = fit["reference_leakage_systematic"]
    for row in rows:
        effect = effects[row["source"]]
        assert row["effect_percent"] == pytest.approx(100 * effect / leakage)
        assert row["share_percent"] == pytest.approx(100 * (effect / total) ** 2, rel=1e-6)


def test_10_excitation(ask: Any) -> None:
    rows = {row["motor_id"]: row for row in ask(10)}
    assert rows[STEADY]["nights"] == 3
    assert rows[FAILED]["nights"] == 2
    assert rows["CB1120-02"]["nights_reference"] == 0
    # It runs at 180 bar; the others between 10 and 300.
    assert rows["CB1120-02"]["lowest_bar"] > 90
    assert rows[STEADY]["lowest_bar"] < 20
    assert rows[STEADY]["highest_bar"] > 250


def test_11_last_fits(ask: Any) -> None:
    first, *others = ask(11)
    expected = {"motor_id": FAILED, "last_fit": NEWEST - dt.timedelta(days=1), "days_behind": 1}
    expected |= {"newest_status": "failed", "error_code": "log_truncated", "nights_failed": 1}
    assert first == expected
    assert {row["days_behind"] for row in others} == {0}
    assert {row["error_code"] for row in others} == {""}


def test_1_motors_that_have_changed(ask: Any) -> None:
    worn, slow = ask(1)
    assert (worn["motor_id"], worn["state"], worn["cause"]) == (WORN, "alarm", "balance_sleeve")
    assert worn["change_percent"] == pytest.approx(40.0)
    assert (worn["since"], worn["told_on"]) == (SINCE, TOLD_ON)
    assert (slow["motor_id"], slow["cause"]) == (SLOW, "cannot_be_told")


def test_4_what_wears(ask: Any) -> None:
    (ring,) = ask(4)
    assert ring["motor_id"] == SLOW
    assert ring["percent_per_year"] == pytest.approx(PER_YEAR)
    assert ring["lower"] == pytest.approx(0.9 * PER_YEAR)


def test_5_days_to_limits(ask: Any) -> None:
    first, second = ask(5)
    assert (first["motor_id"], first["status"], first["days"]) == (WORN, "already_crossed", None)
    assert (second["motor_id"], second["status"]) == (SLOW, "finite")
    assert second["earliest"] < second["days"] < second["latest"]


def test_3_changes_and_what_begins_with_them(ask: Any) -> None:
    slow, worn = ask(3)
    assert (worn["motor_id"], worn["told_on"], worn["since"]) == (WORN, TOLD_ON, SINCE)
    assert worn["change_percent"] == pytest.approx(38.0)
    assert worn["dated"] == "reset: sleeves seen"
    assert (slow["motor_id"], slow["dated"]) == (SLOW, None)


def test_12_findings(ask: Any) -> None:
    """Said twice of one alarm, the last word counts."""
    (row,) = ask(12)
    assert (row["indicator"], row["raised"]) == ("leakage", 2)
    assert (row["inspected"], row["confirmed"], row["confirmed_percent"]) == (2, 1, 50.0)

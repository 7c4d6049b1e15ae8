"""The queries of `docs/queries.md`: their answers are right."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.schema import (
    BLOCK_STATISTICS,
    FITS,
    PARAMETERS,
    QUALITY,
    SENSITIVITIES,
)
from pipeline.store.tables import night_file, read_table, table_folder
from tests.pipeline.written import write_nights
from tests.queried_tables import (
    EARLIER,
    FAILED,
    NEWEST,
    PER_YEAR,
    SINCE,
    SLOW,
    STEADY,
    THIN,
    TOLD_ON,
    WORN,
    Rows,
    known,
    less_worn,
    with_faults,
    write_trends,
)
from tests.query_page import PAGE, answer, questions

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

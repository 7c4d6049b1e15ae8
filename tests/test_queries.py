"""The queries of `docs/queries.md`: their answers are right, on tables with known differences."""

from __future__ import annotations

import datetime as dt
import re
from contextlib import chdir
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.schema import ERROR_BUDGET, LATEST, NIGHTS, QUALITY, TRENDS, Table, frame
from pipeline.store.publishing import write_views
from pipeline.store.tables import whole_file
from tests.pipeline.written import write_nights, write_table
from tests.query_page import PAGE, questions, views

Rows = list[dict[str, Any]]

FIRST, N = dt.date(2026, 1, 1), 80
WORN, STEADY = "CB560-01", "CB400-01"
ONSET, FOUND = dt.date(2026, 2, 20), dt.date(2026, 2, 24)
LAST = FIRST + dt.timedelta(days=N - 1)
QUESTIONS = questions()
# What an analyst asks who does not know the program: a query and a few lines of Polars each.
OF_ANALYSTS = (1, 2, 3, 4, 5)


def night_rows() -> Rows:
    """A motor whose leakage rises by a fifth, with poor data in ten nights, and a steady one."""
    rows = []
    for place in range(N):
        night = FIRST + dt.timedelta(days=place)
        for motor, kind in ((WORN, "CB560"), (STEADY, "CB400")):
            is_worn = motor == WORN and night >= ONSET
            leakage = 1.2 if is_worn else 1.0
            row: dict[str, Any] = {"motor_id": motor, "night": night, "motor_type": kind}
            row |= {"status": "ok", "own_leakage_l_per_min": leakage, "kept_percent": 97.0}
            row |= {"own_leakage_lower": leakage - 0.1, "own_leakage_upper": leakage + 0.1}
            row |= {"training_fit_percent": 99.0, "validation_fit_percent": 98.0}
            row |= {"previous_model_fit_percent": 98.0, "state": "ok"}
            if motor == WORN and place < 10:
                row |= {"validation_fit_percent": 70.0, "kept_percent": 70.0}
            if is_worn and night >= FOUND:
                row |= {"state": "warning", "cause": "piston_ring", "onset": ONSET}
                row |= {"detected_on": FOUND, "still_rising": False, "mean_change_percent": 20.0}
            rows.append(row)
    failed = {"status": "failed", "reason": "a.csv: its end is missing", "error_code": "x"}
    rows[-1] |= failed | {"own_leakage_l_per_min": None}
    return rows


def made() -> dict[Table, Rows]:
    nights = night_rows()
    key = {"motor_id": WORN, "night": LAST}
    refused = {WORN: 10, STEADY: 1}
    quality = [
        {"motor_id": row["motor_id"], "night": row["night"], "channel": "speed", "reason": reason}
        | {"n_samples": 100, "n_refused": refused[row["motor_id"]], "n_noted": 0}
        for row in nights
        for reason in ("any", "gap")
    ]
    slope = {"slope_per_year": 0.5, "slope_per_year_lower": 0.4, "slope_per_year_upper": 0.6}
    slope |= {"slope_per_1000_h": 0.1, "baseline_mean": 1.0, "n_nights": 20}
    effects = {"density": 0.1, "leakage_flow gain": -0.3, "speed gain": 0.2, "oil": 0.05}
    budget = [
        key
        | {"flushing_mode": "none", "indicator": "fitted_leakage", "source": source}
        | {"tolerance": 1.0, "tolerance_unit": "1", "effect": effect, "is_assumed": False}
        for source, effect in effects.items()
    ]
    return {
        NIGHTS: nights,
        QUALITY: quality,
        TRENDS: [key | slope | {"indicator": "own_leakage"}],
        ERROR_BUDGET: budget,
    }


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the tables of those two motors."""
    output = tmp_path_factory.mktemp("history") / "out"
    tables = made()
    for table, rows in tables.items():
        write_nights(output, table, frame(table, [{"run_id": "made", **row} for row in rows]))
    days = {"days_to_limit_status": "finite", "days_to_limit_lower": 60.0, "days_to_limit": 90.0}
    last = [row | {"run_id": "made"} for row in tables[NIGHTS] if row["night"] == LAST]
    rows = [row | days if row["motor_id"] == WORN else row for row in last]
    write_table(whole_file(output, LATEST), frame(LATEST, rows))
    write_views(output)
    return output.parent


@pytest.fixture(scope="module")
def answers(history: Path) -> dict[int, pl.DataFrame]:
    """The answer to each question."""
    with chdir(history), views() as tables:
        return {number: tables.sql(query).pl() for number, (query, _) in QUESTIONS.items()}


@pytest.fixture
def ask(answers: dict[int, pl.DataFrame]) -> Any:
    return lambda number: answers[number].to_dicts()


def test_the_page_has_the_questions_in_order_with_the_columns_of_their_answers(
    answers: dict[int, pl.DataFrame],
) -> None:
    assert list(QUESTIONS) == list(range(1, 13))
    for number, (query, columns) in QUESTIONS.items():
        assert tuple(answers[number].columns) == columns
        assert answers[number].height > 0
        assert len(set(re.findall(r"\b(?:FROM|JOIN) (\w+)", query))) == 1
        assert number not in OF_ANALYSTS or query.count("\n") <= 8


@pytest.mark.parametrize("number", OF_ANALYSTS)
def test_polars_gives_the_same(
    number: int, history: Path, answers: dict[int, pl.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(history)
    section = PAGE.read_text("utf-8").split(f"\n## {number}. ")[1]
    code = section.split("```python\n")[1].split("```")[0]
    assert code.count("\n") <= 8
    names: dict[str, Any] = {"pl": pl}
    exec(code, names)  # noqa: S102 - of our own page
    expected = answers[number]
    found = names["answer"].select(expected.columns)
    assert found.height == expected.height
    same = found.join(expected, on=expected.columns[:1], how="full", coalesce=True)
    for row in same.iter_rows(named=True):
        for name in expected.columns:
            if isinstance(row.get(f"{name}_right"), float) and number != 1:
                assert row[name] == pytest.approx(row[f"{name}_right"])


# By question, a row of its answer: what it is of, and what it says.
ROWS: list[tuple[int, dict[str, Any], dict[str, Any]]] = [
    (1, {"motor_id": WORN, "month": dt.date(2026, 1, 1)}, {"own_leakage_l_per_min": 1.0}),
    (
        *(1, {"motor_id": WORN, "month": dt.date(2026, 3, 1)}),
        {"own_leakage_l_per_min": 1.2, "own_leakage_lower": 1.1},
    ),
    (2, {"motor_id": WORN}, {"percent": 20.0}),
    (3, {"motor_type": "CB560"}, {"nights": N, "worst_of_20": 70.0}),
    (3, {"motor_type": "CB400"}, {"nights": N - 1}),
    (4, {"motor_id": WORN}, {"nights_apart": 10}),
    (4, {"motor_id": STEADY}, {"nights_apart": 0}),
    (5, {"motor_id": WORN}, {"channel": "speed", "bad_nights": N, "refused_percent": 10.0}),
    (5, {"motor_id": STEADY}, {"bad_nights": 0}),
    (7, {"motor_id": WORN}, {"onset": ONSET}),
    (8, {"motor_id": WORN}, {"percent_per_year": 50.0}),
    (11, {"motor_id": STEADY}, {"days_behind": 1, "nights_failed": 1}),
    (11, {"motor_id": WORN}, {"last_fit": LAST}),
]


@pytest.mark.parametrize(("number", "of", "says"), ROWS)
def test_a_row_says_what_is_true(
    ask: Any, number: int, of: dict[str, Any], says: dict[str, Any]
) -> None:
    (row,) = (row for row in ask(number) if row.items() >= of.items())
    assert {name: row[name] for name in says} == pytest.approx(says)


def test_rows_are_those_that_are_asked_for_in_their_order(ask: Any) -> None:
    motors = {number: [row.get("motor_id") for row in ask(number)] for number in QUESTIONS}
    assert [motors[number] for number in (2, 6, 7, 8, 9)] == [[WORN]] * 5
    assert motors[4] == motors[5] == [WORN, STEADY]
    assert (len(motors[1]), motors[12].count(WORN)) == (6, 10)
    assert [row["source"] for row in ask(10)] == ["leakage_flow gain", "speed gain", "density"]
    assert ask(12)[0]["status"] == "failed"
    (reason,) = (row["reason"] for row in ask(11) if row["motor_id"] == STEADY)
    assert "its end is missing" in reason

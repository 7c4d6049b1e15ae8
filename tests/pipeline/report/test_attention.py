"""Which motor is looked at first, and what is said of it."""

from __future__ import annotations

from typing import Any

import polars as pl
import pytest

from pipeline.report.attention import STATES, Attention, attention, changes
from pipeline.report.history import MotorHistory
from pipeline.report.trends import Standing, standings, trend_payload
from tests.pipeline.report.nights import (
    FIRST,
    ONE_DAY,
    fit,
    history,
    parameter,
    scattered,
    unfitted,
)
from tests.pipeline.report.packed import unpacked

STEADY = [fit(number, value) for number, value in enumerate(scattered(30, 1.4, 1))]


def judged(motor: MotorHistory, standing: Standing | None = None, days: int = 0) -> Attention:
    """How a motor stands when the fleet's newest night is so many days after its own."""
    newest = motor.nights[-1] + days * ONE_DAY if motor.nights else None
    return attention(motor, changes(motor), standing, newest)


def with_ring(factors: list[float]) -> MotorHistory:
    rows = [
        parameter(number, "K_piston_ring", factor * 1e-13, 1e-15)
        for number, factor in enumerate(factors)
    ]
    return history(STEADY, rows)


@pytest.mark.parametrize(
    ("code", "reason", "motor"),
    [
        ("never", "no night of this motor", history([])),
        ("never", "log is damaged", history([unfitted(0, "insufficient_data", "log is damaged")])),
        ("failed", "log x is cut", history([*STEADY, unfitted(30, "failed", "log x is cut")])),
        ("few", "7 good nights; 20 are needed", history(STEADY[:7])),
        ("unchanged", "since the first good nights", history(STEADY)),
        ("gap", "piston ring gap +26 %", with_ring([*[1.0] * 10, *[2.0] * 20])),
        ("gap", "piston ring gap −21 %", with_ring([*[1.0] * 10, *[0.5] * 20])),
    ],
)
def test_state_and_reason(code: str, reason: str, motor: MotorHistory) -> None:
    found = judged(motor)
    assert (found.code, found.label) == (code, STATES[code])
    assert reason in found.reason


@pytest.mark.parametrize(("level", "code"), [(1.7, "grown"), (1.1, "fallen"), (1.5, "unchanged")])
def test_a_change_of_15_percent_is_told(level: float, code: str) -> None:
    values = [*scattered(10, 1.4, 1, sd=0.001), *scattered(20, level, 2, sd=0.001)]
    found = judged(history([fit(number, value) for number, value in enumerate(values)]))
    assert found.code == code
    assert code == "unchanged" or {1.7: "+21 %", 1.1: "−21 %"}[level] in found.reason


def test_both_leakage_and_gap_are_told() -> None:
    fits = [fit(n, v) for n, v in enumerate([*scattered(10, 1.0, 1), *scattered(10, 1.3, 2)])]
    rows = [parameter(n, "K_balance_sleeve", 1e-14 * (1 + (n > 9)), 1e-16) for n in range(20)]
    found = judged(history(fits, rows))
    assert found.code == "grown"
    assert "reference leakage +29 %" in found.reason
    assert "balance sleeve gap +26 %" in found.reason


def test_no_recent_good_night() -> None:
    motor = history([*STEADY, *(unfitted(n, "no_new_data", "no log") for n in range(30, 40))])
    found = judged(motor)
    assert (found.code, found.size) == ("stale", 10.0)
    assert "none for 10 nights; 2026-02-09: no log" in found.reason
    assert judged(history(STEADY), days=7).code == "unchanged"
    assert judged(history(STEADY), days=8).code == "stale"


def test_few_good_nights() -> None:
    nights = [fit(n) if n % 3 == 2 else unfitted(n, "stood_still", "stood") for n in range(30)]
    found = judged(history(nights))
    assert (found.code, found.reason) == ("thin", "10 of the last 30 nights are fitted")


def test_a_motor_that_never_shows_its_reference_leakage_says_why() -> None:
    reason = "pressure 200 bar lies outside"
    motor = history([fit(n, None, reference_reason=reason) for n in range(30)])
    found = judged(motor)
    assert found.code == "few"
    assert reason in found.reason


def test_the_most_urgent_comes_first() -> None:
    standing = {state: Standing(state, "why") for state in ("alarm", "warning", "common_cause")}
    ordered = [
        judged(history(STEADY), standing["alarm"]),
        judged(history([*STEADY, unfitted(30, "failed", "x")])),
        judged(history(STEADY), standing["warning"]),
        judged(history([])),
        judged(history(STEADY), days=30),
        judged(history(STEADY), days=9),
        judged(history(STEADY), standing["common_cause"]),
        judged(history(STEADY[:7])),
        judged(history(STEADY)),
    ]
    assert sorted(ordered, key=lambda one: one.rank) == ordered


@pytest.mark.parametrize(
    ("state", "code"),
    [
        ("alarm", "alarm"),
        ("warning", "warning"),
        ("common_cause", "common_cause"),
        ("stale", "stale"),
        ("insufficient", "few"),
        ("ok", "unchanged"),
    ],
)
def test_judged_trends_decide(state: str, code: str) -> None:
    found = judged(with_ring([*[1.0] * 10, *[2.0] * 20]), Standing(state, "as the rules say"))
    assert (found.code, found.reason) == (code, "as the rules say")


# Tables of trends, with the columns of design.md, section 4


def trend(motor: str, number: int, indicator: str, state: str, **more: Any) -> dict[str, Any]:
    row = {"motor_id": motor, "night": FIRST + number * ONE_DAY, "indicator": indicator}
    return (
        row
        | {"value": 1.0 + number, "unit": "l_per_min", "baseline_mean": 1.0}
        | ({"state": state, "run_id": "r"} | more)
    )


TRENDS = {
    "trends": pl.DataFrame(
        [
            trend("M", 0, "reference_leakage", "alarm"),
            trend("M", 1, "reference_leakage", "ok", slope_per_year=0.2, days_to_limit=40.0),
            trend("M", 1, "K_balance_sleeve", "warning", path="balance_sleeve"),
            trend("N", 0, "reference_leakage", "stale"),
            trend("O", 0, "reference_leakage", "ok"),
        ]
    ),
    "alarms": pl.DataFrame(
        {
            "motor_id": ["M", "M"],
            "time": [FIRST, FIRST + ONE_DAY],
            "indicator": ["K_balance_sleeve"] * 2,
            "from_state": ["ok", "ok"],
            "to_state": ["warning", "warning"],
            "reason": ["an earlier one", "balance sleeve leakage +38 % [29, 47]"],
            "run_id": ["r", "r"],
        }
    ),
}


def test_standing_is_the_worst_state_of_the_newest_night_in_the_alarm_s_words() -> None:
    found = standings(TRENDS)
    assert found["M"] == Standing("warning", "balance sleeve leakage +38 % [29, 47]")
    assert found["N"] == Standing("stale", "reference leakage: stale")
    assert found["O"] == Standing("ok", "all indicators within their limits")
    assert standings({}) == {}


def test_trends_of_a_motor_go_to_its_page_and_no_other_s() -> None:
    payload = trend_payload("M", TRENDS)
    assert [one["indicator"] for one in payload["indicators"]] == [
        "K_balance_sleeve",
        "reference_leakage",
    ]
    leakage = payload["indicators"][1]
    assert leakage["nights"] == ["2026-01-01", "2026-01-02"]
    assert unpacked(leakage["value"]).tolist() == [1.0, 2.0]
    assert leakage["state"] == ["alarm", "ok"]
    assert leakage["latest"]["slope_per_year"] == 0.2
    assert [alarm["reason"] for alarm in payload["alarms"]] == TRENDS["alarms"]["reason"].to_list()
    assert payload["change_points"] == []
    assert trend_payload("unknown", TRENDS)["indicators"] == []

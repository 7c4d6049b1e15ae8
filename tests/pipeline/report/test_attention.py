"""Which motor is looked at first, and what is said of it."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from typing import Any

import pytest

from pipeline.report.attention import STATES, Attention, attention, changes
from pipeline.report.history import MotorHistory
from pipeline.report.tables import History
from pipeline.report.trends import Standing, standings, trend_payload
from pipeline.schema import (
    ALARMS,
    BASELINES,
    CHANGE_POINTS,
    FITS,
    PARAMETERS,
    TRENDS,
    frame,
)
from pipeline.trends.decisions import Decision
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
    assert "leakage +29 %" in found.reason
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


def test_the_larger_alarm_comes_first() -> None:
    large = judged(history(STEADY), Standing("alarm", "x", "ok", 40.0))
    small = judged(history(STEADY), Standing("alarm", "y", "ok", 30.0))
    assert large.rank < small.rank


def test_a_drifted_sensor_is_named_before_wear_is() -> None:
    found = judged(history(STEADY), Standing("ok", "fine", "drifted"))
    assert found.code == "sensor"
    both = judged(history(STEADY), Standing("alarm", "leakage +40 %", "drifted"))
    assert both.code == "alarm"
    assert both.reason.startswith("leakage +40 %; the readings at halts say")


# Tables of trends


def trend(motor: str, number: int, indicator: str, state: str, **more: Any) -> dict[str, Any]:
    row = {"motor_id": motor, "night": FIRST + number * ONE_DAY, "indicator": indicator}
    row |= {"value": 1.0 + number, "unit": "l/min", "baseline_mean": 1.0, "n_slope": 30}
    return row | {"state": state, "sensor_health": "ok"} | more


def tables(decisions: tuple[Decision, ...] = ()) -> History:
    trends = [
        trend("M", 0, "reference_leakage", "alarm"),
        trend("M", 1, "reference_leakage", "ok", slope_per_year=0.2, deviation_percent=3.0),
        trend("M", 1, "K_balance_sleeve", "warning", state_reason="sleeve +38 % [29, 47]"),
        trend("M", 1, "leakage_balance_sleeve", "warning", n_slope=None),
        trend("N", 0, "reference_leakage", "stale", state_reason="no figure for 8 nights"),
        trend("O", 0, "reference_leakage", "ok", sensor_health="drifted"),
    ]
    alarm = {"motor_id": "M", "indicator": "K_balance_sleeve", "from_state": "ok"}
    alarm |= {"to_state": "warning", "reason": "sleeve +38 %", "night": FIRST + ONE_DAY}
    baseline = {"motor_id": "M", "indicator": "reference_leakage", "start": FIRST, "end": FIRST}
    changes = {"motor_id": "M", "indicator": "reference_leakage", "size_percent": 5.0}
    return History(
        fits=frame(FITS, [fit(0), fit(1)]),
        parameters=frame(PARAMETERS, []),
        trends={
            "trends": frame(TRENDS, trends),
            "alarms": frame(ALARMS, [alarm | {"time": dt.datetime(2026, 1, 2, 6, tzinfo=dt.UTC)}]),
            "baselines": frame(
                BASELINES,
                [baseline | {"night": FIRST + n * ONE_DAY, "mean": 1.0 + n} for n in range(2)],
            ),
            "change_points": frame(
                CHANGE_POINTS,
                [
                    changes | {"night": FIRST + n * ONE_DAY, "change_night": FIRST + m * ONE_DAY}
                    for n, m in ((0, 0), (1, 1))
                ],
            ),
        },
        decisions=decisions,
    )


SEEN = Decision(
    motor_id="M",
    indicator="K_balance_sleeve",
    time=dt.datetime(2026, 1, 3, 9, tzinfo=dt.UTC),
    kind="acknowledged",
    night=FIRST + ONE_DAY,
    note="ordered a sleeve",
)


def test_standing_is_that_of_the_command_status() -> None:
    found = standings(tables())
    tonight = FIRST + ONE_DAY
    assert found["M"] == Standing(
        "warning", "sleeve +38 % [29, 47]", "ok", 3.0, leakage_is_known=True, leakage_night=tonight
    )
    assert found["N"] == Standing(
        "stale", "no figure for 8 nights", "ok", leakage_is_known=True, leakage_night=FIRST
    )
    assert found["O"] == Standing(
        "ok",
        "all indicators within their limits",
        "drifted",
        leakage_is_known=True,
        leakage_night=FIRST,
    )
    said = standings(tables((SEEN,)))["M"].reason
    assert said == "sleeve +38 % [29, 47] (acknowledged: ordered a sleeve)"
    assert standings(replace(tables(), trends={})) == {}


def test_trends_of_a_motor_go_to_its_page_and_no_other_s() -> None:
    payload = trend_payload("M", tables((SEEN,)))
    # The one that asks for attention first, and of these what alarms are raised on.
    assert [one["indicator"] for one in payload["indicators"]] == [
        "K_balance_sleeve",
        "leakage_balance_sleeve",
        "reference_leakage",
    ]
    leakage = payload["indicators"][2]
    assert leakage["name"] == "reference leakage"
    days = unpacked(leakage["days"]).tolist()
    assert days == [(FIRST + n * ONE_DAY - dt.date(1970, 1, 1)).days for n in range(2)]
    assert unpacked(leakage["value"]).tolist() == [1.0, 2.0]
    assert [payload["order"][int(place)] for place in leakage["states"]] == ["alarm", "ok"]
    assert leakage["latest"]["slope_per_year"] == 0.2
    assert [alarm["reason"] for alarm in payload["alarms"]] == ["sleeve +38 %"]
    # Of what was frozen or seen anew, the newest.
    assert [one["mean"] for one in payload["baselines"]] == [2.0]
    assert [one["change_night"] for one in payload["change_points"]] == ["2026-01-02"]
    assert [one["note"] for one in payload["decisions"]] == ["ordered a sleeve"]
    other = trend_payload("unknown", tables((SEEN,)))
    assert not any(other[name] for name in other if name != "order")

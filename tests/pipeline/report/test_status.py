"""The fleet's state: what needs attention first, what was said of it, and how old it is."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import polars as pl
import pytest

from pipeline.report.status import last_findings
from pipeline.report.words import STATES
from pipeline.schema import FITS, TRENDS, frame
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows.latest_states import motor_states
from pipeline.trends.rows.motor_states import ORDER, LookStanding, MotorState, urgency
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.words import FALL
from tests.pipeline.report.states import LAST, WORN, fits_of, rows_of, said, trend
from tests.pipeline.trends.nights import Nights, motor, night_of, standing, step


def state_of(
    motor_id: str, trends: pl.DataFrame, fits: pl.DataFrame, decisions: Sequence[Decision]
) -> MotorState:
    (found,) = motor_states([motor_id], trends, fits, decisions)
    return found


def test_a_motor_is_as_its_worst_indicator_tonight() -> None:
    found = state_of("M1", rows_of("M1", K_piston_ring=WORN), fits_of("M1"), ())
    assert (found.state, found.indicator) == ("alarm", "K_piston_ring")
    assert found.reason == "K_piston_ring is alarm"
    assert found.leakage_l_per_min == 1.4
    assert found.last_good_night == night_of(LAST)


def test_the_headline_names_every_part_in_alarm() -> None:
    worn = {"balance_piston": step(110, 80, 0.6), "balance_sleeve": step(110, 80, 0.7)}
    rows = [
        one | {"run_id": "r"} for one in trend_rows(standing(Nights(motor(), 110, worn)), [109])
    ]
    found = state_of("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert (found.state, found.indicator) == ("alarm", "K_balance_sleeve")
    assert found.reason.startswith("balance sleeve gap +")
    assert "; balance piston gap +" in found.reason
    assert found.change_start == night_of(80)


def test_a_motor_without_a_baseline_says_how_far_it_has_come_and_what_it_drains() -> None:
    rows = [one | {"run_id": "r"} for one in trend_rows(standing(Nights(motor(), 5)), [4])]
    others = [one for one in rows if one["indicator"] != "reference_leakage"]
    found = state_of("M1", frame(TRENDS, others), fits_of("M1"), ())
    assert (found.state, found.leakage_indicator) == ("insufficient", "comparable_drain_flow")
    assert found.reason == "5 of 15 good nights for a baseline (first nights)"
    # A healthy motor drains what its configured gaps leak (CB560, model.md, section 3).
    assert found.leakage_l_per_min == pytest.approx(1.371423, rel=1e-6)


def of_leakage(name: str, values: list[float | None], **tonight: Any) -> list[dict[str, Any]]:
    rows = [trend("M1", night, name, value=value) for night, value in enumerate(values)]
    rows[-1] |= tonight
    return rows


UNKNOWN = [1.4, 1.4, None, None, None, None]


@pytest.mark.parametrize(
    ("tonight", "ring", "known"),
    [
        ({}, {}, True),
        ({"state": "stale"}, {}, False),
        ({"state": "insufficient"}, {}, False),
        ({}, {"state": "alarm", "change_start": night_of(1)}, True),
        ({}, {"state": "alarm", "change_start": night_of(2)}, False),
    ],
    ids=["held", "stale", "no baseline", "since the change", "before the change"],
)
def test_a_leakage_that_says_nothing_of_now_is_not_told_as_current(
    tonight: dict[str, Any], ring: dict[str, Any], known: bool
) -> None:
    rows = of_leakage("reference_leakage", UNKNOWN, **tonight)
    rows += of_leakage("K_piston_ring", [1.0] * 6, **ring)
    found = state_of("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert found.leakage_night == night_of(1)
    expected = (1.4, 0.0) if known else (None, None)
    assert (found.leakage_l_per_min, found.deviation_percent) == expected


def test_the_leakage_at_the_motors_own_conditions_stands_in_where_it_alone_is_known() -> None:
    rows = of_leakage("reference_leakage", UNKNOWN, state="stale")
    rows += of_leakage("own_reference_leakage", [2.0] * 6, lower=1.9, upper=2.1)
    found = state_of("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert found.leakage_indicator == "own_reference_leakage"
    assert (found.leakage_l_per_min, found.leakage_night) == (2.0, night_of(LAST))
    assert (found.leakage_lower, found.leakage_upper) == (1.9, 2.1)


@pytest.mark.parametrize(
    ("began", "expected"),
    [(None, ("piston_ring", -9.0)), (1, ("piston_ring", -9.0)), (2, ("sleeve", 4.0))],
)
def test_the_gap_that_changed_most_is_one_known_since_the_change(
    began: int | None, expected: tuple[str, float]
) -> None:
    """As the newest rows of `trends` have it; the ring's is of the second night."""
    rows = of_leakage("gap_change_piston_ring", [2.0, -9.0, None, None], n_slope=None)
    rows += of_leakage("gap_change_sleeve", [8.0, 4.0, 4.0, 4.0], n_slope=None)
    change = {} if began is None else {"state": "alarm", "change_start": night_of(began)}
    rows += of_leakage("K_piston_ring", [1.0] * 4, **change)
    found = state_of("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert (found.gap_path, found.gap_change_percent) == expected


def test_a_last_night_that_failed_is_told_and_comes_before_motors_in_order() -> None:
    failed = {"run_id": "r", "motor_id": "M1", "night": night_of(6), "status": "failed"}
    fits = pl.concat([fits_of("M1"), frame(FITS, [failed | {"reason": "the log is cut"}])])
    found = state_of("M1", rows_of("M1"), fits, ())
    assert (found.state, found.failure) == ("ok", "night of 2026-01-08 failed: the log is cut")
    assert found.why == f"no change of external leakage; {found.failure}"
    fine = state_of("M0", rows_of("M0"), fits_of("M0"), ())
    assert fine.failure == ""
    assert urgency(found) < urgency(fine)


def test_a_poor_fit_of_the_last_good_night_is_told() -> None:
    def said(*fits: dict[str, Any]) -> str:
        rows = [
            {"run_id": "r", "motor_id": "M1", "night": night_of(night), "is_primary": True} | fit
            for night, fit in enumerate(fits)
        ]
        return state_of("M1", rows_of("M1"), frame(FITS, rows), ()).poor_fit

    good = {"status": "ok", "training_fit_percent": 99.0, "validation_fit_percent": 0.0}
    poor = good | {"validation_fit_percent": -1295.0}
    assert said(poor, good) == ""
    assert said(good | {"validation_fit_percent": None}) == ""
    assert said(good, poor, {"status": "failed"}) == (
        "fit of 2026-01-03: validation -1295.0 % (poor: worse than a constant flow)"
    )


def test_an_alarm_of_the_past_is_past() -> None:
    over = [*WORN[:5], "ok"]
    found = state_of("M1", rows_of("M1", K_piston_ring=over), fits_of("M1"), ())
    assert (found.state, found.indicator, found.reason) == ("ok", None, None)


def test_a_motor_that_never_sees_the_fleets_conditions_is_judged_by_its_others() -> None:
    rows = rows_of("M1", reference_leakage=["insufficient"] * (LAST + 1))
    assert state_of("M1", rows, fits_of("M1"), ()).state == "ok"


def test_a_sensor_alone_makes_no_motor_ok_and_one_that_drifts_is_named() -> None:
    missing = ["insufficient"] * (LAST + 1)
    rows = rows_of("M1", reference_leakage=missing, K_piston_ring=missing)
    zero = [trend("M1", LAST, name, n_slope=None) for name in ("flow_zero", "pressure_zero")]
    found = state_of("M1", pl.concat([rows, frame(TRENDS, zero)]), fits_of("M1"), ())
    assert found.state == "insufficient"
    reason = "the zero of the flow sensor has moved"
    moved = {"state": "warning", "deviation_percent": None, "state_reason": reason}
    rows = pl.concat([rows_of("M1"), frame(TRENDS, [zero[0] | moved])])
    found = state_of("M1", rows, fits_of("M1"), ())
    assert (found.state, found.indicator, found.reason) == ("ok", None, reason)


def test_a_silent_motor_is_stale() -> None:
    stale = ["ok"] * 3 + ["stale"] * 3
    rows = rows_of("M1", reference_leakage=stale, K_piston_ring=stale)
    found = state_of("M1", rows, fits_of("M1", 3), ())
    assert found.state == "stale"
    assert found.last_good_night == night_of(2)


def test_without_trends_there_is_a_state_too() -> None:
    found = state_of("M1", rows_of("M2").clear(), fits_of("M1", 2), ())
    assert (found.state, found.reason) == ("insufficient", "no trends yet")


def test_what_was_said_since_the_state_began_is_shown() -> None:
    rows = rows_of("M1", K_piston_ring=WORN)

    def shown(*decisions: Decision) -> str:
        return state_of("M1", rows, fits_of("M1"), decisions).acknowledged

    assert shown() == ""
    assert shown(said(4, note="rings ordered")) == "rings ordered"
    assert shown(said(4)) == "acknowledged"
    # The warning before was another state, and a reset says nothing of the alarm.
    assert shown(said(2, note="seen")) == ""
    assert shown(said(4, "baseline_reset", note="x")) == ""
    assert (
        shown(said(4, note="seen"), said(5, "finding", finding="confirmed", note="worn")) == "worn"
    )
    other = replace(said(4, note="other"), indicator="K_balance_sleeve")
    assert shown(other) == ""


def test_of_an_alarm_that_was_inspected_twice_the_last_word_counts() -> None:
    first = said(4, "finding", finding="not_confirmed")
    second = replace(first, finding="confirmed", time=first.time + dt.timedelta(days=1))
    elsewhere = replace(first, motor_id="M2")
    found = last_findings([first, said(4), second, elsewhere])
    assert sorted(found) == ["confirmed", "not_confirmed"]


def test_dates_and_the_effect_of_temperature_stand_in_the_words_of_a_state() -> None:
    said = {"reason": "ring gap +18 %", "limit_dates": "not before August 2027"}
    found = MotorState("M", "warning", **said, temperature_effect="K falls by 1 % a kelvin")
    assert found.why == "ring gap +18 %; its limit not before August 2027; K falls by 1 % a kelvin"


FALLEN = f"reference leakage is down to -6 % [-10, -1] after a rise since 3 March 2026; {FALL}"


@pytest.mark.parametrize(
    ("state", "advice"),
    [
        (MotorState("M", "alarm", path="piston_ring"), "Look at the piston ring at the next stop."),
        (
            MotorState("M", "alarm", path="balance_sleeve and balance_piston"),
            "Look at the balance sleeve and the balance piston at the next stop.",
        ),
        (MotorState("M", "warning", path="piston_ring"), "Plan a look at the piston ring."),
        (
            MotorState("M", "alarm"),
            "Look at the motor, as its part is not known, at the next stop.",
        ),
        (MotorState("M", "warning", reason=FALLEN), "Check oil, sensors and flushing first."),
        (MotorState("M", "ok"), "Nothing to do."),
        (MotorState("M", "ok", failure="night failed"), "Mend what failed in the last night."),
    ],
)
def test_each_state_says_what_to_do(state: MotorState, advice: str) -> None:
    assert state.advice == advice


def test_every_state_has_words_and_a_meaning() -> None:
    assert set(STATES) == set(ORDER)
    assert all(MotorState("M", state).advice for state in ORDER)


def test_the_parts_in_the_worst_state_and_since_when_it_is_known() -> None:
    key = {"motor_id": "M", "n_slope": 30, "deviation_percent": 50.0, "sensor_health": "ok"}
    states = {
        "K_balance_sleeve": ("warning", "ok", "warning", "alarm"),
        "K_balance_piston": ("ok", "ok", "ok", "alarm"),
        "K_piston_ring": ("ok", "ok", "ok", "warning"),
    }
    rows = [
        key | {"night": night_of(n), "indicator": name, "state": state}
        for name, course in states.items()
        for n, state in enumerate(course)
    ]
    rows[3] |= {"deviation_percent": 60.0}
    found = state_of("M", frame(TRENDS, rows), frame(FITS, []), [])
    assert found.path == "balance_sleeve and balance_piston"
    # The warning of the first night had ended.
    assert found.known_since == night_of(2)
    assert found.needs_attention


def test_a_sudden_rise_within_the_day_comes_first_and_a_clear_look_is_not_shown() -> None:
    since = dt.datetime(2026, 3, 2, 14, 30, tzinfo=dt.UTC)
    rise = LookStanding("look_now", since, "drain flow +82 % [75, 90]", told=1)
    worn = state_of("M1", rows_of("M1", K_piston_ring=WORN), fits_of("M1"), ())
    broken = replace(state_of("M2", rows_of("M2"), fits_of("M2"), ()), look=rise)
    clear = LookStanding("clear", since, "x")
    quiet = replace(state_of("M3", rows_of("M3"), fits_of("M3"), ()), look=clear)
    assert min((worn, quiet, broken), key=urgency).motor_id == "M2"
    assert "look now since 2026-03-02 14:30 UTC: drain flow +82 % [75, 90]" in broken.why
    assert "clear" not in quiet.why

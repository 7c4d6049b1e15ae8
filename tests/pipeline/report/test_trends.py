"""States and trends as the report reads them from the published tables."""

from __future__ import annotations

import datetime as dt
from typing import Any

import polars as pl

from pipeline.report.history import motor_histories
from pipeline.report.tables import ReportTables
from pipeline.report.trends import changes_of_state, motor_states, trend_payload
from pipeline.schema import ALARMS, BASELINES, CHANGE_POINTS, FITS, TRENDS, frame
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows import latest_states
from tests.pipeline.report.nights import FIRST, ONE_DAY, fit
from tests.pipeline.report.packed import unpacked


def trend(motor: str, number: int, indicator: str, state: str, **more: Any) -> dict[str, Any]:
    row = {"motor_id": motor, "night": FIRST + number * ONE_DAY, "indicator": indicator}
    row |= {"value": 1.0 + number, "unit": "l/min", "baseline_mean": 1.0, "n_slope": 30}
    return row | {"state": state, "sensor_health": "ok"} | more


def tables(decisions: tuple[Decision, ...] = ()) -> ReportTables:
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
    nights = [{"night": FIRST}, {"night": FIRST + ONE_DAY}]
    rows = {
        TRENDS: trends,
        ALARMS: [alarm | {"time": dt.datetime(2026, 1, 2, 6, tzinfo=dt.UTC)}],
        BASELINES: [baseline | one | {"mean": 1.0 + n} for n, one in enumerate(nights)],
        CHANGE_POINTS: [changes | one | {"change_night": one["night"]} for one in nights],
    }
    frames = {table.name: frame(table, own) for table, own in rows.items()}
    return ReportTables(frame(FITS, [fit(0), fit(1)]), frames, decisions=decisions)


SAID = dt.datetime(2026, 1, 3, 9, tzinfo=dt.UTC)
SEEN = Decision(
    "M", "K_balance_sleeve", SAID, "acknowledged", FIRST + ONE_DAY, note="ordered a sleeve"
)


def test_states_are_those_of_the_command_status() -> None:
    read = tables((SEEN,))
    found = motor_states(read, ["M", "N", "new"], {})
    for motor_id, said in {"M": [SEEN], "N": [], "new": []}.items():
        trends, fits = read.trends["trends"], read.fits
        own = (trends.filter(motor_id=motor_id), fits.filter(motor_id=motor_id))
        assert [found[motor_id]] == latest_states.motor_states([motor_id], *own, said)
    assert found["M"].why == "sleeve +38 % [29, 47] (acknowledged: ordered a sleeve)"
    assert (found["new"].state, found["new"].why) == ("insufficient", "no night yet")


def test_without_trends_each_motor_has_a_state() -> None:
    read = ReportTables(frame(FITS, [fit(0)]))
    assert motor_states(read, ["M"], {})["M"].why == "no trends yet"


def payload_of(motor_id: str) -> dict[str, Any]:
    read = tables((SEEN,))
    (motor,) = motor_histories(read, [motor_id])
    return trend_payload(motor, read)


def test_trends_of_a_motor_go_to_its_page_and_no_other_s() -> None:
    payload = payload_of("M")
    # The one that asks for attention first; what the first screen draws is not drawn again.
    factor, leakage = payload["indicators"]
    assert factor["indicator"] == "K_balance_sleeve"
    assert (factor["name"], leakage["name"]) == ("K of the balance sleeve", "reference leakage")
    days = unpacked(leakage["days"]).tolist()
    assert days == [(FIRST + n * ONE_DAY - dt.date(1970, 1, 1)).days for n in range(2)]
    assert unpacked(leakage["value"]).tolist() == [1.0, 2.0]
    assert [payload["order"][int(place)] for place in leakage["states"]] == ["alarm", "ok"]
    assert leakage["latest"]["slope_per_year"] == 0.2
    # Of what was frozen or seen anew, the newest.
    assert [one["mean"] for one in payload["baselines"]] == [2.0]
    assert [one["change_night"] for one in payload["change_points"]] == ["2026-01-02"]
    other = payload_of("unknown")
    assert not any(other[name] for name in other if name != "order")


def test_changes_of_state_come_with_the_newest_first() -> None:
    read = tables()
    alarms = read.trends["alarms"]
    later = alarms.with_columns(time=pl.col("time") + ONE_DAY, reason=pl.lit("later"))
    read.trends["alarms"] = pl.concat([alarms, later])  # type: ignore[index]
    assert [one["reason"] for one in changes_of_state("M", read)] == ["later", "sleeve +38 %"]
    assert changes_of_state("N", read) == []

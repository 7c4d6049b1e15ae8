"""Payload of a motor's page: the watch, and figures of the nights' own fits."""

from __future__ import annotations

import datetime as dt
from typing import Any

import numpy as np

from pipeline.report.build import changes_of_state
from pipeline.report.motor_page import gap_changes, motor_payload
from pipeline.report.tables import ReportTables
from pipeline.schema import ALARMS, FITS, frame
from tests.pipeline.report.nights import FIRST, ONE_DAY, baseline, fit, history, trend, watch
from tests.pipeline.report.packed import unpacked

PATHS = ("piston_ring", "balance_piston", "balance_sleeve", "cam_roller")


def alarm(number: int, to_state: str, indicator: str = "leakage") -> dict[str, Any]:
    row = {"motor_id": "M", "night": FIRST + number * ONE_DAY, "indicator": indicator}
    row |= {"time": dt.datetime(2026, 1, 1 + number, 6, tzinfo=dt.UTC), "from_state": "ok"}
    return row | {"to_state": to_state, "reason": f"night {number}"}


def payload(changes: Any = ()) -> dict[str, Any]:
    nights = [watch(n, 2.0 + n, evidence_limit=9.1) for n in range(3)]
    nights[1] |= {"evidence": 4.0, "tonight_change": 0.5}
    told = {"told_on": FIRST + ONE_DAY, "goes_on": False}
    nights[1] |= told | {"cause": "cannot_be_told"}
    nights[2] |= told | {"cause": "balance_sleeve"}
    rows = [trend(n, "K_balance_sleeve", 1.0 + n, unit="m3") for n in range(3)]
    rows += [trend(n, "gap_change_balance_sleeve", float(n), unit="%") for n in range(3)]
    rows[2] |= {"slope_per_year": 0.2, "days_to_limit_status": "no_trend"}
    motor = history([fit(n) for n in range(3)], nights, rows, baselines=[baseline(2.0)])
    return motor_payload(motor, "M", {FIRST}, changes, [], PATHS)


def test_leakage_evidence_and_baseline_of_the_watch_go_to_the_page() -> None:
    found = payload()
    assert unpacked(found["leakage"]["value"]).tolist() == [2.0, 3.0, 4.0]
    evidence = unpacked(found["watch"]["evidence"])
    assert np.isnan(evidence).tolist() == [True, False, True]
    assert unpacked(found["watch"]["level"]).tolist() == [2.0] * 3
    assert found["baselines"] == [[str(FIRST), str(FIRST + ONE_DAY)]]
    assert found["detailed"] == [1, 0, 0]


def test_changes_that_were_told_are_marked_by_their_last_cause_and_so_is_an_alarm() -> None:
    changes = [alarm(1, "warning"), alarm(2, "alarm"), alarm(2, "alarm", "flow_zero")]
    told, raised = payload(changes)["told"]
    assert told == {"night": str(FIRST + ONE_DAY), "label": "balance sleeve", "isAlarm": False}
    assert (raised["night"], raised["isAlarm"]) == (str(FIRST + 2 * ONE_DAY), True)


def test_figures_of_the_nights_own_fits_are_shown_gaps_in_a_chart_of_their_own() -> None:
    found = payload()
    (gap,) = found["gaps"]
    assert (gap["name"], gap["place"]) == ("balance sleeve", 2)
    (factor,) = found["shown"]
    assert (factor["name"], factor["unit"]) == ("balance sleeve leakage coefficient", "m3")
    assert factor["latest"] == {"slope_per_year": 0.2, "days_to_limit_status": "no_trend"}
    assert gap_changes(history([fit(0)]), PATHS) == []


def test_changes_of_state_come_with_the_newest_first() -> None:
    rows = frame(ALARMS, [alarm(1, "warning"), alarm(2, "ok")])
    read = ReportTables(frame(FITS, []), {"alarms": rows})
    assert [one["reason"] for one in changes_of_state("M", read)] == ["night 2", "night 1"]
    assert changes_of_state("N", read) == []

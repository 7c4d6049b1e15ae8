"""A motor's line on the fleet page: figures that say what is now, and since when there is none."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest

from pipeline.report.fleet_page import FleetRow, fleet_rows
from pipeline.report.history import MotorHistory
from pipeline.report.trends import Standing
from pipeline.schema import BASELINES, TRENDS, frame
from tests.pipeline.report.nights import FIRST, ONE_DAY, fit, history, parameter

LAST = 39
BASELINE = {"motor_id": "M", "indicator": "K_piston_ring", "night": FIRST + 29 * ONE_DAY}
BASELINE |= {"start": FIRST, "end": FIRST + 29 * ONE_DAY, "mean": 1e-13}


def label(number: int) -> dt.date:
    return FIRST + number * ONE_DAY


def motor_of(known: int, own: bool = False) -> MotorHistory:
    """Forty nights; leakage and ring are known up to one of them, the ring 8 times as leaky."""
    trends: dict[str, Any] = {"baselines": frame(BASELINES, [BASELINE])}
    if own:
        rows = [
            {"motor_id": "M", "night": label(number), "indicator": "own_reference_leakage"}
            | {"value": 2.0}
            for number in range(LAST + 1)
        ]
        trends["trends"] = frame(TRENDS, rows)
    fits = [fit(number, 1.4 if number <= known else None) for number in range(LAST + 1)]
    ring = [parameter(number, "K_piston_ring", 8e-13, 1e-14) for number in range(known + 1)]
    return history(fits, ring, trends=trends)


def row(motor: MotorHistory, standing: Standing | None = None) -> FleetRow:
    (found,) = fleet_rows([motor], {"M": "M"}, {}, {} if standing is None else {"M": standing})
    return found


@pytest.mark.parametrize(("known", "is_now"), [(LAST, True), (LAST - 7, True), (LAST - 8, False)])
def test_figures_without_a_recent_night_are_not_told_as_current(known: int, is_now: bool) -> None:
    found = row(motor_of(known))
    assert (found.leakage is not None) == is_now
    assert found.leakage_night == label(known)
    assert (found.gap_change, found.gap_path) == (
        (pytest.approx(100.0), "piston ring") if is_now else (None, "")
    )


@pytest.mark.parametrize("is_known", [True, False])
def test_where_trends_are_judged_they_say_whether_a_figure_holds(is_known: bool) -> None:
    standing = Standing(
        "alarm", "why", deviation_percent=9.0, leakage_is_known=is_known, leakage_night=label(35)
    )
    found = row(motor_of(35), standing)
    assert (found.leakage is not None) == is_known
    assert found.leakage_change == (9.0 if is_known else None)


def test_a_gap_that_was_known_before_the_change_alone_is_not_told() -> None:
    for began, told in ((35, pytest.approx(100.0)), (36, None)):
        standing = Standing("alarm", "why", change_start=label(began))
        assert row(motor_of(35), standing).gap_change == told


def test_the_motor_s_own_conditions_stand_in_where_the_fleet_s_are_no_longer_seen() -> None:
    standing = Standing("ok", "fine", "ok", 1.0, leakage_is_known=True, leakage_night=label(LAST))
    found = row(motor_of(5, own=True), standing)
    assert (found.leakage_kind, found.leakage_night) == ("frozen", label(LAST))
    assert found.leakage is not None
    assert found.leakage[0] == 2.0

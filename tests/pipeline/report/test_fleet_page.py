"""A motor's line on the fleet page: the state as `status` prints it, and pictures of its nights."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.report.fleet_page import FleetRow, fleet_rows
from pipeline.schema import BASELINES, TRENDS, frame
from pipeline.trends.motor_states import MotorState
from tests.pipeline.report.nights import FIRST, ONE_DAY, fit, history, unfitted

NIGHTS = 40
BASELINE = {"motor_id": "M", "night": FIRST + 29 * ONE_DAY, "start": FIRST}
OWN = {"motor_id": "M", "indicator": "own_reference_leakage", "value": 2.0}


def row(state: MotorState, known: int = NIGHTS) -> FleetRow:
    """Forty nights with the leakage at the motor's own conditions, and the reference of some."""
    means = {"reference_leakage": 1.4, "own_reference_leakage": 2.0}
    frozen = [BASELINE | {"indicator": name, "mean": mean} for name, mean in means.items()]
    trends = {
        "baselines": frame(BASELINES, frozen),
        "trends": frame(TRENDS, [OWN | {"night": FIRST + n * ONE_DAY} for n in range(NIGHTS)]),
    }
    fits = [fit(number, 1.4 if number < known else None) for number in range(NIGHTS)]
    (found,) = fleet_rows([history(fits, trends=trends)], {"M": "M"}, {}, {"M": state})
    return found


@pytest.mark.parametrize(
    ("indicator", "kind", "level"),
    [("reference_leakage", "reference", 1.4), ("own_reference_leakage", "frozen", 2.0)],
)
def test_the_course_is_of_the_leakage_of_the_state(indicator: str, kind: str, level: float) -> None:
    found = row(MotorState("M", "ok", leakage_indicator=indicator), known=5)
    assert found.leakage_kind == kind
    assert found.line is not None
    assert (found.line.smallest, found.line.largest) == (level, level)
    # The course lies on its baseline.
    assert f" {found.line.last[1]}H" in found.line.baseline


def test_without_a_figure_of_now_the_course_is_of_what_was_known() -> None:
    assert row(MotorState("M", "stale"), known=5).leakage_kind == "reference"
    assert row(MotorState("M", "stale"), known=0).leakage_kind == "frozen"


def test_the_order_is_that_of_status() -> None:
    states = {
        "A": MotorState("A", "ok", deviation_percent=3.0),
        "B": MotorState("B", "alarm", deviation_percent=30.0),
        "C": MotorState("C", "alarm", deviation_percent=40.0),
        "D": MotorState("D", "insufficient"),
        "E": MotorState("E", "ok", failure="night of 2026-01-01 failed: the log is cut"),
        "F": MotorState("F", "common_cause"),
    }
    motors = [history([], motor_id=motor_id) for motor_id in states]
    found = fleet_rows(motors, {name: name for name in states}, {}, states)
    assert [one.state.motor_id for one in found] == ["C", "B", "F", "E", "D", "A"]


def test_recent_nights_are_counted_by_outcome() -> None:
    fits: list[dict[str, Any]] = [fit(0), unfitted(1, "failed", "x"), fit(3)]
    (found,) = fleet_rows([history(fits)], {"M": "M"}, {}, {"M": MotorState("M", "ok")})
    assert (found.n_recent, found.n_recent_good) == (3, 2)
    assert found.strip_words == "2 fitted, 1 failed"

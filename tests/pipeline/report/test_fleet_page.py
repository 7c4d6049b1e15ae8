"""A motor's line on the fleet page: the state as `status` prints it, and pictures of its nights."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest

from pipeline.report.fleet_page import FleetRow, fleet_rows
from pipeline.report.pages import FleetFacts, fleet_html
from pipeline.trends.rows.motor_states import MotorState
from tests.pipeline.report.nights import FIRST, fit, history, trend, unfitted

NIGHTS = 40


def row(state: MotorState, known: int = NIGHTS) -> FleetRow:
    """Forty nights with the leakage at the motor's own conditions, and the reference of some."""
    means = {"reference_leakage": 1.4, "own_reference_leakage": 2.0}
    trends = [
        trend(n, name, mean, baseline_mean=mean)
        for name, mean in means.items()
        for n in range(known if name == "reference_leakage" else NIGHTS)
    ]
    (found,) = fleet_rows(
        [history([fit(n, None) for n in range(NIGHTS)], trends)], {"M": "M"}, {}, {"M": state}
    )
    return found


@pytest.mark.parametrize(
    ("indicator", "kind", "level"),
    [("reference_leakage", "reference", 1.4), ("own_reference_leakage", "frozen", 2.0)],
)
def test_the_course_is_of_the_leakage_of_the_state(indicator: str, kind: str, level: float) -> None:
    found = row(MotorState("M", "ok", leakage_indicator=indicator), known=5)
    assert found.leakage_kind == kind
    assert (found.line.smallest, found.line.largest) == (level, level)
    # The course lies on its baseline.
    assert f" {found.line.last[1]}H" in found.line.baseline


def test_without_a_figure_of_now_the_course_is_of_what_was_known() -> None:
    """No figure of before stands in for one of now: the state says since when it is not known."""
    assert row(MotorState("M", "stale"), known=5).leakage_kind == "reference"
    assert row(MotorState("M", "stale"), known=0).leakage_kind == "frozen"
    assert row(MotorState("M", "stale", leakage_night=FIRST), known=5).drawn_now is None


def test_the_order_is_that_of_status() -> None:
    alarms = [MotorState(name, "alarm", deviation_percent=d) for name, d in (("B", 30), ("C", 40))]
    calm = [MotorState("D", "insufficient"), MotorState("F", "common_cause")]
    failed = MotorState("E", "ok", failure="night of 2026-01-01 failed: the log is cut")
    ok = MotorState("A", "ok", deviation_percent=3.0)
    states = {one.motor_id: one for one in (ok, *alarms, *calm, failed)}
    motors = [history([], motor_id=motor_id) for motor_id in states]
    found = fleet_rows(motors, {name: name for name in states}, {}, states)
    assert [one.state.motor_id for one in found] == ["C", "B", "F", "E", "D", "A"]


def test_recent_nights_are_counted_by_outcome() -> None:
    fits: list[dict[str, Any]] = [fit(0), unfitted(1, "failed", "x"), fit(3)]
    (found,) = fleet_rows([history(fits)], {"M": "M"}, {}, {"M": MotorState("M", "ok")})
    assert (found.n_recent, found.n_recent_good) == (3, 2)
    assert found.strip_words == "2 fitted, 1 failed"


@pytest.mark.parametrize(
    ("trends", "kind", "value"),
    [((trend(0, "comparable_drain_flow", 4.4),), "comparable", 4.4), ((), "flow", 5.0)],
)
def test_a_young_motor_shows_the_flow_that_it_has(
    trends: tuple[dict[str, Any], ...], kind: str, value: float
) -> None:
    motor = history([fit(0, None, mean_flow_l_per_min=5.0)], trends)
    (found,) = fleet_rows([motor], {"M": "M"}, {}, {"M": MotorState("M", "insufficient")})
    assert (found.leakage_kind, found.drawn_now) == (kind, value)


def test_the_age_of_data_counts_from_their_end() -> None:
    ends = [dt.datetime(2026, 1, day, 5, tzinfo=dt.UTC) for day in (1, 2)]
    fits = [fit(n, window_end=end) for n, end in enumerate(ends)]
    fits.append(unfitted(2, "no_new_data", "no log"))
    (found,) = fleet_rows([history(fits)], {"M": "M"}, {}, {"M": MotorState("M", "ok")})
    assert found.newest_data == ends[1]


def test_undelivered_alarms_and_a_model_that_is_rejected_are_shown() -> None:
    waiting = "not delivered to hook: 2 changes of state"
    facts = FleetFacts("F", None, None, undelivered=(waiting,))
    misfit = MotorState("M", "ok", model_misfit="the model misses 2 %")
    html = fleet_html(facts, [row(misfit)])
    assert f"N{waiting[1:]}." in html
    assert '<b class="poor" title="the model misses 2 %">model rejected</b>' in html
    assert "poor</b>" not in html

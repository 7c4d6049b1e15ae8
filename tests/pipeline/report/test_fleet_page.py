"""A motor's line on the fleet page: the state as `status` prints it, and pictures of its nights."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from typing import Any

import pytest

from pipeline.report.fleet_page import fleet_rows
from pipeline.report.pages import FleetFacts, fleet_html
from tests.pipeline.report.nights import baseline, fit, history, unfitted, watch
from tests.pipeline.report.states import state_of


def test_the_course_is_that_of_the_leakage_and_lies_on_its_baseline() -> None:
    nights = range(40)
    watches = [watch(n, 2.0) for n in nights]
    motor = history([fit(n) for n in nights], watches, baselines=[baseline(2.0)])
    (found,) = fleet_rows([motor], {"M": "M"}, {}, {"M": state_of("M")})
    assert (found.line.smallest, found.line.largest, found.is_flow) == (2.0, 2.0, False)
    assert f" {found.line.last[1]}H" in found.line.baseline


@pytest.mark.parametrize("watches", [[], [watch(0, None)]])
def test_a_young_motor_shows_the_flow_that_it_has(watches: list[Any]) -> None:
    motor = history([fit(0)], watches)
    (found,) = fleet_rows([motor], {"M": "M"}, {}, {"M": state_of("M", "insufficient")})
    assert (found.is_flow, found.line.largest, found.flow_now) == (True, 5.0, 5.0)


def test_what_needs_attention_comes_first_and_a_failed_night_no_later_than_stale() -> None:
    failed = state_of("E", failure="night of 2026-01-01 failed: the log is cut")
    others = [state_of("D", "insufficient"), state_of("F", "common_cause"), state_of("A")]
    states = {one.motor_id: one for one in (*others, failed, state_of("C", "alarm"))}
    motors = [history([], motor_id=motor_id) for motor_id in states]
    found = fleet_rows(motors, {name: name for name in states}, {}, states)
    assert [one.state.motor_id for one in found] == ["C", "F", "E", "D", "A"]


def test_recent_nights_are_counted_by_outcome() -> None:
    fits: list[dict[str, Any]] = [fit(0), unfitted(1, "failed", "x"), fit(3)]
    (found,) = fleet_rows([history(fits)], {"M": "M"}, {}, {"M": state_of("M")})
    assert (found.n_recent, found.n_recent_good) == (3, 2)
    assert found.strip_words == "2 fitted, 1 failed"


def test_the_age_of_data_counts_from_their_end() -> None:
    ends = [dt.datetime(2026, 1, day, 5, tzinfo=dt.UTC) for day in (1, 2)]
    fits = [fit(n, window_end=end) for n, end in enumerate(ends)]
    fits.append(unfitted(2, "no_new_data", "no log"))
    (found,) = fleet_rows([history(fits)], {"M": "M"}, {}, {"M": state_of("M")})
    assert found.newest_data == ends[1]


def test_change_leakage_and_lack_of_fit_stand_in_a_line_with_their_intervals() -> None:
    rows = fleet_rows(
        [history([fit(0)], [watch(0, 2.42)])], {"M": "M"}, {}, {"M": state_of("M", "alarm")}
    )
    html = fleet_html(FleetFacts("F", None, None), rows)
    for words in (
        "+21.0<small>+17.0 to +25.0</small>",
        "2.420</span><small>2.340 to 2.500</small>",
        "Leakage +21 % [17, 25] tonight, since 4 January 2026 [3, 5]: balance sleeve. "
        "<b>Look at the balance sleeve at the next stop.</b>",
        "0.40</td>",
    ):
        assert words in html
    assert "poor" not in html


def test_undelivered_alarms_and_a_model_that_is_disproved_are_shown() -> None:
    waiting = "not delivered to hook: 2 changes of state"
    facts = FleetFacts("F", None, None, undelivered=(waiting,))
    state = state_of("M")
    assert state.watch is not None
    foreign = replace(state.watch, lack_of_fit=0.12, model_verdict="disproved")
    rows = fleet_rows([history([fit(0)])], {"M": "M"}, {}, {"M": replace(state, watch=foreign)})
    html = fleet_html(facts, rows)
    assert f"N{waiting[1:]}." in html
    assert '12 <b class="poor">disproved</b>' in html

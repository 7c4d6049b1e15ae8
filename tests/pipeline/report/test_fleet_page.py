"""A motor's line on the fleet page: the state as `status` prints it, and pictures of its nights."""

from __future__ import annotations

import datetime as dt

from pipeline.report.build import newest_changes
from pipeline.report.fleet_page import fleet_rows
from pipeline.schema import ALARMS, frame
from tests.pipeline.report.nights import fit, fleet_page, history, unfitted, watch
from tests.pipeline.report.states import state_of

TYPES = {"M": "CB560"}


def test_the_course_is_that_of_the_leakage_alone() -> None:
    motor = history([fit(0), fit(1)], [watch(n, 2.0) for n in range(2)])
    (found,) = fleet_rows([motor], TYPES, {"M": state_of("M")})
    assert "Leakage 2.00 to 2.00 l/min" in found.line
    # The drain flow as measured, which moves with the load, stands nowhere in its place.
    young = {"M": state_of("M", "insufficient")}
    (found,) = fleet_rows([history([fit(0)])], TYPES, young)
    assert found.line == ""


def test_what_needs_attention_comes_first_and_a_failed_night_no_later_than_stale() -> None:
    failed = state_of("E", failure="night of 2026-01-01 failed: the log is cut")
    others = [state_of("D", "insufficient"), state_of("F", "common_cause"), state_of("A")]
    states = {one.motor_id: one for one in (*others, failed, state_of("C", "alarm"))}
    motors = [history([], motor_id=motor_id) for motor_id in states]
    found = fleet_rows(motors, dict.fromkeys(states, "CB560"), states)
    assert [one.state.motor_id for one in found] == ["C", "F", "E", "D", "A"]


def test_the_age_of_data_counts_from_their_end() -> None:
    ends = [dt.datetime(2026, 1, day, 5, tzinfo=dt.UTC) for day in (1, 2)]
    fits = [fit(n, window_end=end) for n, end in enumerate(ends)]
    fits.append(unfitted(2, "no_new_data", "no log"))
    (found,) = fleet_rows([history(fits)], TYPES, {"M": state_of("M")})
    assert found.newest_data == ends[1]
    assert (found.n_recent, found.n_recent_good) == (3, 2)
    (found,) = fleet_rows([history([fit(n) for n in range(40)])], TYPES, {"M": state_of("M")})
    assert found.n_recent == 30


def test_the_newest_changes_of_state_come_first() -> None:
    def at(day: int, indicator: str = "leakage") -> dict[str, object]:
        time = dt.datetime(2026, 1, 1, tzinfo=dt.UTC) + dt.timedelta(days=day)
        return {"motor_id": "M", "night": time.date(), "indicator": indicator, "time": time}

    rows = [at(0), at(9, "pressure_zero"), at(9, "flow_zero"), *(at(day) for day in range(10, 300))]
    found = newest_changes(frame(ALARMS, rows[:4]))
    assert [one["indicator"] for one in found] == [
        "leakage",
        "flow_zero",
        "pressure_zero",
        "leakage",
    ]
    assert len(newest_changes(frame(ALARMS, rows))) == 200


def test_change_and_leakage_stand_with_their_intervals_and_conditions() -> None:
    state = state_of("M", "alarm")
    rows = fleet_rows([history([fit(0)], [watch(0, 2.42)])], TYPES, {"M": state})
    html = fleet_page(rows)
    for words in (
        '+21.0</span> <span class="interval">[+17.0, +25.0]</span>',
        '2.42</span> <span class="interval">[2.34, 2.50]</span>',
        "<small>150 bar, 48.0 °C, 26.0 rpm</small>",
        "Leakage +21 % [17, 25] tonight, since 4 January 2026 [3, 5]: balance sleeve. "
        "<b>Look at the balance sleeve at the next stop.</b>",
    ):
        assert words in html


def test_undelivered_alarms_are_shown() -> None:
    waiting = "not delivered to hook: 2 changes of state"
    html = fleet_page([], (waiting,))
    assert f"N{waiting[1:]}." in html

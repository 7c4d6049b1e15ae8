"""Changes of state: each has a row, and what was raised is never deleted."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest

from pipeline.trends.figures.indicators import REFERENCE
from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.states.standing import Standing
from tests.pipeline.trends.nights import Nights, motor, night_of, standing, step

N, AT = 100, 70
Rows = list[dict[str, Any]]
WORN = {"balance_sleeve": step(N, AT, 0.4)}


def of(rows: Rows, name: str = "K_balance_sleeve") -> Rows:
    return [row for row in rows if row["indicator"] == name]


@pytest.fixture(scope="module")
def worn() -> Standing:
    return standing(Nights(motor(), N, WORN))


@pytest.fixture(scope="module")
def healthy() -> Standing:
    return standing(Nights(motor(), N))


def test_every_change_has_one_row_that_joins_the_one_before(worn: Standing) -> None:
    rows = alarm_rows(worn, range(N))
    for name, states in worn.states.items():
        told = "insufficient"
        for row in of(rows, name):
            assert (row["from_state"], row["to_state"]) == (
                told,
                states[worn.history.place_from(row["night"])],
            )
            told = row["to_state"]
        assert told == states[-1]
        changes = sum(a != b for a, b in zip(("insufficient", *states), states, strict=False))
        assert len(of(rows, name)) == changes


def test_a_step_of_40_percent_is_told_on_its_first_night(worn: Standing) -> None:
    raised = of(alarm_rows(worn, range(N)))[1]
    assert raised["night"] == night_of(AT)
    assert raised["to_state"] == "alarm"
    assert raised["way"] == "sudden"
    assert raised["deviation_percent"] == pytest.approx(40.0, abs=6.0)
    # The time is the end of the night, 06:00 UTC here, never the clock.
    assert raised["time"] == dt.datetime.combine(raised["night"], dt.time(6), dt.UTC)


def test_made_again_they_are_the_same(worn: Standing) -> None:
    rows = alarm_rows(worn, range(N))
    assert alarm_rows(worn, range(N), rows) == rows
    late = [row for row in rows if row["night"] >= night_of(72)]
    assert alarm_rows(worn, range(72, N), rows) == late


def test_what_late_data_take_back_stays_and_is_closed(worn: Standing, healthy: Standing) -> None:
    before = alarm_rows(worn, range(N))
    after = of(alarm_rows(healthy, range(N), before))
    kept = [row for row in of(before) if row["to_state"] in ("warning", "alarm")]
    assert kept
    assert all(row in after for row in kept)
    closing = after[-1]
    assert (closing["to_state"], closing["way"]) == ("ok", "recomputed")
    assert closing["night"] == kept[-1]["night"] + dt.timedelta(days=1)
    assert closing["reason"] == (
        f"recomputed: what was raised on {kept[-1]['night']} is not in the figures as they are now"
    )
    # Once more with that: nothing changes.
    again = of(alarm_rows(healthy, range(N), [*before, *after]))
    assert again == after


def test_an_alarm_that_comes_out_otherwise_says_what_it_was(
    worn: Standing, healthy: Standing
) -> None:
    before = of(alarm_rows(worn, range(N)))
    night = before[-1]["night"]
    milder = standing(Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.22)}))
    after = of(alarm_rows(milder, range(N), before))
    row = next(row for row in after if row["night"] == night)
    if row["to_state"] != before[-1]["to_state"]:
        assert "; before its data changed: balance sleeve gap" in row["reason"]
    assert after[-1]["to_state"] == milder.states["K_balance_sleeve"][-1]


def test_an_indicator_that_is_no_longer_watched_is_closed(healthy: Standing) -> None:
    gone = {
        "motor_id": "M1",
        "night": night_of(50),
        "time": dt.datetime(2026, 2, 21, 6, tzinfo=dt.UTC),
        "indicator": "K_ring_of_another_type",
        "from_state": "ok",
        "to_state": "alarm",
        "reason": "it was high",
        "deviation_percent": 40.0,
        "way": "level",
        "path": None,
    }
    (row,) = of(alarm_rows(healthy, [N - 1], [gone]), "K_ring_of_another_type")
    assert (row["from_state"], row["to_state"], row["way"]) == (
        "alarm",
        "insufficient",
        "recomputed",
    )


def test_a_healthy_motor_has_only_its_baselines_taken(healthy: Standing) -> None:
    rows = alarm_rows(healthy, range(N))
    assert {(row["to_state"], row["reason"]) for row in rows} == {("ok", "a baseline was taken")}
    assert {row["night"] for row in of(rows, REFERENCE)} == {night_of(15)}

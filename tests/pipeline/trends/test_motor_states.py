"""The table `latest`: what `status` prints, and an output without it."""

from __future__ import annotations

import datetime as dt
from dataclasses import fields, replace
from pathlib import Path

import pytest

from pipeline.schema import ALARMS, LATEST, WATCH, frame
from pipeline.store.tables import whole_file
from pipeline.trends.nights.decisions import Decision, record_decision
from pipeline.trends.rows.motor_states import (
    MotorState,
    latest_rows,
    latest_states,
    published_states,
)
from pipeline.trends.rows.watch_rows import WatchRow
from tests.pipeline.report.states import LAST, output, watched
from tests.pipeline.report.states import publish as publish_rows
from tests.pipeline.trends.nights import night_of
from tests.pipeline.written import publisher_of

__all__ = ["output"]


def publish(output: Path, states: list[MotorState]) -> None:
    rows = frame(LATEST, latest_rows(states, "r"))
    with publisher_of(output) as publisher:
        publisher.whole(LATEST, rows)


def test_every_column_of_the_watch_is_one_of_latest() -> None:
    """Whatever a page says stands in a column (issue 36)."""
    names = {one.name for one in fields(WatchRow)} - {"night"}
    assert names <= set(LATEST.schema)
    assert set(WATCH.schema) == {one.name for one in fields(WatchRow)} | {"run_id"}


def test_a_state_comes_back_as_it_was_published(output: Path) -> None:
    (made,) = latest_states(output, ["M1"])
    assert (made.state, made.path, made.state_since) == ("alarm", "balance_sleeve", night_of(4))
    assert (made.data_night, made.data_age_nights) == (night_of(LAST), 0)
    publish(output, [made])
    (found,) = published_states(output, ["M1"])
    assert found == replace(made, data_age_nights=0)


def test_columns_of_before_say_the_same(output: Path) -> None:
    (state,) = latest_states(output, ["M1"])
    gap = {"gap_growth": 0.12, "gap_growth_lower": 0.1, "gap_growth_upper": 0.14}
    (row,) = latest_rows([replace(state, watch=replace(state.watch, **gap))], "r")
    assert row["deviation_percent"] == pytest.approx(21.0)
    assert (row["indicator"], row["path"]) == ("leakage", "balance_sleeve")
    assert (row["leakage_l_per_min"], row["leakage_indicator"]) == (2.42, "own_reference_leakage")
    assert (row["change_start"], row["known_since"]) == (night_of(2), night_of(3))
    assert (row["gap_path"], row["gap_change_percent"]) == ("balance_sleeve", pytest.approx(12.0))
    assert row["gap_change_upper"] == pytest.approx(14.0)


@pytest.mark.parametrize(("state", "since"), [("ok", None), ("stale", 4)])
def test_a_state_begins_where_it_was_told(output: Path, state: str, since: int | None) -> None:
    alarm = {"motor_id": "M1", "indicator": "leakage", "to_state": state, "from_state": "alarm"}
    publish_rows(output, ALARMS, [alarm | {"night": night_of(4), "reason": "so"}])
    publish_rows(output, WATCH, [watched("M1", LAST, state).row])
    (found,) = latest_states(output, ["M1"])
    assert found.state_since == (None if since is None else night_of(since))


def test_what_was_said_since_the_run_counts(output: Path) -> None:
    publish(output, latest_states(output, ["M1"]))
    when = dt.datetime(2026, 1, 8, tzinfo=dt.UTC)
    said = Decision("M1", "K_piston_ring", when, "acknowledged", night_of(3), None, "too early")
    record_decision(output, said)
    assert published_states(output, ["M1"])[0].acknowledged == ""
    record_decision(output, replace(said, night=night_of(4), note="rings ordered"))
    assert published_states(output, ["M1"])[0].acknowledged == "rings ordered"


@pytest.mark.parametrize("damage", ["absent", "damaged"])
def test_an_output_without_the_table_is_read_as_the_run_would(output: Path, damage: str) -> None:
    expected = latest_states(output, ["M1"])
    if damage == "damaged":
        publish(output, [replace(expected[0], state="ok")])
        whole_file(output, LATEST).write_bytes(b"junk")
    else:
        whole_file(output, LATEST).unlink()
    assert published_states(output, ["M1"]) == expected

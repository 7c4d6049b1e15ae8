"""The table `latest`: what `status` prints, and an output without it."""

from __future__ import annotations

import datetime as dt
from dataclasses import fields, replace
from pathlib import Path

import pytest

from pipeline.schema import LATEST, frame
from pipeline.store.publishing import Publisher
from pipeline.store.tables import whole_file
from pipeline.trends.nights.decisions import Decision, record_decision
from pipeline.trends.rows.latest_states import latest_states, published_states
from pipeline.trends.rows.motor_states import MotorState, latest_rows
from tests.pipeline.report.states import LAST, output
from tests.pipeline.trends.nights import night_of

__all__ = ["output"]


def publish(output: Path, states: list[MotorState]) -> None:
    rows = frame(LATEST, latest_rows(states, "r"))
    Publisher(output, output / "staging", "r").whole(LATEST, rows)


def test_the_table_has_a_column_for_each_part_of_a_state() -> None:
    names = {one.name for one in fields(MotorState)}
    # Looks go on between the runs.
    assert set(LATEST.schema) == {*names - {"look"}, "sentence", "run_id"}


def test_a_state_comes_back_as_it_was_published(output: Path) -> None:
    (made,) = latest_states(output, ["M1"])
    assert (made.state, made.indicator, made.state_since) == ("alarm", "K_piston_ring", night_of(4))
    assert (made.data_night, made.data_age_nights) == (night_of(LAST), 0)
    publish(output, [made])
    assert published_states(output, ["M1"]) == [made]


def test_status_prints_the_table_and_not_the_trends(output: Path) -> None:
    (made,) = latest_states(output, ["M1"])
    publish(output, [replace(made, reason="as of the run")])
    (found,) = published_states(output, ["M1"])
    assert found.why == "as of the run"


def test_what_was_said_since_the_run_counts(output: Path) -> None:
    publish(output, latest_states(output, ["M1"]))
    when = dt.datetime(2026, 1, 8, tzinfo=dt.UTC)
    said = Decision("M1", "K_piston_ring", when, "acknowledged", night_of(3), None, "too early")
    record_decision(output, said)
    assert published_states(output, ["M1"])[0].acknowledged == ""
    record_decision(output, replace(said, night=night_of(4), note="rings ordered"))
    assert published_states(output, ["M1"])[0].acknowledged == "rings ordered"


def test_a_motor_that_is_new_in_the_config(output: Path) -> None:
    publish(output, latest_states(output, ["M1"]))
    assert published_states(output, ["M9"])[0].why == "no night yet"


@pytest.mark.parametrize("damage", ["absent", "damaged"])
def test_an_output_without_the_table_is_read_as_the_run_would(output: Path, damage: str) -> None:
    expected = latest_states(output, ["M1"])
    if damage == "damaged":
        publish(output, [replace(expected[0], state="ok")])
        whole_file(output, LATEST).write_bytes(b"junk")
    assert published_states(output, ["M1"]) == expected

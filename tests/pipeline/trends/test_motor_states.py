"""The table `latest`: what `status` prints, and an output without it."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.schema import LATEST, NIGHTS
from pipeline.store.tables import whole_file
from pipeline.trends.nights.decisions import Decision, record_decision
from pipeline.trends.rows.motor_states import MotorState, latest_rows, published_states
from tests.pipeline.report.states import LAST, night_row, output, publish, publish_latest
from tests.pipeline.trends.nights import night_of

__all__ = ["output"]


def test_a_state_comes_back_as_it_was_published(output: Path) -> None:
    (made,) = latest_rows(output, ["M1"])
    assert (made["state"], made["cause"], made["state_since"]) == (
        "alarm",
        "balance_sleeve",
        night_of(4),
    )
    assert (made["night"], made["data_age_nights"]) == (night_of(LAST), 0)
    publish_latest(output, [MotorState(made)])
    (found,) = published_states(output, ["M1"])
    assert dict(found.row) == {name: made[name] for name in made if name != "run_id"}


def test_figures_are_those_of_the_newest_night_with_samples(output: Path) -> None:
    stale = {
        "motor_id": "M1",
        "night": night_of(LAST + 9),
        "status": "no_new_data",
        "reason": "no log covers this night",
        "state": "stale",
        "sentence": "nothing is known",
        "advice": "Check whether the motor's logs arrive.",
    }
    publish(output, NIGHTS, [night_row("M1", LAST, "alarm"), stale])
    (row,) = latest_rows(output, ["M1"])
    assert (row["night"], row["state"], row["status"]) == (
        night_of(LAST + 9),
        "stale",
        "no_new_data",
    )
    assert row["own_leakage_l_per_min"] == 2.42
    assert row["last_fit_night"] == night_of(LAST)


def test_what_was_said_since_the_run_counts(output: Path) -> None:
    publish_latest(output, [MotorState(row) for row in latest_rows(output, ["M1"])])
    when = dt.datetime(2026, 1, 8, tzinfo=dt.UTC)
    said = Decision("M1", "leakage", when, "acknowledged", night_of(3), None, "too early")
    record_decision(output, said)
    assert published_states(output, ["M1"])[0].row["acknowledged"] is None
    record_decision(output, replace(said, night=night_of(4), note="rings ordered"))
    assert published_states(output, ["M1"])[0].row["acknowledged"] == "rings ordered"


@pytest.mark.parametrize("damage", ["absent", "damaged"])
def test_an_output_without_the_table_is_read_as_the_run_would(output: Path, damage: str) -> None:
    expected = [MotorState(row) for row in latest_rows(output, ["M1"])]
    if damage == "damaged":
        whole_file(output, LATEST).write_bytes(b"junk")
    else:
        whole_file(output, LATEST).unlink()
    assert published_states(output, ["M1"]) == expected

"""What people said: kept across runs and faults, and nothing lost."""

from __future__ import annotations

import datetime as dt
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store.state import STATE_FILE
from pipeline.trends.nights.decisions import Decision, read_decisions, record_decision

SAID = Decision(
    "M1",
    "K_piston_ring",
    dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC),
    "finding",
    dt.date(2026, 2, 17),
    "confirmed",
    'rings worn; "really", said µ—Å\n2nd line',
)


def test_the_oldest_is_first_whoever_wrote_it(tmp_path: Path) -> None:
    later = replace(SAID, time=SAID.time + dt.timedelta(hours=1), kind="acknowledged", finding=None)
    record_decision(tmp_path, later)
    record_decision(tmp_path, SAID)
    assert read_decisions(tmp_path) == (SAID, later)


def test_where_nothing_was_said_nothing_is_made(tmp_path: Path) -> None:
    assert read_decisions(tmp_path) == ()
    assert list(tmp_path.iterdir()) == []


def test_many_may_write_at_once(tmp_path: Path) -> None:
    said = [replace(SAID, motor_id=f"M{number}", note="x" * 500) for number in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda one: record_decision(tmp_path, one), said))
    assert {decision.motor_id for decision in read_decisions(tmp_path)} == {
        one.motor_id for one in said
    }


@pytest.mark.parametrize("harm", [Path.mkdir, lambda path: path.write_bytes(b"no database" * 99)])
def test_where_it_cannot_be_written_it_is_said(tmp_path: Path, harm: object) -> None:
    harm(tmp_path / STATE_FILE)  # type: ignore[operator]
    with pytest.raises(StoreError, match="cannot be written"):
        record_decision(tmp_path, SAID)
    with pytest.raises(StoreError, match="cannot be read"):
        read_decisions(tmp_path)

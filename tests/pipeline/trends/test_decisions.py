"""What people said: kept across runs and faults, and nothing lost."""

from __future__ import annotations

import datetime as dt
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.store.state import STATE_FILE
from pipeline.trends.decisions import Decision, read_decisions, record_decision
from tests.pipeline.calling import refused

WHEN = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
NOTE = 'rings worn; "really", said µ—Å\n2nd line'
SAID = Decision(
    "M1", "K_piston_ring", WHEN, "finding", dt.date(2026, 2, 17), "confirmed", NOTE, "piston_ring"
)


def test_the_oldest_is_first_however_many_write_at_once(tmp_path: Path) -> None:
    assert read_decisions(tmp_path) == ()
    assert list(tmp_path.iterdir()) == []  # where nothing was said nothing is made
    decisions = [
        replace(SAID, motor_id=f"M{number}", time=WHEN + dt.timedelta(hours=-number))
        for number in range(40)
    ]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda decision: record_decision(tmp_path, decision), decisions))
    assert read_decisions(tmp_path) == tuple(reversed(decisions))


@pytest.mark.parametrize("harm", [Path.mkdir, lambda path: path.write_bytes(b"no database" * 99)])
def test_where_it_cannot_be_written_it_is_said(tmp_path: Path, harm: object) -> None:
    harm(tmp_path / STATE_FILE)  # type: ignore[operator]
    with refused("store_write", "cannot be written"):
        record_decision(tmp_path, SAID)
    with refused("store_read", "cannot be read"):
        read_decisions(tmp_path)

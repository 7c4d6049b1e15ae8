"""Rows of `intraday`: changes of state of the intraday check, and what they say of a motor."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.clock import utc
from pipeline.schema import INTRADAY, Row
from pipeline.store.publishing import Publisher
from pipeline.store.state import StateDatabase
from pipeline.store.tables import read_rows
from pipeline.trends.motor_states import CLEAR, RISEN, IntradayStatus

if TYPE_CHECKING:
    from leakage.watch import Estimate

CONFIRMED, WITHDRAWN = "confirmed", "withdrawn"
# Said of a motor by a check, and no row.
NOT_JUDGED = "not_judged"


def row_of(
    motor_id: str,
    time_us: int,
    states: tuple[str, str],
    reason: str,
    change: Estimate | None = None,
    night: dt.date | None = None,
) -> Row:
    """Return a change of state."""
    row: Row = {"motor_id": motor_id, "time": utc(time_us), "reason": reason, "confirmed_by": night}
    row |= dict(zip(("from_state", "to_state"), states, strict=True))
    if change is not None:
        ends = (change.value, change.lower, change.upper)
        names = ("change_percent", "change_lower", "change_upper")
        row |= {name: 100.0 * end for name, end in zip(names, ends, strict=True)}
    return row


def last_rows(output: Path, motor_ids: Sequence[str]) -> dict[str, Row]:
    """Return the last row of each motor with any; raises StoreError if the table is damaged."""
    rows = read_rows(output, INTRADAY, motor_ids).sort("time").iter_rows(named=True)
    return {row["motor_id"]: row for row in rows}


def open_rises(output: Path, motor_ids: Sequence[str]) -> dict[str, Row]:
    """Return the rows of rises that no night has settled, by motor."""
    last = last_rows(output, motor_ids)
    return {motor_id: row for motor_id, row in last.items() if row["to_state"] == RISEN}


def publish_rows(state: StateDatabase, rows: Iterable[Row], run_id: str) -> None:
    """Add rows to the table; raises StoreError if they cannot be published."""
    by_month: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_month[f"{row['time']:%Y-%m}"].append(row | {"run_id": run_id})
    for month, some in by_month.items():
        Publisher(state, state.output, run_id).add(month, {INTRADAY: some})


def intraday_statuses(output: Path, motor_ids: Sequence[str]) -> dict[str, IntradayStatus]:
    """Return what the table says of some motors, by motor; raises StoreError if it is damaged."""
    states: dict[str, IntradayStatus] = {}
    for row in read_rows(output, INTRADAY, motor_ids).sort("time").iter_rows(named=True):
        before, to_state = states.get(row["motor_id"]), row["to_state"]
        counts = {
            name: (0 if before is None else getattr(before, name)) + (to_state == name)
            for name in (RISEN, CONFIRMED, WITHDRAWN)
        }
        state = RISEN if to_state in (RISEN, CONFIRMED) else CLEAR
        states[row["motor_id"]] = IntradayStatus(state, row["time"], row["reason"], **counts)
    return states

"""Decisions of people on a motor: acknowledged alarms, findings, and baselines that were reset.

They stand in the state file and in the table `decisions`, and come back from either: unlike all
else in the output they cannot be made anew.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Literal

from pipeline.errors import LockedError, StoreError
from pipeline.messages import counted
from pipeline.schema import DECISIONS, frame
from pipeline.store.atomic_files import locked
from pipeline.store.publishing import Publisher
from pipeline.store.state import StateDatabase, open_state, read_state_file
from pipeline.store.tables import read_table, whole_file

log = logging.getLogger(__name__)

Kind = Literal["acknowledged", "finding", "baseline_reset", "removed", "excluded", "released"]
Finding = Literal["confirmed", "not_confirmed"]

# What alarms, decisions and baselines are of.
LEAKAGE = "leakage"
PRESSURE_ZERO, FLOW_ZERO = SENSORS = ("pressure_zero", "flow_zero")


@dataclass(frozen=True, slots=True)
class Decision:
    """A decision."""

    # motor_id, indicator: an empty indicator means all of the motor's.
    motor_id: str
    indicator: str
    time: dt.datetime  # of the decision, UTC
    # An alarm acknowledged, the finding of an inspection, a baseline reset, a motor that is gone; a
    # failed night accepted as excluded, or released for fitting though its columns look changed.
    kind: Kind
    # The night that it refers to: of a reset the first night of the new baseline, of a finding on
    # parts the day on which the motor was opened.
    night: dt.date
    finding: Finding | None = None  # result of an inspection; None without any
    note: str = ""  # in words
    # worn, sound: parts that an inspection found so, separated by commas; None without any.
    worn: str | None = None
    sound: str | None = None


def is_withdrawn(decisions: Iterable[Decision], raised: dt.date) -> bool:
    """Return True where an inspection has not confirmed what was raised on a night."""
    return any(
        decision.finding == "not_confirmed" and decision.night >= raised for decision in decisions
    )


def record_decision(output: Path, decision: Decision) -> None:
    """Write a decision, which is then on the disk; a run that is under way publishes it."""
    with open_state(output) as state:
        _write(state, [decision])
        with suppress(LockedError), locked(output):
            publish_decisions(state, "")


def read_decisions(output: Path) -> tuple[Decision, ...]:
    """Return all decisions, the oldest first."""
    with read_state_file(output) as state:
        return _read(state)


def restore_decisions(state: StateDatabase) -> None:
    """Put back what the table has and a lost or older state file lacks.

    Raises StoreError if the state cannot be read or written.
    """
    path = whole_file(state.output, DECISIONS)
    try:
        rows = read_table(path, DECISIONS).drop("run_id").to_dicts() if path.exists() else []
    except StoreError as error:
        log.warning("%s; what people said is not put back from it", error)
        return
    present = set(_read(state))
    lost = [decision for row in rows if (decision := Decision(**row)) not in present]
    if lost:
        _write(state, lost)
        log.warning("put back from the table `decisions`: %s", counted(len(lost), "decision"))


def publish_decisions(state: StateDatabase, run_id: str) -> None:
    """Publish the table `decisions`, of what it has and what the state file has.

    Raises StoreError if it cannot be written.
    """
    restore_decisions(state)
    rows = [asdict(decision) | {"run_id": run_id} for decision in _read(state)]
    table = frame(DECISIONS, rows).sort(DECISIONS.key)
    Publisher(state, state.output, run_id).whole(DECISIONS, table)


def _write(state: StateDatabase, decisions: Iterable[Decision]) -> None:
    state.write_all(
        "INSERT INTO decisions VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        [
            tuple(
                value.isoformat() if isinstance(value, dt.date) else value
                for value in astuple(decision)
            )
            for decision in decisions
        ],
    )


def _read(state: StateDatabase) -> tuple[Decision, ...]:
    columns = ", ".join(Decision.__slots__)
    decisions = (
        Decision(
            motor, of, dt.datetime.fromisoformat(time), kind, dt.date.fromisoformat(night), *more
        )
        for motor, of, time, kind, night, *more in state.rows(f"SELECT {columns} FROM decisions")
    )
    return tuple(
        sorted(
            decisions, key=lambda decision: (decision.time, decision.motor_id, decision.indicator)
        )
    )

"""Decisions of people on a motor: acknowledged alarms, findings, and baselines that were reset.

They stand in the state file, and each run publishes them as the table `decisions`: unlike all else
in the output they cannot be made anew.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Literal

from pipeline.store.state import State, open_state, read_state_file

Kind = Literal["acknowledged", "finding", "baseline_reset"]
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
    kind: Kind  # an alarm acknowledged, the finding of an inspection, or a baseline reset
    # The night that it refers to: of a reset the first night of the new baseline, of a finding on
    # parts the day on which the motor was opened.
    night: dt.date
    finding: Finding | None = None  # result of an inspection; None without one
    note: str = ""  # in words
    # worn, sound: parts that an inspection found so, separated by commas; None without any.
    worn: str | None = None
    sound: str | None = None


def record_decision(output: Path, decision: Decision) -> None:
    """Write a decision, which is then on the disk; a run may be under way."""
    with open_state(output) as state:
        _write(state, [decision])


def read_decisions(output: Path) -> tuple[Decision, ...]:
    """All decisions, the oldest first."""
    with read_state_file(output) as state:
        return _read(state)


def put_back(state: State, known: Iterable[Decision]) -> int:
    """Write known decisions that a restored state file lacks; returns their number."""
    present = set(_read(state))
    lost = [one for one in known if one not in present]
    _write(state, lost)
    return len(lost)


def _write(state: State, decisions: Iterable[Decision]) -> None:
    state.write_all(
        "INSERT INTO decisions VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        [
            tuple(one.isoformat() if isinstance(one, dt.date) else one for one in astuple(decision))
            for decision in decisions
        ],
    )


def _read(state: State) -> tuple[Decision, ...]:
    columns = ", ".join(Decision.__slots__)
    found = (
        Decision(
            motor, of, dt.datetime.fromisoformat(time), kind, dt.date.fromisoformat(night), *more
        )
        for motor, of, time, kind, night, *more in state.rows(f"SELECT {columns} FROM decisions")
    )
    return tuple(sorted(found, key=lambda one: (one.time, one.motor_id, one.indicator)))

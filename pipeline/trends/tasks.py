"""Tasks of the trend stage and their outcomes: plain data, and nothing that loads the science."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.config import MotorSpec
from pipeline.logs.ledger import read_settings
from pipeline.store.state import State
from pipeline.trends.circuits import Circuit, circuits_of
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.nights.trend_record import Record, read_kept, read_records
from pipeline.workers.process import Loss

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class TrendTask:
    """Whole oil circuits whose trends are to be made, up to tonight.

    `kept` has what the run before kept of a motor, if anything, as the state file has it;
    `changed_from` has the first night with new rows of each motor that was asked for, or None;
    `given_up` how this run's workers were lost in a motor's trends.
    """

    circuits: tuple[Circuit, ...]
    output: Path
    staging: Path
    changed_from: Mapping[str, dt.date | None]
    tonight: Tonight
    kept: Mapping[str, bytes | None] = field(default_factory=dict)
    given_up: Mapping[str, Loss] = field(default_factory=dict)

    @property
    def specs(self) -> list[MotorSpec]:
        """The motors."""
        return [spec for circuit in self.circuits for spec in circuit.specs]


@dataclass(frozen=True, slots=True)
class TrendOutcome:
    """By motor: number of staged nights, failures, and of each with nights its record.

    What is to be kept of a motor is staged beside its rows.

    `alarms` are the staged rows of `alarms` that were not published before.
    """

    nights: Mapping[str, int] = field(default_factory=dict)
    failures: Mapping[str, Loss] = field(default_factory=dict)
    records: Mapping[str, Record] = field(default_factory=dict)
    alarms: tuple[Row, ...] = ()


def trend_tasks(
    specs: Sequence[MotorSpec],
    state: State,
    staging: Path,
    changed_from: Mapping[str, dt.date | None],
    tonight: Tonight,
    decisions: tuple[Decision, ...],
    motors_a_task: int,
) -> list[TrendTask]:
    """Tasks of whole circuits with nights to be made, of about so many motors each."""
    records, settings = read_records(state), read_settings(state)
    batches: list[list[Circuit]] = [[]]
    for group in circuits_of(specs):
        if not any(one.motor_id in changed_from for one in group):
            continue
        circuit = Circuit.of(group, decisions, records, settings)
        if circuit.is_due(changed_from, tonight):
            if sum(len(one.specs) for one in batches[-1]) >= motors_a_task:
                batches.append([])
            batches[-1].append(circuit)
    return [
        TrendTask(
            tuple(batch),
            state.output,
            staging,
            changed_from,
            tonight,
            {name: read_kept(state, name) for circuit in batch for name in circuit.records},
        )
        for batch in batches
        if batch
    ]


def kept_file(staging: Path, motor_id: str) -> Path:
    """File below the staging folder with what is to be kept of a motor."""
    return staging / "kept" / motor_id


def lost_trends(task: TrendTask, loss: Loss) -> TrendOutcome:
    """The outcome of a task that was lost as a whole."""
    ids = (spec.motor_id for spec in task.specs)
    return TrendOutcome(failures={one: task.given_up.get(one, loss) for one in ids})


def without_lost_motor(task: TrendTask, loss: Loss) -> TrendTask | None:
    """The task that gives up the motor in which it was lost; None where it is not known."""
    if not loss.part:
        return None
    return replace(task, given_up={**task.given_up, loss.part: loss})

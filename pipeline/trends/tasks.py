"""Tasks of the trend stage and their outcomes: plain data, and nothing that loads the science."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import merge
from itertools import groupby
from pathlib import Path
from typing import Any

from pipeline.config import MotorSpec
from pipeline.logs.processed import (
    as_published,
    read_settings,
    read_stays,
    unpublished_rows,
)
from pipeline.schema import NIGHTS
from pipeline.schema.fits import WITH_SAMPLES
from pipeline.store.state import StateDatabase
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.trend_record import Record, read_checkpoint, read_records, trend_hash
from pipeline.workers.process import Loss

Row = dict[str, Any]

DAY = dt.timedelta(days=1)


def circuits_of(specs: Iterable[MotorSpec]) -> list[list[MotorSpec]]:
    """Return motors by oil circuit; one without a circuit is a group of its own."""
    circuits: defaultdict[str, list[MotorSpec]] = defaultdict(list)
    for spec in specs:
        circuits[spec.file.oil_circuit or f"\0{spec.motor_id}"].append(spec)
    return [group for _, group in sorted(circuits.items())]


@dataclass(frozen=True, slots=True)
class Circuit:
    """Motors of one oil circuit, and what is known of each before its nights are read.

    By motor: what people said of it, what is remembered of its trends, and the hash of all that
    shapes them beyond the tables.
    """

    specs: tuple[MotorSpec, ...]
    decisions: Mapping[str, tuple[Decision, ...]]
    records: Mapping[str, Record | None]
    hashes: Mapping[str, str]

    @classmethod
    def of(
        cls,
        specs: Sequence[MotorSpec],
        decisions: Iterable[Decision],
        records: Mapping[str, Record],
        settings: Mapping[str, Mapping[str, Any]],
    ) -> Circuit:
        """A circuit with its motors as their fits are published, and what is remembered of them."""
        specs = [as_published(spec, settings.get(spec.motor_id)) for spec in specs]
        own_decisions = decisions_of(specs, decisions)
        return cls(
            tuple(specs),
            own_decisions,
            {spec.motor_id: records.get(spec.motor_id) for spec in specs},
            {spec.motor_id: trend_hash(spec, own_decisions[spec.motor_id]) for spec in specs},
        )

    def spans(
        self, changed_from: Mapping[str, dt.date | None], newest_night: NewestNight
    ) -> dict[str, tuple[dt.date | None, dt.date]]:
        """First and last night of each motor whose trends are to be made; the first None: none are.

        New nights, and those from the first on that a late log of any motor has touched: what one
        does says what moves all. All of them where a motor's own settings, events or resets
        changed; that touches no other. A motor that was not asked for gets no new nights.
        """
        touched = [
            night
            for motor_id, record in self.records.items()
            if record is not None and record.trend_hash == self.hashes[motor_id]
            for night in (changed_from.get(motor_id), record.redo_from)
            if night is not None
        ]
        spans: dict[str, tuple[dt.date | None, dt.date]] = {}
        for motor_id, record in self.records.items():
            last, first = newest_night.of(motor_id), None
            if record is None:
                first = dt.date.min if motor_id in changed_from else None
            elif record.trend_hash != self.hashes[motor_id]:
                first = dt.date.min
            else:
                first = min([record.last_night + DAY, *touched])
            if record is not None and motor_id not in changed_from:
                last = min(last, record.last_night)
            spans[motor_id] = (first if first is not None and first <= last else None, last)
        return spans


def decisions_of(
    specs: Iterable[MotorSpec], decisions: Iterable[Decision]
) -> dict[str, tuple[Decision, ...]]:
    """Return decisions of people on some motors, by motor."""
    by_motor: dict[str, list[Decision]] = {spec.motor_id: [] for spec in specs}
    for decision in decisions:
        if decision.motor_id in by_motor:
            by_motor[decision.motor_id].append(decision)
    return {motor_id: tuple(some) for motor_id, some in by_motor.items()}


@dataclass(frozen=True, slots=True)
class NewestNight:
    """The fleet's newest night with kept samples, since which motors without a log are silent.

    `further` has by motor its newest night with samples after that, of which it kept none.
    """

    night: dt.date
    further: Mapping[str, dt.date] = field(default_factory=dict)

    def of(self, motor_id: str) -> dt.date:
        """Return the last night of a motor of which something is said."""
        return self.further.get(motor_id, self.night)


def newest_night_of(
    state: StateDatabase, motor_ids: Sequence[str], latest: dt.date
) -> NewestNight | None:
    """Return newest night, be its row published or not; None where no motor has kept a sample.

    A night known of an unreadable log only, or that lies in the future, after `latest`, is not
    in the newest night: it would make every other motor silent since."""
    further: dict[str, dt.date] = {}
    columns = ("motor_id", "status", "last_sample")
    unpublished: defaultdict[dt.date, dict[str, tuple[Any, ...]]] = defaultdict(dict)
    for motor_id in motor_ids:
        for night, row in unpublished_rows(state, motor_id).items():
            unpublished[night][motor_id] = row["status"], row["last_sample"]
    published = nights_back(state.output, NIGHTS)
    nights = merge(published, sorted(unpublished, reverse=True), reverse=True)
    for night, _ in groupby(nights):
        published_rows = read_rows(state.output, NIGHTS, motor_ids, columns, nights=[night]).rows()
        rows = {motor_id: tuple(row) for motor_id, *row in published_rows} | unpublished[night]
        for motor_id, (status, _) in rows.items():
            if status in WITH_SAMPLES:
                further.setdefault(motor_id, night)
        if night <= latest and any(last_sample for _, last_sample in rows.values()):
            return NewestNight(night, further)
    return None


@dataclass(frozen=True, slots=True)
class TrendTask:
    """Whole oil circuits whose trends are to be made, up to the newest night.

    `checkpoints` has what the run before left of a motor, if anything, as the state file has it;
    `changed_from` has the first night with new rows of each motor that was asked for, or None;
    `given_up` how this run's workers were lost in a motor's trends.
    """

    circuits: tuple[Circuit, ...]
    output: Path
    staging: Path
    changed_from: Mapping[str, dt.date | None]
    newest_night: NewestNight
    checkpoints: Mapping[str, bytes | None] = field(default_factory=dict)
    # By motor, rows of nights as far as these fill them, which are not in `nights` yet.
    unpublished: Mapping[str, Mapping[dt.date, Row]] = field(default_factory=dict)
    # By motor, why nights stay as published.
    stays: Mapping[str, Mapping[dt.date, str]] = field(default_factory=dict)
    given_up: Mapping[str, Loss] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"trends of {', '.join(spec.motor_id for spec in self.specs)}"

    @property
    def specs(self) -> list[MotorSpec]:
        """The motors."""
        return [spec for circuit in self.circuits for spec in circuit.specs]


@dataclass(frozen=True, slots=True)
class TrendOutcome:
    """By motor: failures, and of each with nights its record.

    The checkpoint of a motor is staged beside its rows.

    `alarms` are the new rows of `alarms` that people are notified of, `silent` the ids of others.
    """

    failures: dict[str, Loss] = field(default_factory=dict)
    records: dict[str, Record] = field(default_factory=dict)
    alarms: list[Row] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)


def trend_tasks(
    specs: Sequence[MotorSpec],
    state: StateDatabase,
    staging: Path,
    changed_from: Mapping[str, dt.date | None],
    newest_night: NewestNight,
    decisions: tuple[Decision, ...],
    motors_a_task: int,
) -> Iterator[TrendTask]:
    """Yield tasks of whole circuits with nights to be made, of about so many motors each.

    What a task needs of the state file is read when it is drawn: together it may not fit into the
    memory.
    """
    records, settings = read_records(state), read_settings(state)
    stays, _ = read_stays(state, records.keys())
    batches: list[list[Circuit]] = [[]]
    for group in circuits_of(specs):
        if not any(spec.motor_id in changed_from for spec in group):
            continue
        circuit = Circuit.of(group, decisions, records, settings)
        if any(first for first, _ in circuit.spans(changed_from, newest_night).values()):
            if sum(len(other.specs) for other in batches[-1]) >= motors_a_task:
                batches.append([])
            batches[-1].append(circuit)
    for batch in filter(None, batches):
        names = [name for circuit in batch for name in circuit.records]
        yield TrendTask(
            tuple(batch),
            state.output,
            staging,
            changed_from,
            newest_night,
            {name: read_checkpoint(state, name) for name in names},
            {name: unpublished_rows(state, name) for name in names},
            {name: stays.get(name, {}) for name in names},
        )


def checkpoint_file(staging: Path, motor_id: str) -> Path:
    """Return file below the staging folder with a motor's checkpoint."""
    return staging / "checkpoints" / motor_id


def lost_trends(task: TrendTask, loss: Loss) -> TrendOutcome:
    """Return the outcome of a task that was lost as a whole."""
    ids = (spec.motor_id for spec in task.specs)
    return TrendOutcome(failures={motor_id: task.given_up.get(motor_id, loss) for motor_id in ids})


def without_lost_motor(task: TrendTask, loss: Loss) -> TrendTask | None:
    """Return the task that gives up the motor in which it was lost; None where it is not known."""
    if not loss.part:
        return None
    return replace(task, given_up={**task.given_up, loss.part: loss})

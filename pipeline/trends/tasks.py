"""Tasks of the trend stage, the record of what it has published, and outcomes: plain data.

Nothing here loads the science.
"""

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
from pipeline.config.hashes import config_hash, hash_of
from pipeline.config.nights import DAY
from pipeline.logs.processed import as_published, read_settings, read_stays, unpublished_rows
from pipeline.schema import NIGHTS, WITH_SAMPLES, Row
from pipeline.store.state import StateDatabase
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.decisions import Decision
from pipeline.workers.process import Loss

# Raise it when the code makes other trends of the same tables: all of them are then made anew.
TRENDS_VERSION = 23


@dataclass(frozen=True, slots=True)
class Record:
    """A motor's published trends."""

    trend_hash: str  # hash of their settings
    last_night: dt.date
    # First night whose trends are out of date, as its rows were made anew; None without any.
    redo_from: dt.date | None = None


def trend_hash(spec: MotorSpec, decisions: Sequence[Decision]) -> str:
    """Return hash of what shapes a motor's trends: its config and decisions, not its circuit's."""
    resets = [
        (decision.night.isoformat(), decision.indicator, decision.note)
        for decision in decisions
        if decision.kind == "baseline_reset"
    ]
    return hash_of({"version": TRENDS_VERSION, "config": config_hash(spec), "resets": resets})


def read_records(state: StateDatabase) -> dict[str, Record]:
    """Return records of the trends of all motors, by motor."""
    rows = state.rows("SELECT motor_id, trend_hash, last_night, redo_from FROM trends")
    return {
        motor_id: Record(
            trend_hash,
            dt.date.fromisoformat(last_night),
            None if redo_from is None else dt.date.fromisoformat(redo_from),
        )
        for motor_id, trend_hash, last_night, redo_from in rows
    }


def read_checkpoint(state: StateDatabase, motor_id: str) -> bytes | None:
    """Return a motor's checkpoint, which saves its watch being made anew; None without any."""
    rows = state.rows("SELECT checkpoint FROM trends WHERE motor_id = ?", motor_id)
    return rows[0][0] if rows else None


def write_record(
    state: StateDatabase, motor_id: str, record: Record, checkpoint: bytes | None = None
) -> None:
    """Write the record of a motor's trends, and its checkpoint; raises StoreError."""
    state.write(
        "INSERT OR REPLACE INTO trends VALUES (?, ?, ?, ?, ?)",
        motor_id,
        record.trend_hash,
        str(record.last_night),
        None if record.redo_from is None else str(record.redo_from),
        checkpoint,
    )


def note_touched(state: StateDatabase, touched: Iterable[tuple[str, dt.date]]) -> None:
    """Mark motors' trends from a night on as out of date, before their rows change."""
    state.write_all(
        "UPDATE trends SET redo_from = min(coalesce(redo_from, ?2), ?2)"
        " WHERE motor_id = ?1 AND last_night >= ?2",
        [(motor_id, str(night)) for motor_id, night in touched],
    )


def circuits_of(specs: Iterable[MotorSpec]) -> list[list[MotorSpec]]:
    """Return motors by oil circuit; a motor without a circuit is a group of its own."""
    circuits: defaultdict[str, list[MotorSpec]] = defaultdict(list)
    for spec in specs:
        circuits[spec.file.oil_circuit or f"\0{spec.motor_id}"].append(spec)
    return [group for _, group in sorted(circuits.items())]


@dataclass(frozen=True, slots=True)
class TrendMotor:
    """A motor of a task, and what is known of it before its nights are read.

    Trends are made from `first` to `until`; without `first` others of its circuit see it alone.
    """

    spec: MotorSpec  # as its fits are published
    decisions: tuple[Decision, ...] = ()
    record: Record | None = None
    trend_hash: str = ""  # of all that shapes its trends beyond the tables
    first: dt.date | None = None
    until: dt.date = dt.date.max
    checkpoint: bytes | None = None  # as the state file has it
    # Rows of nights as far as these fill them, which are not in `nights` yet.
    unpublished: Mapping[dt.date, Row] = field(default_factory=dict)
    stays: Mapping[dt.date, str] = field(default_factory=dict)  # why nights stay as published

    @property
    def is_as_recorded(self) -> bool:
        """True if its published trends are of the settings of now."""
        return self.record is not None and self.record.trend_hash == self.trend_hash


Circuit = tuple[TrendMotor, ...]  # the motors of an oil circuit


def circuit_of(
    specs: Sequence[MotorSpec],
    decisions: Iterable[Decision],
    records: Mapping[str, Record],
    settings: Mapping[str, Mapping[str, Any]],
) -> Circuit:
    """Return a circuit's motors as their fits are published, and what is remembered of them."""
    own, motors = decisions_of(specs, decisions), []
    for spec in specs:
        decided = own[spec.motor_id]
        published = as_published(spec, settings.get(spec.motor_id))
        record = records.get(spec.motor_id)
        motors.append(TrendMotor(published, decided, record, trend_hash(published, decided)))
    return tuple(motors)


def with_spans(
    circuit: Circuit, changed_from: Mapping[str, dt.date | None], newest_night: NewestNight
) -> Circuit:
    """Return a circuit's motors with the nights whose trends are to be made.

    `changed_from` has the first night with new rows of each motor that was asked for, or None. To
    be made are new nights, and those that a late log of any motor has touched: what one does says
    what moves all. All of them where a motor's own settings, events or resets changed.
    """
    touched = [
        night
        for motor in circuit
        if motor.record is not None and motor.is_as_recorded
        for night in (changed_from.get(motor.spec.motor_id), motor.record.redo_from)
        if night is not None
    ]
    motors = []
    for motor in circuit:
        record, is_asked_for = motor.record, motor.spec.motor_id in changed_from
        until = newest_night.of(motor.spec.motor_id)
        if record is None:
            first = dt.date.min if is_asked_for else dt.date.max
        else:
            until = until if is_asked_for else min(until, record.last_night)
            is_anew = not motor.is_as_recorded
            first = dt.date.min if is_anew else min([record.last_night + DAY, *touched])
        motors.append(replace(motor, first=first if first <= until else None, until=until))
    return tuple(motors)


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

    One that lies in the future, after `latest`, would make every other motor silent since.
    """
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
    """Whole oil circuits whose trends are to be made.

    `given_up` says how this run's workers were lost in a motor's trends.
    """

    circuits: tuple[Circuit, ...]
    output: Path
    staging: Path
    given_up: Mapping[str, Loss] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"trends of {', '.join(self.motor_ids)}"

    @property
    def motor_ids(self) -> list[str]:
        """Ids of the motors."""
        return [motor.spec.motor_id for circuit in self.circuits for motor in circuit]


@dataclass(frozen=True, slots=True)
class TrendOutcome:
    """By motor: failures, and of each with nights its record; its checkpoint is staged.

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

    What a task needs of the state file is read when it is drawn: together it may not fit into
    memory.
    """
    records, settings = read_records(state), read_settings(state)
    stays, _ = read_stays(state, records.keys())
    batches: list[list[Circuit]] = [[]]
    for group in circuits_of(specs):
        if not any(spec.motor_id in changed_from for spec in group):
            continue
        circuit = circuit_of(group, decisions, records, settings)
        circuit = with_spans(circuit, changed_from, newest_night)
        if any(motor.first for motor in circuit):
            if sum(map(len, batches[-1])) >= motors_a_task:
                batches.append([])
            batches[-1].append(circuit)

    def whole(motor: TrendMotor) -> TrendMotor:
        name = motor.spec.motor_id
        return replace(
            motor,
            checkpoint=read_checkpoint(state, name),
            unpublished=unpublished_rows(state, name),
            stays=stays.get(name, {}),
        )

    for batch in filter(None, batches):
        circuits = tuple(tuple(map(whole, circuit)) for circuit in batch)
        yield TrendTask(circuits, state.output, staging)


def checkpoint_file(staging: Path, motor_id: str) -> Path:
    """Return file below the staging folder with a motor's checkpoint."""
    return staging / "checkpoints" / motor_id


def lost_trends(task: TrendTask, loss: Loss) -> TrendOutcome:
    """Return the outcome of a task that was lost as a whole."""
    losses = dict.fromkeys(task.motor_ids, loss)
    return TrendOutcome(failures=losses | dict(task.given_up))


def without_lost_motor(task: TrendTask, loss: Loss) -> TrendTask | None:
    """Return the task that gives up the motor in which it was lost; None where it is not known."""
    if not loss.part:
        return None
    return replace(task, given_up={**task.given_up, loss.part: loss})

"""The trend stage: after all motors are done, each against its own past and its circuit.

A task does whole oil circuits. It reads the published tables and writes only into its own staging
files; whatever goes wrong with a motor is that motor's.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import polars as pl
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from leakage.slope import benjamini_hochberg
from pipeline.config import MotorSpec
from pipeline.decisions import Decision
from pipeline.errors import StoreError
from pipeline.schema import ALARMS, BLOCK_STATISTICS, TREND_TABLES
from pipeline.store import read_rows, stage
from pipeline.trends.alarm_rows import RECOMPUTED, alarm_rows
from pipeline.trends.baseline_rows import baseline_rows, change_point_rows
from pipeline.trends.eras import Era, eras_of, indicators_of
from pipeline.trends.history import History, read_histories
from pipeline.trends.indicators import Indicator
from pipeline.trends.peers import LogChange, Peers, log_change, moved_apart, peers_of_circuit
from pipeline.trends.poor_nights import BLOCK_COLUMNS, with_poor_nights
from pipeline.trends.record import Record, read_record, trend_hash
from pipeline.trends.segments import segments
from pipeline.trends.standing import Standing
from pipeline.trends.sudden import sudden_changes
from pipeline.trends.trend_rows import trend_rows
from pipeline.trends.watch import watch
from pipeline.trends.zeros import sensor_zeros

log = logging.getLogger(__name__)

Row = dict[str, Any]
Made = TypeVar("Made")


@dataclass(frozen=True, slots=True)
class TrendTask:
    """Oil circuits whose trends are to be made.

    Attributes
    ----------
    specs
        The motors, whole circuits.
    output, staging
        Output folder, and where rows are left for the run to publish.
    changed_from
        By motor that was asked for: its first night with new rows; None where it has none.
    tonight
        Last night of the fleet.
    decisions
        What people said.
    """

    specs: tuple[MotorSpec, ...]
    output: Path
    staging: Path
    changed_from: Mapping[str, dt.date | None]
    tonight: dt.date
    decisions: tuple[Decision, ...] = ()


@dataclass(frozen=True, slots=True)
class TrendOutcome:
    """What came of the trends of some motors.

    Attributes
    ----------
    nights
        By motor: how many nights are staged.
    records
        By motor: what is to be remembered once they are published.
    failures
        By motor: what went wrong, in words.
    alarms
        Staged rows of `alarms` that were not published before.
    """

    nights: Mapping[str, int] = field(default_factory=dict)
    records: Mapping[str, Record] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    alarms: tuple[Row, ...] = ()


def trend_tasks(
    specs: Sequence[MotorSpec],
    output: Path,
    staging: Path,
    changed_from: Mapping[str, dt.date | None],
    tonight: dt.date,
    decisions: tuple[Decision, ...],
    motors_a_task: int,
) -> list[TrendTask]:
    """Tasks of whole circuits, a motor without one on its own, of about so many motors each."""
    wanted = [
        group for group in circuits_of(specs) if any(one.motor_id in changed_from for one in group)
    ]
    batches: list[list[MotorSpec]] = [[]]
    for group in wanted:
        if len(batches[-1]) >= motors_a_task:
            batches.append([])
        batches[-1] += group
    return [
        TrendTask(tuple(batch), output, staging, changed_from, tonight, decisions)
        for batch in batches
        if batch
    ]


def circuits_of(specs: Iterable[MotorSpec]) -> list[list[MotorSpec]]:
    """Motors by oil circuit; one without a circuit is a group of its own."""
    circuits: defaultdict[str, list[MotorSpec]] = defaultdict(list)
    for spec in specs:
        circuits[spec.file.oil_circuit or f"\0{spec.motor_id}"].append(spec)
    return [group for _, group in sorted(circuits.items())]


def run_trends(task: TrendTask) -> TrendOutcome:
    """Make the trends of a task's motors, and stage their rows."""
    with threadpool_limits(1):
        ids = [spec.motor_id for spec in task.specs]
        try:
            histories = read_histories(task.output, task.specs, task.tonight)
        except StoreError as error:
            return TrendOutcome(failures=dict.fromkeys(ids, error.message))
        done = _Done()
        for group in circuits_of(task.specs):
            _run_circuit(task, group, histories, done)
        return TrendOutcome(done.nights, done.records, done.failures, tuple(done.alarms))


@dataclass(slots=True)
class _Done:
    """What a task has done so far."""

    nights: dict[str, int] = field(default_factory=dict)
    records: dict[str, Record] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    alarms: list[Row] = field(default_factory=list)

    def guarded(self, motor_id: str, make: Callable[[], Made]) -> Made | None:
        """Do something of a motor: it must not take others down."""
        try:
            return make()
        except StoreError as error:
            self.failures[motor_id] = error.message
        except Exception as error:  # the edge of a motor's trends
            log.exception("trends of motor %s failed", motor_id)
            self.failures[motor_id] = f"{type(error).__name__}: {error}"
        return None


def _run_circuit(
    task: TrendTask, group: Sequence[MotorSpec], histories: Mapping[str, History], done: _Done
) -> None:
    hashes = {spec.motor_id: trend_hash(group, spec, task.decisions) for spec in group}
    spans = nights_to_do(task, group, hashes, histories)
    parts: dict[str, Part] = {}
    for spec in group if spans else ():
        motor_id = spec.motor_id
        if motor_id in histories:
            said = decisions_of(task.decisions, motor_id)
            part = done.guarded(motor_id, partial(_part, task.output, histories[motor_id], said))
            if part is not None:
                parts[motor_id] = part
    peers = circuit_peers(parts) if len(group) > 1 else {}
    for motor_id, span in spans.items():
        part = parts.get(motor_id)
        if part is None:
            continue
        others = peers.get(motor_id, {})
        made = done.guarded(motor_id, partial(_stage_motor, task, part, others, span))
        if made is not None:
            done.nights[motor_id], new = made
            done.alarms += new
            done.records[motor_id] = Record(hashes[motor_id], span[1])


def nights_to_do(
    task: TrendTask,
    group: Sequence[MotorSpec],
    hashes: Mapping[str, str],
    histories: Mapping[str, History],
) -> dict[str, tuple[dt.date, dt.date]]:
    """First and last night of each motor whose trends are to be made.

    New nights, and those from the first on that a late log has touched, of any motor of the
    circuit: what one does says what moves all. All of them where the settings or what people said
    changed. A motor that was not asked for gets no new nights.
    """
    records = {spec.motor_id: read_record(task.output, spec.motor_id) for spec in group}
    touched = [task.changed_from.get(motor_id) for motor_id in records]
    touched += [record.redo_from for record in records.values() if record is not None]
    earliest = [night for night in touched if night is not None]
    found = {}
    for motor_id, before in records.items():
        asked = motor_id in task.changed_from
        if motor_id not in histories or (before is None and not asked):
            continue
        first, last = dt.date.min, histories[motor_id].nights[-1]
        if before is not None:
            last = last if asked else min(last, before.last_night)
            if before.trend_hash == hashes[motor_id]:
                first = min([before.last_night + dt.timedelta(days=1), *earliest])
        if first <= last:
            found[motor_id] = (first, last)
    return found


def _part(output: Path, history: History, said: tuple[Decision, ...]) -> Part:
    """What is known of a motor, its poor nights fitted together."""

    def read_blocks(nights: Sequence[dt.date]) -> pl.DataFrame:
        motors = [history.spec.motor_id]
        return read_rows(output, BLOCK_STATISTICS, motors, BLOCK_COLUMNS, nights=nights)

    return Part.of(with_poor_nights(history, said, read_blocks), said)


def decisions_of(decisions: Sequence[Decision], motor_id: str) -> tuple[Decision, ...]:
    """What people said of one motor."""
    return tuple(one for one in decisions if one.motor_id == motor_id)


@dataclass(frozen=True, slots=True)
class Part:
    """What is known of a motor before the others are looked at.

    Attributes
    ----------
    history, decisions
        Its nights, and what people said.
    eras, indicators
        From `eras_of` and `indicators_of`.
    changes
        How far each indicator had moved.
    apart
        Nights on which its paths had moved by different amounts, shape (n,).
    """

    history: History
    decisions: tuple[Decision, ...]
    eras: tuple[Era, ...]
    indicators: Mapping[str, Indicator]
    changes: Mapping[str, LogChange]
    apart: NDArray[np.bool_]

    @classmethod
    def of(cls, history: History, decisions: tuple[Decision, ...]) -> Part:
        eras = eras_of(history, decisions)
        indicators = indicators_of(history, eras)
        changes = {
            name: log_change(history, one, segments(history, decisions, name))
            for name, one in indicators.items()
        }
        paths = [changes[name].told for name, one in indicators.items() if one.path]
        apart = np.zeros(len(history), dtype=np.bool_)
        if paths:
            apart = moved_apart(paths, history.spec.settings.alarms.common_cause_percent)
        return cls(history, decisions, eras, indicators, changes, apart)


def circuit_peers(parts: Mapping[str, Part]) -> dict[str, dict[str, Peers]]:
    """By motor and indicator, what the other motors of an oil circuit did."""
    found: defaultdict[str, dict[str, Peers]] = defaultdict(dict)
    for name in dict.fromkeys(name for part in parts.values() for name in part.indicators):
        own = {
            motor_id: part.changes[name] for motor_id, part in parts.items() if name in part.changes
        }
        histories = {motor_id: parts[motor_id].history for motor_id in own}
        apart = {motor_id: parts[motor_id].apart for motor_id in own}
        for motor_id, one in peers_of_circuit(histories, own, apart).items():
            found[motor_id][name] = one
    return found


def standing_of(part: Part, peers: Mapping[str, Peers]) -> Standing:
    """How a motor stands, night by night."""
    return Standing(
        part.history,
        part.eras,
        watch(part.history, part.decisions, part.indicators, peers),
        peers,
        part.apart,
        sudden_changes(part.history, part.decisions, part.indicators, peers),
        sensor_zeros(part.history, part.decisions),
    )


def _stage_motor(
    task: TrendTask, part: Part, peers: Mapping[str, Peers], span: tuple[dt.date, dt.date]
) -> tuple[int, list[Row]]:
    """Stage the rows of some nights of a motor; how many nights, and the new rows of `alarms`."""
    history, motor_id = part.history, part.history.spec.motor_id
    places = [place for place, night in enumerate(history.nights) if span[0] <= night <= span[1]]
    standing = standing_of(part, peers)
    published = read_rows(task.output, ALARMS, [motor_id]).drop("run_id").to_dicts()
    alarms = alarm_rows(standing, places, published)
    made = {
        "trends": trend_rows(standing, places),
        "alarms": alarms,
        "baselines": baseline_rows(standing, places),
        "change_points": change_point_rows(standing, places),
    }
    labels = [history.nights[place] for place in places]
    for table in TREND_TABLES:
        nights: dict[dt.date, list[Row]] = {label: [] for label in labels}
        for row in made[table.name]:
            nights[row["night"]].append(row)
        stage(task.staging / table.name / f"{motor_id}.arrow", table, nights)
    return len(places), new_alarms(alarms, published)


def new_alarms(rows: Sequence[Row], published: Sequence[Row]) -> list[Row]:
    """Those of a motor's rows of `alarms` that say something which was not said before."""

    def said(row: Row) -> tuple[object, ...]:
        return row["night"], row["indicator"], row["to_state"], row["way"] == RECOMPUTED

    before = {said(row) for row in published}
    return [row for row in rows if said(row) not in before]


def with_q_values(
    rows: pl.DataFrame, motor_ids: Sequence[str], false_discovery_rate: float
) -> pl.DataFrame:
    """A night's trends with q-values for some motors, over the slopes of the whole fleet.

    Those of other motors stay as they were published.
    """
    p_values = rows["p_value"].fill_null(np.nan).to_numpy()
    q_values = np.full(len(p_values), np.nan)
    indicators = rows["indicator"].to_numpy()
    for name in np.unique(indicators) if len(indicators) else ():
        family = indicators == name
        q_values[family] = benjamini_hochberg(p_values[family])
    new = pl.col("motor_id").is_in(list(motor_ids))
    q_value = pl.Series(q_values, dtype=pl.Float64).fill_nan(None)
    return rows.with_columns(
        q_value=pl.when(new).then(q_value).otherwise(pl.col("q_value")),
        is_trend=pl.when(new).then(q_value < false_discovery_rate).otherwise(pl.col("is_trend")),
    )

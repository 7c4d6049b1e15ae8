"""The trend stage: after all motors are done, each against its own past and its circuit.

A task does whole oil circuits. It reads the published tables and writes only into its own staging
files; whatever goes wrong with a motor is that motor's.
"""

from __future__ import annotations

import datetime as dt
import json
import logging
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from leakage.slope import benjamini_hochberg
from pipeline.config import MotorSpec
from pipeline.decisions import Decision
from pipeline.errors import StoreError
from pipeline.night_statistics import hash_of
from pipeline.schema import ALARMS, TREND_TABLES
from pipeline.settings_hashes import config_hash
from pipeline.store import read_rows, replace_whole, stage
from pipeline.trends.history import History, read_histories
from pipeline.trends.indicators import DEVIATION, Indicator
from pipeline.trends.peers import Peers, log_change, moved_apart, peers_of_circuit
from pipeline.trends.rows import RAISED, MotorRows, Row, by_night
from pipeline.trends.segments import segments
from pipeline.trends.watch import Era, motor_indicators, watch
from pipeline.worker_process import Loss, loss_of, sign_of_life

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

# Raise it when the code makes other trends of the same tables: all of them are then made anew.
TRENDS_VERSION = 1
RECOMPUTED = "recomputed"


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
    given_up
        By motor: how this run's workers were lost in its trends, each time.
    """

    specs: tuple[MotorSpec, ...]
    output: Path
    staging: Path
    changed_from: Mapping[str, dt.date | None]
    tonight: dt.date
    decisions: tuple[Decision, ...] = ()
    given_up: Mapping[str, Loss] = field(default_factory=dict)


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
        By motor: what went wrong.
    """

    nights: Mapping[str, int] = field(default_factory=dict)
    records: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    failures: Mapping[str, Loss] = field(default_factory=dict)


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
    circuits: defaultdict[str, list[MotorSpec]] = defaultdict(list)
    for spec in specs:
        circuits[spec.file.oil_circuit or f"\0{spec.motor_id}"].append(spec)
    wanted = [
        group
        for _, group in sorted(circuits.items())
        if any(one.motor_id in changed_from for one in group)
    ]
    tasks: list[TrendTask] = []
    batch: list[MotorSpec] = []
    for group in wanted:
        batch += group
        if len(batch) >= motors_a_task:
            tasks.append(TrendTask(tuple(batch), output, staging, changed_from, tonight, decisions))
            batch = []
    if batch:
        tasks.append(TrendTask(tuple(batch), output, staging, changed_from, tonight, decisions))
    return tasks


def run_trends(task: TrendTask) -> TrendOutcome:
    """Make the trends of a task's motors, and stage their rows."""
    with threadpool_limits(1):
        ids = [spec.motor_id for spec in task.specs]
        try:
            histories = read_histories(task.output, ids, task.tonight)
        except StoreError as error:
            return TrendOutcome(failures=dict.fromkeys(ids, _failure(error)))
        nights: dict[str, int] = {}
        records: dict[str, Mapping[str, str]] = {}
        failures = dict(task.given_up)
        parts: dict[str, _Part] = {}
        for spec in task.specs:
            if spec.motor_id in histories and spec.motor_id not in failures:
                sign_of_life(spec.motor_id)
                try:
                    history = histories[spec.motor_id]
                    said = decisions_of(task.decisions, spec.motor_id)
                    parts[spec.motor_id] = _Part.of(spec, history, said)
                except Exception as error:  # the edge of a motor: it must not take others down
                    log.exception("trends of motor %s failed", spec.motor_id)
                    failures[spec.motor_id] = _failure(error)
        sign_of_life("")
        peers = _peers(task, histories, parts)
        for spec in task.specs:
            motor_id = spec.motor_id
            if motor_id not in task.changed_from or motor_id not in parts:
                continue
            sign_of_life(motor_id)
            try:
                done = _stage_motor(task, spec, histories[motor_id], parts[motor_id], peers)
            except Exception as error:  # as above
                log.exception("trends of motor %s failed", motor_id)
                failures[motor_id] = _failure(error)
            else:
                nights[motor_id], records[motor_id] = done
        return TrendOutcome(nights, records, failures)


def _failure(error: Exception) -> Loss:
    if isinstance(error, StoreError):
        return Loss(error.code, error.message)
    return loss_of(error)


def lost_trends(task: TrendTask, loss: Loss) -> TrendOutcome:
    """The outcome of a task that was lost as a whole."""
    ids = (spec.motor_id for spec in task.specs)
    return TrendOutcome(failures={one: task.given_up.get(one, loss) for one in ids})


def without_lost_motor(task: TrendTask, loss: Loss) -> TrendTask | None:
    """The task that gives up the motor in which it was lost; None where it is not known."""
    if not loss.part:
        return None
    return replace(task, given_up={**task.given_up, loss.part: loss})


def decisions_of(decisions: Sequence[Decision], motor_id: str) -> tuple[Decision, ...]:
    """What people said of one motor."""
    return tuple(one for one in decisions if one.motor_id == motor_id)


@dataclass(frozen=True, slots=True)
class _Part:
    """What is known of a motor before the others are looked at.

    Attributes
    ----------
    indicators, eras
        From `motor_indicators`.
    changes
        Log changes by indicator, shape (n,) each.
    apart
        Nights on which its paths had moved by different amounts, shape (n,).
    """

    indicators: Mapping[str, Indicator]
    eras: tuple[Era, ...]
    changes: Mapping[str, Array]
    apart: NDArray[np.bool_]

    @classmethod
    def of(cls, spec: MotorSpec, history: History, decisions: Sequence[Decision]) -> _Part:
        indicators, eras = motor_indicators(spec, history, decisions)
        nights = spec.settings.trend.provisional_nights
        changes = {
            name: log_change(history, one, segments(spec, history, decisions, name), nights)
            for name, one in indicators.items()
        }
        paths = [one for name, one in changes.items() if name.startswith("K_")]
        apart = np.zeros(len(history.nights), dtype=np.bool_)
        if paths:
            apart = moved_apart(paths, spec.settings.alarms.common_cause_percent)
        return cls(indicators, eras, changes, apart)


def _peers(
    task: TrendTask, histories: Mapping[str, History], parts: Mapping[str, _Part]
) -> dict[str, dict[str, Peers]]:
    """By motor and indicator, what the other motors of its circuit did.

    A motor whose own paths moved apart wears; what it does says nothing of the oil.
    """
    found: defaultdict[str, dict[str, Peers]] = defaultdict(dict)
    circuits: defaultdict[str, list[str]] = defaultdict(list)
    for spec in task.specs:
        if spec.file.oil_circuit and spec.motor_id in parts:
            circuits[spec.file.oil_circuit].append(spec.motor_id)
    for group in circuits.values():
        names = sorted({name for motor_id in group for name in parts[motor_id].indicators})
        for name in names if len(group) > 1 else ():
            own = {one: parts[one].changes[name] for one in group if name in parts[one].changes}
            steady = {
                one: np.where(parts[one].apart, np.nan, change) for one, change in own.items()
            }
            nights = {motor_id: histories[motor_id].nights for motor_id in own}
            for motor_id, one in peers_of_circuit(nights, steady, own).items():
                found[motor_id][name] = one
    return found


def _stage_motor(
    task: TrendTask,
    spec: MotorSpec,
    history: History,
    part: _Part,
    peers: Mapping[str, Mapping[str, Peers]],
) -> tuple[int, Mapping[str, str]]:
    motor_id = spec.motor_id
    said = decisions_of(task.decisions, motor_id)
    record = {"trend_hash": trend_hash(spec, said), "last_night": history.nights[-1].isoformat()}
    first = _first_to_do(task, spec, record)
    places = [place for place, night in enumerate(history.nights) if night >= first]
    if not places:
        return 0, record
    own_peers = peers.get(motor_id, {})
    others = {name: one.others for name, one in own_peers.items()}
    watched = watch(spec, history, said, part.indicators, part.eras, others)
    rows = MotorRows(watched, own_peers.get(DEVIATION), part.apart)
    made = {
        "trends": by_night(rows.trends(places)),
        "alarms": _with_closed(
            by_night(rows.alarms(places)), task.output, motor_id, history.nights[places[0]], rows
        ),
        "baselines": by_night(rows.baselines(places)),
        "change_points": by_night(rows.change_points(places[-1])),
    }
    labels = [history.nights[place] for place in places]
    for table in TREND_TABLES:
        nights = {label: made[table.name].get(label, []) for label in labels}
        stage(task.staging / table.name / f"{motor_id}.arrow", table, nights)
    return len(places), record


def _first_to_do(task: TrendTask, spec: MotorSpec, record: Mapping[str, str]) -> dt.date:
    """First night whose trends are to be made: new, touched by a late log, or all of them."""
    before = read_record(task.output, spec.motor_id)
    changed = task.changed_from[spec.motor_id]
    if before.get("trend_hash") != record["trend_hash"]:
        return dt.date.min
    after = dt.date.fromisoformat(before["last_night"]) + dt.timedelta(days=1)
    return min(after, changed) if changed is not None else after


def trend_hash(spec: MotorSpec, decisions: Sequence[Decision]) -> str:
    """Hash of all that shapes a motor's trends beyond its tables."""
    return hash_of(
        {
            "version": TRENDS_VERSION,
            "config": config_hash(spec),
            "circuit": spec.file.oil_circuit,
            "resets": [
                (one.night.isoformat(), one.indicator)
                for one in decisions
                if one.kind == "baseline_reset"
            ],
        }
    )


def _with_closed(
    made: Mapping[dt.date, list[Row]],
    output: Path,
    motor_id: str,
    first: dt.date,
    rows: MotorRows,
) -> Mapping[dt.date, list[Row]]:
    """New alarms with those that were raised before and are not any more: closed, never deleted."""
    nights = {night: list(some) for night, some in made.items()}
    published = read_rows(output, ALARMS, [motor_id]).drop("run_id")
    again = {
        (row["night"], row["indicator"], row["to_state"]) for some in made.values() for row in some
    }
    for old in published.filter(pl.col("night") >= first).sort(ALARMS.key).to_dicts():
        if old["to_state"] not in RAISED and old["way"] != RECOMPUTED:
            continue
        if (old["night"], old["indicator"], old["to_state"]) in again:
            continue
        here = nights.setdefault(old["night"], [])
        if any(row["indicator"] == old["indicator"] for row in here):
            continue
        here.append(old)
        if old["to_state"] in RAISED:
            _close(nights, old, rows)
    return nights


def _close(nights: dict[dt.date, list[Row]], old: Row, rows: MotorRows) -> None:
    """Close an alarm that a recomputation took back, in the first later night without a change."""
    for place, night in enumerate(rows.watch.history.nights):
        if night <= old["night"]:
            continue
        here = nights.setdefault(night, [])
        if any(row["indicator"] == old["indicator"] for row in here):
            return
        here.append(rows.closing_row(old, place))
        return


def record_file(output: Path, motor_id: str) -> Path:
    """Where it is remembered which trends of a motor are published."""
    return output / "ledger" / motor_id / "trends"


def read_record(output: Path, motor_id: str) -> dict[str, str]:
    """What is remembered of a motor's trends; empty where nothing is, or it is damaged."""
    try:
        document = json.loads(record_file(output, motor_id).read_text("utf-8"))
        dt.date.fromisoformat(document["last_night"])
        return {"trend_hash": str(document["trend_hash"]), "last_night": document["last_night"]}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def write_record(output: Path, motor_id: str, record: Mapping[str, str]) -> None:
    """Remember which trends of a motor are published.

    Raises
    ------
    StoreError
        If it cannot be written.
    """

    def write(name: str) -> None:
        Path(name).write_text(json.dumps(dict(record), sort_keys=True), "utf-8")

    if read_record(output, motor_id) != record:
        replace_whole(record_file(output, motor_id), write)


def forget_records(output: Path, keep: Collection[str]) -> None:
    """Let the next run make the trends of all motors but some anew."""
    for folder in (output / "ledger").glob("*"):
        if folder.name not in keep:
            record_file(output, folder.name).unlink(missing_ok=True)


def with_q_values(rows: pl.DataFrame, motor_ids: Sequence[str]) -> pl.DataFrame:
    """A night's trends with q-values for some motors, over the slopes of the whole fleet.

    Those of other motors stay as they were published.
    """
    p_values = rows["p_value"].fill_null(np.nan).to_numpy()
    q_values = np.full(len(p_values), np.nan)
    indicators = rows["indicator"].to_numpy()
    for name in np.unique(indicators) if len(indicators) else ():
        family = indicators == name
        q_values[family] = benjamini_hochberg(p_values[family])
    return rows.with_columns(
        pl.when(pl.col("motor_id").is_in(list(motor_ids)))
        .then(pl.Series(q_values, dtype=pl.Float64).fill_nan(None))
        .otherwise(pl.col("q_value"))
        .alias("q_value")
    )

"""The trend stage: after all motors are done, each against its own past and its circuit.

A task does whole oil circuits. It reads the published tables and writes only into its own staging
files; whatever goes wrong with a motor is that motor's.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

from pipeline.errors import StoreError
from pipeline.schema import TREND_TABLES, TRENDS, Table
from pipeline.store.night_files import stage
from pipeline.store.sealed import stage_sealed
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.baselines.blocks import BlockFiles
from pipeline.trends.baselines.duty import at_duty, with_duty, without_duty
from pipeline.trends.baselines.eras import Era, eras_of
from pipeline.trends.baselines.leakages import indicators_of
from pipeline.trends.circuits import Circuit, earlier_views
from pipeline.trends.figures.filtered_nights import with_filter
from pipeline.trends.figures.indicators import DEVIATION, Indicator
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import History
from pipeline.trends.nights.reading import MotorNights, read_nights
from pipeline.trends.nights.records import Records
from pipeline.trends.nights.segments import segments
from pipeline.trends.nights.trend_record import Record, record_file
from pipeline.trends.rows.alarm_rows import RECOMPUTED, alarm_rows, marked, rules_now
from pipeline.trends.rows.baseline_rows import baseline_rows, change_point_rows
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.explanations import Explanations, OilCircuit, View, Why
from pipeline.trends.states.model import model_course, with_misfit
from pipeline.trends.states.peers import Contribution, Peers, contribution, peers_of_circuit
from pipeline.trends.states.standing import Standing
from pipeline.trends.states.sudden import sudden_changes
from pipeline.trends.states.watch import watch
from pipeline.trends.states.zeros import sensor_zeros
from pipeline.trends.tasks import Row, TrendOutcome, TrendTask
from pipeline.workers.process import Loss, loss_of, one_thread, sign_of_life

log = logging.getLogger(__name__)

Made = TypeVar("Made")


def run_trends(task: TrendTask) -> TrendOutcome:
    """Make the trends of a task's motors, and stage their rows."""
    with one_thread():
        said: dict[str, tuple[Decision, ...]] = {}
        since: dict[str, dt.date] = {}
        for circuit in task.circuits:
            said |= circuit.decisions
            since |= circuit.first_nights(task.changed_from, task.tonight)
        try:
            nights = read_nights(task.output, task.specs, said, since, task.tonight)
        except StoreError as error:
            return TrendOutcome(failures=dict.fromkeys(said, _failure(error)))
        done = _Done(dict(task.given_up))
        blocks = BlockFiles(task.output, list(said))
        for circuit in task.circuits:
            _run_circuit(task, circuit, nights, blocks, done)
        for motor_id, one in nights.items():
            one.keep(motor_id, done.filtered.get(motor_id))
        return TrendOutcome(done.nights, done.failures, tuple(done.alarms))


@dataclass(slots=True)
class _Done:
    """Results of a task so far."""

    failures: dict[str, Loss]
    filtered: dict[str, Records] = field(default_factory=dict)
    nights: dict[str, int] = field(default_factory=dict)
    alarms: list[Row] = field(default_factory=list)

    def guarded(self, motor_id: str, make: Callable[[], Made]) -> Made | None:
        """Do something of a motor: it must not take others down."""
        sign_of_life(motor_id)
        try:
            return make()
        except Exception as error:  # the edge of a motor's trends
            if not isinstance(error, StoreError):
                log.exception("trends of motor %s failed", motor_id)
            self.failures[motor_id] = _failure(error)
        finally:
            sign_of_life("")
        return None


def _run_circuit(
    task: TrendTask,
    circuit: Circuit,
    nights: Mapping[str, MotorNights],
    blocks: BlockFiles,
    done: _Done,
) -> None:
    histories = {
        spec.motor_id: history
        for spec in circuit.specs
        if (history := nights[spec.motor_id].history) is not None
    }
    spans = circuit.nights_to_do(task.changed_from, task.tonight, histories)
    seen_from, alone = circuit.beginnings(), len(circuit.specs) == 1
    parts: dict[str, Part] = {}
    for motor_id, history in histories.items() if spans else ():
        if motor_id not in done.failures:
            until, seen = nights[motor_id].filter_from, {} if alone else seen_from[motor_id]
            part = done.guarded(motor_id, partial(_part, history, until, seen, blocks))
            if part is not None:
                parts[motor_id] = part
                done.filtered[motor_id] = part.history.records
    peers, neighbours = neighbours_of(parts)
    for motor_id, span in spans.items():
        part = parts.get(motor_id)
        if part is None:
            continue
        stand = partial(standing_of, part, peers.get(motor_id), neighbours)
        published, before = nights[motor_id].published, circuit.records[motor_id]
        rules = rules_now(part.history.spec)
        record = Record(circuit.hashes[motor_id], span[1], None, seen_from[motor_id], rules)
        made = done.guarded(
            motor_id, partial(_stage_motor, task, stand, span, published, before, record)
        )
        if made is not None:
            done.nights[motor_id], new = made
            done.alarms += new


def _failure(error: Exception) -> Loss:
    if isinstance(error, StoreError):
        return Loss(error.code, error.message)
    return loss_of(error)


def _part(
    history: History, until: dt.date, seen_from: Mapping[str, dt.date], blocks: BlockFiles
) -> Part:
    """A motor before comparison with the others, its nights from `until` on filtered anew."""
    filtered = with_misfit(with_filter(history, until), until)
    part = Part.of(with_duty(filtered, until, blocks))
    for night, then in earlier_views(history, seen_from):
        # By another baseline, which others hear of for some nights: not at its duty.
        seen = without_duty(with_filter(then, dt.date.min))
        part = part.seen_before(night, Part.of(seen))
    return part


@dataclass(frozen=True, slots=True)
class Part:
    """A motor before comparison with the others of its oil circuit.

    `flow` is its contribution to the comparison, `views` how the others see it, the earliest first.
    """

    history: History
    eras: tuple[Era, ...]
    indicators: Mapping[str, Indicator]
    flow: Contribution
    views: tuple[View, ...]

    @classmethod
    def of(cls, history: History) -> Part:
        eras = eras_of(history)
        indicators = {
            name: at_duty(history, eras, one) for name, one in indicators_of(history, eras).items()
        }
        flow = contribution(history, indicators[DEVIATION], segments(history, DEVIATION))
        views = (View(None, Explanations(history, eras)),)
        return cls(history, eras, indicators, flow, views)

    def seen_before(self, night: dt.date, earlier: Part) -> Part:
        """The same where the other motors of its circuit saw another one before a night."""
        flow = self.flow.seen_before(self.history, self.history.place_from(night), earlier.flow)
        view = View(night, earlier.views[-1].explanations)
        return replace(self, flow=flow, views=(view, *self.views))


def neighbours_of(parts: Mapping[str, Part]) -> tuple[dict[str, Peers], OilCircuit | None]:
    """Drain flows of the others by motor of an oil circuit, and what all say of a common factor.

    Nothing for a motor on its own.
    """
    histories = {motor_id: part.history for motor_id, part in parts.items()}
    peers = peers_of_circuit(histories, {motor_id: part.flow for motor_id, part in parts.items()})
    views = {motor_id: part.views for motor_id, part in parts.items()}
    return peers, OilCircuit(views) if peers else None


def standing_of(part: Part, peers: Peers | None, circuit: OilCircuit | None) -> Standing:
    """Standing of a motor, night by night."""
    why = Why(part.views[-1].explanations, circuit)
    return Standing(
        part.history,
        part.eras,
        watch(part.history, part.indicators),
        peers,
        why,
        sudden_changes(part.history, part.indicators, why),
        sensor_zeros(part.history),
        model_course(part.history),
    )


def _stage_motor(
    task: TrendTask,
    stand: Callable[[], Standing],
    span: tuple[dt.date, dt.date],
    published: Sequence[Row],
    before: Record | None,
    record: Record,
) -> tuple[int, list[Row]]:
    """Stage rows of some nights of a motor, and its record; the nights' number, and new alarms."""
    standing = stand()
    history, motor_id = standing.history, standing.history.spec.motor_id
    gone = _withdrawn(task.output, history, span[0])
    places = [place for place, night in enumerate(history.nights) if span[0] <= night <= span[1]]
    rows = alarm_rows(standing, places, published)
    alarms = marked(rows, published, before, record.rules or {})
    made = {
        "trends": trend_rows(standing, places),
        "alarms": alarms,
        "baselines": baseline_rows(standing, places),
        "change_points": change_point_rows(standing, places),
    }
    labels = [*(history.nights[place] for place in places), *gone]
    staged: dict[Table, dict[dt.date, list[Row]]] = {}
    for table in TREND_TABLES:
        nights = staged[table] = {label: [] for label in labels}
        for row in made[table.name]:
            nights[row["night"]].append(row)
    stage(task.staging / "trends" / f"{motor_id}.arrow", staged)
    stage_sealed(record_file(task.staging, motor_id), asdict(record))
    told = [row for row in alarms if not row["is_silent"]]
    return len(places), new_alarms(told, published)


def _withdrawn(output: Path, history: History, first: dt.date) -> list[dt.date]:
    """Nights from one on in which a motor has published trends, and that are none of its nights."""
    published = takewhile(lambda night: night >= first, nights_back(output, TRENDS))
    others = set(published).difference(history.nights)
    if not others:
        return []
    rows = read_rows(output, TRENDS, [history.spec.motor_id], ("night",), nights=others)
    return sorted(set(rows["night"]))


def new_alarms(rows: Sequence[Row], published: Sequence[Row]) -> list[Row]:
    """Those of a motor's rows of `alarms` that say something which was not said before."""

    def said(row: Row) -> tuple[object, ...]:
        return row["night"], row["indicator"], row["to_state"], row["way"] == RECOMPUTED

    made = {row["night"] for row in rows}
    before = {said(row) for row in published if row["night"] in made}
    return [row for row in rows if said(row) not in before]

"""Oil circuits: their motors, what is remembered of each, and which nights are to be made.

An event or a reset is often entered nights after its date. The motor itself begins anew with that
date. The others were told of the nights since by what was known then, and that stands: they see
the new baseline from the first night on that none of the circuit had been told when it was entered.
"""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.config import MotorSpec
from pipeline.config.motors import Event
from pipeline.logs.ledger import as_published
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.nights.trend_record import Record, read_record, trend_hash

if TYPE_CHECKING:
    from pipeline.trends.nights.history import History

DAY = dt.timedelta(days=1)


def circuits_of(specs: Iterable[MotorSpec]) -> list[list[MotorSpec]]:
    """Motors by oil circuit; one without a circuit is a group of its own."""
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
    def of(cls, output: Path, specs: Sequence[MotorSpec], decisions: Iterable[Decision]) -> Circuit:
        """A circuit with its motors as their fits are published, and what is remembered of them."""
        specs = [as_published(output, one) for one in specs]
        said = decisions_of(specs, decisions)
        return cls(
            tuple(specs),
            said,
            {one.motor_id: read_record(output, one.motor_id) for one in specs},
            {one.motor_id: trend_hash(one, said[one.motor_id]) for one in specs},
        )

    def first_nights(
        self, changed_from: Mapping[str, dt.date | None], tonight: Tonight
    ) -> dict[str, dt.date]:
        """The first night of each motor whose trends may have to be made.

        New nights, and those from the first on that a late log of any motor has touched: what one
        does says what moves all. All of them where a motor's own settings, events or resets
        changed; that touches no other. Where nights after a motor's last are published, its last:
        it says that they are withdrawn.
        """
        found, touched, settled = {}, [], {}
        for motor_id, record in self.records.items():
            if record is None:
                if motor_id in changed_from:
                    found[motor_id] = dt.date.min
            elif record.trend_hash != self.hashes[motor_id]:
                found[motor_id] = dt.date.min
            else:
                until, after = tonight.of(motor_id), record.last_night + DAY
                settled[motor_id] = until if record.last_night > until else after
                touched += [changed_from.get(motor_id), record.redo_from]
        late = [night for night in touched if night is not None]
        return found | {motor_id: min([night, *late]) for motor_id, night in settled.items()}

    def is_due(self, changed_from: Mapping[str, dt.date | None], tonight: Tonight) -> bool:
        """True where a motor may have a night whose trends are to be made."""
        first = self.first_nights(changed_from, tonight)
        return any(night <= tonight.of(motor_id) for motor_id, night in first.items())

    def nights_to_do(
        self,
        changed_from: Mapping[str, dt.date | None],
        tonight: Tonight,
        histories: Mapping[str, History],
    ) -> dict[str, tuple[dt.date, dt.date]]:
        """First and last night of each motor whose trends are to be made.

        A motor that was not asked for gets no new nights.
        """
        found = {}
        for motor_id, first in self.first_nights(changed_from, tonight).items():
            if motor_id not in histories:
                continue
            last, before = histories[motor_id].nights[-1], self.records[motor_id]
            if motor_id not in changed_from and before is not None:
                last = min(last, before.last_night)
            if first <= last:
                found[motor_id] = (first, last)
        return found

    def beginnings(self) -> dict[str, dict[str, dt.date]]:
        """By motor, from when on the others see its events and resets."""
        known = [record for record in self.records.values() if record is not None]
        last_told = max((record.last_night for record in known), default=None)
        found = {}
        for spec in self.specs:
            record, said = self.records[spec.motor_id], self.decisions[spec.motor_id]
            before = None if record is None else record.beginnings
            found[spec.motor_id] = beginnings(spec, said, before, last_told)
        return found


def decisions_of(
    specs: Iterable[MotorSpec], decisions: Iterable[Decision]
) -> dict[str, tuple[Decision, ...]]:
    """Decisions of people on some motors, by motor."""
    found: dict[str, list[Decision]] = {one.motor_id: [] for one in specs}
    for one in decisions:
        if one.motor_id in found:
            found[one.motor_id].append(one)
    return {motor_id: tuple(said) for motor_id, said in found.items()}


def beginnings(
    spec: MotorSpec,
    decisions: Sequence[Decision],
    before: Mapping[str, dt.date] | None,
    last_told: dt.date | None,
) -> dict[str, dt.date]:
    """By event and reset of a motor, the first night from which others see its new baseline."""
    dates = _dates(spec, decisions)
    if before is None or last_told is None:
        return dates
    # With another oil the figures since its date are others: what was seen then is gone.
    other_oil = {_name(one) for one in spec.file.events if _changes_oil(spec, one)}
    return {
        name: before[name]
        if name in before
        else date
        if name in other_oil
        else max(date, last_told + DAY)
        for name, date in dates.items()
    }


def earlier_views(
    history: History, seen_from: Mapping[str, dt.date]
) -> Iterator[tuple[dt.date, History]]:
    """A motor as others saw it before a night, without what was entered later; latest night first.

    Nothing where all events and resets were entered in time.
    """
    dates = _dates(history.spec, history.decisions)
    late = {name: night for name, night in seen_from.items() if night > dates[name]}
    for until in sorted(set(late.values()), reverse=True):
        yield until, _without(history, {one for one in late if late[one] >= until})


def _without(history: History, names: Collection[str]) -> History:
    file = history.spec.file
    kept = tuple(one for one in file.events if _name(one) not in names)
    spec = replace(history.spec, file=file.model_copy(update={"events": kept}))
    said = tuple(one for one in history.decisions if _name(one) not in names)
    return replace(history, spec=spec, decisions=said)


def _dates(spec: MotorSpec, decisions: Sequence[Decision]) -> dict[str, dt.date]:
    events = {_name(one): one.date for one in spec.file.events}
    resets = {_name(one): one.night for one in decisions if one.kind == "baseline_reset"}
    return events | resets


def _name(one: Event | Decision) -> str:
    if isinstance(one, Event):
        return f"{one.kind} {one.date}"
    return f"{one.kind} {one.night} {one.indicator}"


def _changes_oil(spec: MotorSpec, event: Event) -> bool:
    return spec.file.oil_on(event.date) != spec.file.oil_on(event.date - DAY)

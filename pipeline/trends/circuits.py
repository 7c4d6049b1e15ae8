"""Oil circuits: their motors, what is remembered of each, and which nights are to be made.

A log that comes late makes the nights of all motors of the circuit anew: what one does says what
the oil did. Events, resets and settings of a motor touch its own nights alone.
"""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.config import MotorSpec
from pipeline.logs.ledger import as_published
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.nights.trend_record import Record, trend_hash

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
    def of(
        cls,
        specs: Sequence[MotorSpec],
        decisions: Iterable[Decision],
        records: Mapping[str, Record],
        settings: Mapping[str, Mapping[str, Any]],
    ) -> Circuit:
        """A circuit with its motors as their fits are published, and what is remembered of them."""
        specs = [as_published(one, settings.get(one.motor_id)) for one in specs]
        said = decisions_of(specs, decisions)
        return cls(
            tuple(specs),
            said,
            {one.motor_id: records.get(one.motor_id) for one in specs},
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

    def last_night(
        self, motor_id: str, changed_from: Mapping[str, dt.date | None], tonight: Tonight
    ) -> dt.date:
        """The last night of a motor whose trends may be made.

        A motor that was not asked for gets no new nights.
        """
        last, before = tonight.of(motor_id), self.records[motor_id]
        if motor_id in changed_from or before is None:
            return last
        return min(last, before.last_night)


def decisions_of(
    specs: Iterable[MotorSpec], decisions: Iterable[Decision]
) -> dict[str, tuple[Decision, ...]]:
    """Decisions of people on some motors, by motor."""
    found: dict[str, list[Decision]] = {one.motor_id: [] for one in specs}
    for one in decisions:
        if one.motor_id in found:
            found[one.motor_id].append(one)
    return {motor_id: tuple(said) for motor_id, said in found.items()}

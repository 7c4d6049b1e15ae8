"""Rows of `alarms` as runs publish them, and a receiver that is told what to do."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.schema import ALARMS, frame
from pipeline.store.state import open_state
from pipeline.telling.delivering import deliver
from pipeline.telling.delivery import Delivery, UndeliveredError
from pipeline.telling.outbox import backlogs, open_outbox, take_up
from tests.pipeline.written import write_nights

FLEET = "Mill"
FIRST = dt.date(2026, 2, 17)


@dataclass
class Fake:
    """A receiver that takes or refuses as it is told."""

    name: str = "command"
    label: str = "alarms.command"
    refuses: Callable[[Delivery], bool] = lambda _: False
    hangs: bool = False
    tried: list[Delivery] = field(default_factory=list)
    taken: list[dict[str, Any]] = field(default_factory=list)

    def take(self, delivery: Delivery) -> None:
        self.tried.append(delivery)
        if self.refuses(delivery):
            raise UndeliveredError("out of ink", hung=self.hangs)
        document = json.loads(delivery.content)
        assert document["id"] == delivery.id
        self.taken.append(document)

    def changes(self) -> list[dict[str, Any]]:
        return [one for document in self.taken for one in document["changes"]]

    def motors(self) -> list[str]:
        return [one["motor_id"] for one in self.changes()]


def row(motor: str, night: dt.date = FIRST, state: str = "alarm", **more: Any) -> dict[str, Any]:
    row = {"run_id": "r", "motor_id": motor, "night": night, "indicator": "K_piston_ring"}
    row |= {"time": dt.datetime.combine(night, dt.time(6), dt.UTC), "way": "level"}
    row |= {"from_state": "ok", "to_state": state, "reason": "piston ring gap +27 % [25, 29]"}
    absent = dict.fromkeys(("path", "rules", "state_before_rules", "is_silent"))
    return row | {"deviation_percent": 27.0} | absent | more


def publish(output: Path, *rows: dict[str, Any]) -> None:
    """Put the rows of each night, in place of those that it has."""
    for night in {one["night"] for one in rows}:
        here = [one for one in rows if one["night"] == night]
        write_nights(output, ALARMS, frame(ALARMS, here))


def run(
    output: Path, rows: Iterable[dict[str, Any]], *receivers: Fake, fleet: str = FLEET
) -> tuple[str, ...]:
    """The steps of a run that publishes some rows, without waits between tries."""
    with open_state(output) as state:
        open_outbox(state, [one.name for one in receivers], fleet)
        publish(output, *rows)
        take_up(state, fleet)
        return deliver(state, receivers, fleet, lambda _: None)


def undelivered(output: Path, *receivers: Fake) -> list[int]:
    return [one.undelivered for one in backlogs(output, receivers)]

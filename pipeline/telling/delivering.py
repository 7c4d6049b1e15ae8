"""Deliveries from the outbox to receivers, each with a few tries."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence

from pipeline.messages import counted
from pipeline.store.state import State
from pipeline.telling.delivery import Delivery, Receiver, UndeliveredError
from pipeline.telling.outbox import TOLD_ALARMS, Told, Waiting, waiting, was_refused, was_taken

# Waits before a delivery is tried again in the same run [s].
PAUSES_S = (1.0, 4.0)
# After so many failed deliveries the rest waits for the next run.
MOST_FAILURES = 3


def deliver(
    state: State,
    receivers: Sequence[Receiver],
    fleet: str,
    pause: Callable[[float], None] = time.sleep,
    told: Told = TOLD_ALARMS,
) -> tuple[str, ...]:
    """Deliver what waits in the outbox, where each delivery is noted at once; faults, as text.

    Raises StoreError if the outbox cannot be read or written: deliveries may then be repeated.
    """
    faults = []
    for receiver in receivers:
        fault = _deliver_to(state, receiver, fleet, told, pause)
        if n := sum(len(one.changes) for one in waiting(state, receiver.name, told)):
            faults.append(f"{receiver.label}: {fault}; for the next run: {counted(n, 'change')}")
    return tuple(faults)


def _deliver_to(
    state: State, receiver: Receiver, fleet: str, told: Told, pause: Callable[[float], None]
) -> str:
    """Deliver what waits for a receiver; the last fault, empty without one.

    One that failed in the run before, or hangs, gets one try for each: a dead one costs a run
    little, and a delivery that it never takes does not hold up the others.
    """
    name = receiver.name
    where = "WHERE topic = ? AND receiver = ?"
    rows = state.rows(f"SELECT fault FROM queues {where}", told.topic, name)
    fault = rows[0][0] if rows else ""
    failures, pauses = 0, () if fault else PAUSES_S
    for one in waiting(state, name, told):
        try:
            _take(receiver, _delivery(one, fleet, told), pauses, pause)
        except UndeliveredError as error:
            pauses, failures, fault = (), failures + 1, error.why
            was_refused(state, name, one, fault, told)
            if error.hung or failures == MOST_FAILURES:
                break
        else:
            was_taken(state, name, one, told)
    return fault


def _take(
    receiver: Receiver,
    delivery: Delivery,
    pauses: Sequence[float],
    pause: Callable[[float], None],
) -> None:
    for seconds in pauses:
        try:
            return receiver.take(delivery)
        except UndeliveredError as error:
            if error.hung:
                raise
        pause(seconds)
    return receiver.take(delivery)


def _delivery(one: Waiting, fleet: str, told: Told) -> Delivery:
    kind = one.kind or told.table.name
    document = {"id": one.id, "type": kind, "fleet": fleet, "changes": one.changes}
    return Delivery(one.id, json.dumps(document, sort_keys=True).encode())

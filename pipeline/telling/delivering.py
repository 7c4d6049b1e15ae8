"""Deliveries from the outbox to receivers, each with a few tries."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.messages import counted
from pipeline.telling.delivery import Delivery, Receiver, UndeliveredError
from pipeline.telling.outbox import (
    TOLD_ALARMS,
    Outbox,
    Queue,
    Told,
    Waiting,
    read_outbox,
    write_outbox,
)

# Waits before a delivery is tried again in the same run [s].
PAUSES_S = (1.0, 4.0)
# After so many failed deliveries the rest waits for the next run.
MOST_FAILURES = 3


def deliver(
    output: Path,
    receivers: Sequence[Receiver],
    fleet: str,
    pause: Callable[[float], None] = time.sleep,
    told: Told = TOLD_ALARMS,
) -> tuple[str, ...]:
    """Deliver what waits in the outbox, which is written after each delivery; faults, as text.

    Raises StoreError if the outbox cannot be read or written: deliveries may then be repeated.
    """
    folder, faults = output / told.folder, []
    outbox = read_outbox(folder) or Outbox()
    for receiver in receivers:
        if receiver.name not in outbox.queues:
            continue
        for queue in _after_each(outbox.queues[receiver.name], receiver, fleet, told, pause):
            outbox = replace(outbox, queues={**outbox.queues, receiver.name: queue})
            write_outbox(folder, outbox)
        left = outbox.queues[receiver.name]
        if left.waiting:
            n = sum(len(one.changes) for one in left.waiting)
            faults.append(
                f"{receiver.label}: {left.fault}; for the next run: {counted(n, 'change')}"
            )
    return tuple(faults)


def _after_each(
    queue: Queue, receiver: Receiver, fleet: str, told: Told, pause: Callable[[float], None]
) -> Iterator[Queue]:
    """The queue after each delivery that was tried; a failed one goes to its end.

    A receiver that failed in the run before, or hangs, gets one try for each: a dead one costs a
    run little, and a delivery that it never takes does not hold up the others.
    """
    failures, pauses = 0, () if queue.fault else PAUSES_S
    for one in queue.waiting:
        rest = tuple(other for other in queue.waiting if other is not one)
        try:
            _take(receiver, _delivery(one, fleet, told), pauses, pause)
        except UndeliveredError as error:
            pauses, failures = (), failures + 1
            queue = replace(queue, waiting=(*rest, one), fault=error.why)
            yield queue
            if error.hung or failures == MOST_FAILURES:
                return
        else:
            queue = replace(queue, waiting=rest, fault=queue.fault if rest else "")
            yield queue


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

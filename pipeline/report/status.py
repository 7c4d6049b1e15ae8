"""The fleet's state as published."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.errors import UsageError
from pipeline.intraday.rows import intraday_statuses
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import Backlog, backlogs
from pipeline.schema import ALARMS
from pipeline.store.heartbeat import Beat, last_good_run, read_heartbeat
from pipeline.store.published import TableFault, faults_of
from pipeline.store.tables import read_rows
from pipeline.trends.rows.alarm_rows import what_of
from pipeline.trends.rows.motor_states import MotorState, published_states, urgency


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """All motors, those that need attention first."""

    motors: tuple[MotorState, ...]
    # When the last run ended that went through all motors; None where none did.
    last_good_run: dt.datetime | None
    beat: Beat | None = None  # heartbeat of the current or the last run; None before the first
    receivers: tuple[Backlog, ...] = ()  # changes of state not yet delivered, by receiver
    # Published files that are gone, or were written to since and are not what was published.
    damage: tuple[TableFault, ...] = ()


def fleet_status(
    output: Path, motor_ids: Sequence[str], receivers: Sequence[Receiver] = ()
) -> FleetStatus:
    """The state of some motors, and undelivered changes by receiver.

    Raises StoreError if a table is damaged.
    """
    motors = current_states(output, motor_ids)
    return FleetStatus(
        tuple(sorted(motors, key=urgency)),
        last_good_run(output),
        read_heartbeat(output),
        backlogs(output, receivers),
        faults_of(output),
    )


def current_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors as the last run left them, with their intraday check.

    Raises StoreError if a table is damaged.
    """
    intraday = intraday_statuses(output, motor_ids)
    found = published_states(output, motor_ids)
    return [replace(one, intraday=intraday.get(one.motor_id)) for one in found]


def last_alarm(output: Path, motor_id: str, indicator: str, states: Collection[str]) -> dt.date:
    """The night of the last alarm of an indicator in one of some states.

    Raises UsageError (``no_alarm``) if there was none; the message lists the alarms so far.
    """
    rows = read_rows(output, ALARMS, [motor_id], ("night", "cause", "to_state")).to_dicts()
    raised: list[tuple[str, dt.date]] = [
        (what_of(row), row["night"]) for row in rows if row["to_state"] in states
    ]
    nights = [night for what, night in raised if what == indicator]
    if not nights:
        named = ", ".join(sorted({what for what, _ in raised})) or "none"
        raise UsageError(
            "no_alarm", f"{motor_id} has had no alarm of {indicator!r}; alarms so far: {named}"
        )
    return max(nights)

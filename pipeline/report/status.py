"""The fleet's state as published."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.config.hashes import DRAIN_DELAY
from pipeline.errors import UsageError
from pipeline.intraday.rows import intraday_statuses
from pipeline.logs.processed import read_settings, read_stays, stay_lines
from pipeline.messages import counted
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import Backlog, backlogs
from pipeline.schema import (
    AGREEING_S,
    ALARMS,
    DECIDING_NIGHTS,
    FAILED,
    FITS,
    LAG_COLUMNS,
    NIGHTS,
    agreed_lag,
)
from pipeline.store.heartbeat import Beat, last_good_run, read_heartbeat
from pipeline.store.published import TableFault, faults_of
from pipeline.store.state import read_state_file
from pipeline.store.tables import read_rows
from pipeline.trends.decisions import read_decisions
from pipeline.trends.motor_states import MotorState, published_states, urgency, what_of

# Failed nights of a motor that are listed, the newest.
MOST_FAILED = 3


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
    standing: tuple[str, ...] = ()  # what failed, or stays as published, until somebody acts

    @property
    def newest_sample(self) -> dt.datetime | None:
        """Newest sample of all motors."""
        return max(filter(None, (motor.row["last_sample"] for motor in self.motors)), default=None)


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
        tuple(standing(output, motor_ids)),
    )


def current_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors as the last run left them, with their intraday check.

    Raises StoreError if a table is damaged.
    """
    intraday = intraday_statuses(output, motor_ids)
    states = published_states(output, motor_ids)
    return [replace(state, intraday=intraday.get(state.motor_id)) for state in states]


def standing(output: Path, motor_ids: Sequence[str]) -> Iterator[str]:
    """Yield in words what stands until somebody acts: failed nights, logs that are gone."""
    with read_state_file(output) as state:
        stays, gone = read_stays(state, motor_ids)
        settings = read_settings(state)
    decisions = read_decisions(output)
    excluded = {
        (decision.motor_id, decision.night) for decision in decisions if decision.kind == "excluded"
    }
    by_motor = failed_nights(output, motor_ids)
    failures = {
        motor_id: {label: why for label, why in nights.items() if (motor_id, label) not in excluded}
        for motor_id, nights in by_motor.items()
    }
    for motor_id, failed in failures.items():
        for label in sorted(failed)[-MOST_FAILED:]:
            yield f"{motor_id}: night of {label} failed: {failed[label]}"
        if (more := len(failed) - MOST_FAILED) > 0:
            yield f"{motor_id}: and {counted(more, 'night')} before"
        yield from (f"{motor_id}: {line}" for line in stay_lines(stays[motor_id]))
        if n := gone.get(motor_id):
            yield f"{motor_id}: {counted(n, 'published night')} without a log any more"
    yield from _proposed_delays(output, settings)
    if any(failures.values()):
        yield (
            "a failed night: mend its log or the config, or remove the log, then fit-fleet "
            "--retry; or ack --night"
        )


def _proposed_delays(output: Path, settings: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield delays of drain flows on which the newest nights agree, other than the delay in use."""
    decided = {name: own[DRAIN_DELAY] for name, own in settings.items() if DRAIN_DELAY in own}
    columns = ("motor_id", "night", *LAG_COLUMNS)
    fits = read_rows(output, FITS, sorted(decided), columns).drop_nulls().unique(columns[:2])
    for (motor_id,), rows in fits.sort(columns[:2]).group_by("motor_id", maintain_order=True):
        newest = rows.tail(DECIDING_NIGHTS)
        lag = agreed_lag(newest.to_dicts()) if len(newest) == DECIDING_NIGHTS else None
        if lag is not None and abs(lag[0] - decided[motor_id]) > AGREEING_S:
            yield (
                f"{motor_id}: in the last {DECIDING_NIGHTS} nights the drain flow lags by "
                f"{lag[0]:.1f} s (explains {lag[1]:.0f} % more of it), paired are "
                f"{decided[motor_id]:.1f} s; to pair all nights so: fit-fleet --redo "
                f"{newest['night'][0]}..{newest['night'][-1]} --motors {motor_id}"
            )


def failed_nights(output: Path, motor_ids: Sequence[str]) -> dict[str, dict[dt.date, str]]:
    """Return why nights of some motors failed, in words, by motor and night."""
    columns = ("motor_id", "night", "status", "error_code", "reason")
    rows = read_rows(output, NIGHTS, motor_ids, columns).filter(status=FAILED).sort("night")
    failed: dict[str, dict[dt.date, str]] = {motor_id: {} for motor_id in motor_ids}
    for row in rows.iter_rows(named=True):
        failed[row["motor_id"]][row["night"]] = f"{row['error_code']}: {row['reason']}"
    return failed


def last_alarm(output: Path, motor_id: str, indicator: str, states: Collection[str]) -> dt.date:
    """The night of the last alarm of an indicator in any of some states.

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

"""A look at a fleet: every motor's new minutes, the rows of `looks`, and who is told of them.

A look holds a lock of its own and never that of the nightly run. Rows are published first, then a
motor's state is kept, then receivers are told: a look that is broken off anywhere is done again by
the next one, with the same rows.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pipeline.clock import latest_us, microseconds, now, utc
from pipeline.config import Fleet, MotorSpec
from pipeline.config.hashes import config_hash, hash_of, own_version
from pipeline.errors import MotorLeakageError, StoreError
from pipeline.look.comparison import nights_before
from pipeline.look.motor import Row, looked_at, verdicts, without_watch
from pipeline.look.state import LookState, read_states, write_state
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import TOLD_LOOKS, deliver, open_outbox, take_up
from pipeline.notification.receivers import receivers_of
from pipeline.schema import LOOKS
from pipeline.store.locks import locked
from pipeline.store.publishing import Publisher
from pipeline.store.state import State, open_state
from pipeline.trends.nights.decisions import Decision, read_decisions
from pipeline.trends.nights.trend_record import read_kept
from pipeline.trends.sentences import in_percent
from pipeline.trends.tasks import circuits_of, decisions_of
from pipeline.workers.process import one_thread

log = logging.getLogger(__name__)

WHAT_TO_DO = "look at the motor and its drain filter now, and compare the drain flow by hand"


@dataclass(frozen=True, slots=True)
class MotorLook:
    """Result of a look at a motor."""

    motor_id: str
    state: LookState  # after it
    rows: tuple[Row, ...] = ()  # new rows of `looks`, without ``run_id``
    fault: str = ""  # why it could not be looked at; empty where it was


def look_at_fleet(
    fleet: Fleet, motors: Sequence[str] = (), clock: dt.datetime | None = None
) -> tuple[MotorLook, ...]:
    """Look once at the motors of a fleet, all if none is named; one that fails costs no other.

    Its logs lie in a folder. The looks are sorted by motor.

    Raises LockedError if another look is under way; StoreError if nothing can be published.
    """
    output, receivers = fleet.output, receivers_of(fleet.settings.alarms)
    wanted = [one for one in fleet.motors if not motors or one.motor_id in motors]
    with locked(output / "look"), open_state(output) as state, one_thread():
        open_outbox(state, [one.name for one in receivers], fleet.name, TOLD_LOOKS)
        said = decisions_of(wanted, read_decisions(output))
        found: list[MotorLook] = []
        for group in circuits_of(wanted):
            found += _look_at_circuit(state, group, said, clock or now())
        _tell(state, receivers, fleet.name)
    return tuple(sorted(found, key=lambda one: one.motor_id))


def _look_at_circuit(
    kept: State,
    specs: Sequence[MotorSpec],
    said: Mapping[str, Sequence[Decision]],
    clock: dt.datetime,
) -> list[MotorLook]:
    """Look at the motors of an oil circuit, publish their rows, and keep their states."""
    known = read_states(kept)
    before = {one.motor_id: known.get(one.motor_id, LookState()) for one in specs}
    looks = {
        one.motor_id: _looked_at(kept, one, before[one.motor_id], said[one.motor_id], clock)
        for one in specs
    }
    found = []
    for spec in specs:
        motor_id = spec.motor_id
        after, changes, fault = looks[motor_id]
        others = [one[0] for name, one in looks.items() if name != motor_id]
        rows = [_said(motor_id, row, others) for row in changes]
        if rows:
            if rows[-1]["to_state"] == after.state:
                after = replace(after, reason=rows[-1]["reason"])
            run_id = hash_of({"version": own_version(), "config": config_hash(spec)})
            publish_looks(kept, rows, run_id)
        if after is not before[motor_id]:
            write_state(kept, motor_id, after)
        found.append(MotorLook(motor_id, after, tuple(rows), fault))
    return found


def _looked_at(
    kept: State,
    spec: MotorSpec,
    before: LookState,
    said: Sequence[Decision],
    clock: dt.datetime,
) -> tuple[LookState, list[Row], str]:
    """State and changes of a motor; where it cannot be looked at, it stays as it was."""
    try:
        output = kept.output
        known = nights_before(output, spec, said, read_kept(kept, spec.motor_id))
        if isinstance(known, str):
            return *without_watch(before, known), ""
        state, given = verdicts(output, spec, known, before)
        now_us = microseconds(clock)
        state, changes = looked_at(spec, known, state, now_us, latest_us(clock))
    except MotorLeakageError as error:
        return before, [], f"{error.code}: {error}"
    except Exception as error:  # one motor must not cost the others their look
        log.exception("motor %s cannot be looked at", spec.motor_id)
        return before, [], f"internal: {error}"
    return state, [*given, *changes], ""


def _said(motor_id: str, row: Row, others: Sequence[LookState]) -> Row:
    """A row with its motor, and words on a rise that is told."""
    if row["verdict"] == "told":
        percent = (row["change_percent"], row["change_lower"], row["change_upper"])
        row["reason"] = (
            f"drain flow {in_percent(0, *percent)} above the nights before since "
            f"{row['since']:%Y-%m-%d %H:%M} UTC, told at {row['time']:%H:%M}; "
            f"{_circuit_words(row, others)}{WHAT_TO_DO}"
        )
    return {"motor_id": motor_id} | row


def _circuit_words(row: Row, others: Sequence[LookState]) -> str:
    """Whether the other motors of the oil circuit have moved alike, in words."""
    if not others:
        return ""
    latest = [one.latest for one in others if utc(one.judged_us) > row["since"]]
    if not latest:
        return "the other motors of its oil circuit say nothing of that time; "
    alike = sum(200.0 * one >= row["change_percent"] for one in latest)
    if alike == len(latest):
        return (
            "all motors of its oil circuit that run have risen alike: oil, temperature or charge "
            "pressure rather than this motor; "
        )
    return f"{alike} of {len(latest)} other motors of its oil circuit have risen alike; "


def publish_looks(state: State, rows: Sequence[Row], run_id: str) -> None:
    """Publish rows of `looks`, which no nightly run writes.

    Raises StoreError if they cannot be published.
    """
    by_month: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_month[f"{row['time']:%Y-%m}"].append(row | {"run_id": run_id})
    for month, some in by_month.items():
        Publisher(state, state.output, run_id).add(month, {LOOKS: some})


def _tell(state: State, receivers: Sequence[Receiver], fleet: str) -> None:
    """Queue and deliver what is new; what fails waits for the next look."""
    try:
        take_up(state, fleet, TOLD_LOOKS)
        for fault in deliver(state, receivers, fleet, told=TOLD_LOOKS):
            log.warning("%s", fault)
    except StoreError as error:
        log.warning("looks: %s; the next look tells of them", error)

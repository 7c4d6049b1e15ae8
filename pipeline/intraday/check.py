"""The intraday check of a fleet: each motor's night so far, rows of `intraday`, and notifications.

A check holds a lock against another check, and never that of the nightly run.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from leakage import LeakageError
from leakage.watch.choices import INTRADAY_SHARE
from leakage.watch.intraday import Rise, is_going_on, rise_of, rises_so_far, sudden_rise
from leakage.watch.nights import Estimate, NightBlocks
from pipeline.clock import latest_us, microseconds
from pipeline.config import Fleet, MotorSpec
from pipeline.config.hashes import config_hash, hash_of, own_version
from pipeline.config.nights import night as night_labelled
from pipeline.config.nights import night_of
from pipeline.errors import LogError, MotorLeakageError, StoreError
from pipeline.intraday.night_so_far import (
    NightsBefore,
    blocks_so_far,
    nights_before,
    read_so_far,
)
from pipeline.intraday.rows import (
    CONFIRMED,
    NOT_JUDGED,
    WITHDRAWN,
    last_rows,
    publish_rows,
    row_of,
)
from pipeline.logs.processed import as_published, read_processed, read_settings
from pipeline.night.time_base import Insufficient
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import OF_INTRADAY, deliver, open_outbox, receivers_of
from pipeline.schema import BLOCKS, Row
from pipeline.store.atomic_files import locked
from pipeline.store.state import StateDatabase, open_state
from pipeline.store.tables import nights_back
from pipeline.trends.decisions import Decision, read_decisions
from pipeline.trends.motor_states import CLEAR, RISEN
from pipeline.trends.sentences import in_percent
from pipeline.trends.tasks import circuits_of, decisions_of, read_checkpoint
from pipeline.workers.process import one_thread

log = logging.getLogger(__name__)

WHAT_TO_DO = "look at the motor and its drain filter now, and compare the drain flow by hand"
# Nights behind that of a rise that may still say whether it was real.
MOST_NIGHTS = 7


@dataclass(frozen=True, slots=True)
class MotorCheck:
    """Result of a check of a motor: `clear`, `risen` or `not_judged`, and why."""

    motor_id: str
    state: str
    reason: str
    rows: tuple[Row, ...] = ()  # new rows of `intraday`
    end_us: int = 0  # end of what was judged [µs since 1970]; 0 where nothing was
    latest: float = 0.0  # rise of the latest minutes
    fault: str = ""  # why it could not be checked; empty where it was


def check_fleet(fleet: Fleet, motors: Sequence[str] = ()) -> tuple[MotorCheck, ...]:
    """Check the motors of a fleet once, all if none is named; a failure costs no other.

    Raises LockedError if another check is under way; StoreError if nothing can be published.
    """
    receivers = receivers_of(fleet.settings.alarms)
    wanted = [motor for motor in fleet.motors if not motors or motor.motor_id in motors]
    with locked(fleet.output / "look"), open_state(fleet.output) as state, one_thread():
        open_outbox(state, [receiver.name for receiver in receivers], OF_INTRADAY)
        decisions = decisions_of(wanted, read_decisions(fleet.output))
        last = last_rows(fleet.output, [spec.motor_id for spec in wanted])
        checked = list[MotorCheck]()
        for specs in circuits_of(wanted):
            checks = [
                check_motor(state, spec, decisions[spec.motor_id], last.get(spec.motor_id))
                for spec in specs
            ]
            checks = [_with_circuit(check, checks) for check in checks]
            for spec, check in zip(specs, checks, strict=True):
                publish_rows(state, check.rows, _run_id(spec))
            checked += checks
        _deliver(fleet, state, receivers)
    return tuple(sorted(checked, key=lambda check: check.motor_id))


def check_motor(
    state: StateDatabase,
    spec: MotorSpec,
    decisions: Sequence[Decision],
    last: Row | None,
) -> MotorCheck:
    """Check a motor; where it cannot be judged, it stays as it was."""
    motor_id = spec.motor_id
    try:
        spec = as_published(spec, read_settings(state).get(motor_id))
        known = read_processed(state, motor_id).files
        night, channels = read_so_far(spec, known, latest_us())
        before = nights_before(
            state.output, spec, decisions, read_checkpoint(state, motor_id), night.date
        )
        blocks, end_us = blocks_so_far(spec, before.watch_columns, night, channels)
        return judge(spec, before, blocks, end_us, last)
    except (Insufficient, LeakageError, LogError) as why:
        reason = getattr(why, "reason", str(why))
        return MotorCheck(motor_id, NOT_JUDGED, reason)
    except MotorLeakageError as error:
        return MotorCheck(motor_id, NOT_JUDGED, str(error), fault=f"{error.code}: {error}")
    except Exception as error:  # one motor must not cost the others their check
        log.exception("motor %s cannot be checked", motor_id)
        return MotorCheck(motor_id, NOT_JUDGED, str(error), fault=f"internal: {error}")


def judge(
    spec: MotorSpec, before: NightsBefore, blocks: NightBlocks, end_us: int, last: Row | None
) -> MotorCheck:
    """Judge the night so far of a motor, whose last row of `intraday` may hold a rise."""
    rises = rises_so_far(before.watch, blocks, before.merged)
    latest = rises[0].change
    check = MotorCheck(
        spec.motor_id,
        CLEAR,
        f"drain flow {_in_words(latest)} against the nights before",
        end_us=end_us,
        latest=latest.value,
    )
    if last is not None and last["to_state"] in (RISEN, CONFIRMED):
        if is_going_on(rises, last["change_percent"] / 100.0):
            return replace(check, state=RISEN)
        reason = "the drain flow is back, or the nights have taken up its change"
        return _moved(check, last, CLEAR, reason)
    rise = sudden_rise(rises)
    if rise is None:
        return check
    changed = before.columns_changed(spec, blocks)
    if changed is not None:
        return replace(check, state=NOT_JUDGED, reason=changed)
    reason = f"drain flow {_in_words(rise.change)} above the nights before"
    return _moved(check, last, RISEN, reason, rise)


def _moved(
    check: MotorCheck, last: Row | None, state: str, reason: str, rise: Rise | None = None
) -> MotorCheck:
    before = CLEAR if last is None else last["to_state"]
    change = None if rise is None else rise.change
    row = row_of(check.motor_id, check.end_us, (before, state), reason, change)
    return replace(check, state=state, reason=reason, rows=(row,))


def _with_circuit(check: MotorCheck, circuit: Sequence[MotorCheck]) -> MotorCheck:
    """Return check whose new rise says whether the circuit's other motors have risen alike."""
    if not check.rows or check.state != RISEN:
        return check
    (row,) = check.rows
    others = [other for other in circuit if other is not check and other.end_us]
    alike = sum(200.0 * other.latest >= row["change_percent"] for other in others)
    words = f"{alike} of {len(others)} other motors of its oil circuit have risen alike; "
    if others and alike == len(others):
        words = (
            "all motors of its oil circuit that run have risen alike: oil, temperature or charge "
            "pressure rather than this motor; "
        )
    reason = f"{row['reason']}; {words if others else ''}{WHAT_TO_DO}"
    return replace(check, reason=reason, rows=(row | {"reason": reason},))


def settle_rises(fleet: Fleet, state: StateDatabase, rises: Mapping[str, Row]) -> None:
    """Let published nights confirm or withdraw reported rises, and deliver it.

    Raises LockedError while a check is under way; StoreError.
    """
    specs = [motor for motor in fleet.motors if motor.motor_id in rises]
    decisions = decisions_of(specs, read_decisions(fleet.output))
    receivers = receivers_of(fleet.settings.alarms)
    with locked(fleet.output / "look"):
        open_outbox(state, [receiver.name for receiver in receivers], OF_INTRADAY)
        for spec in specs:
            row = _settle(state, spec, decisions[spec.motor_id], rises[spec.motor_id])
            publish_rows(state, [] if row is None else [row], _run_id(spec))
        _deliver(fleet, state, receivers)


def _deliver(fleet: Fleet, state: StateDatabase, receivers: Sequence[Receiver]) -> None:
    """Deliver new rows; what fails waits for the next check."""
    try:
        for fault in deliver(state, receivers, fleet.name, OF_INTRADAY):
            log.warning("%s", fault)
    except StoreError as error:
        log.warning("intraday check: %s; the next check delivers it", error)


def _settle(
    state: StateDatabase, spec: MotorSpec, decisions: Sequence[Decision], last: Row
) -> Row | None:
    """Return the row by which a published night settles a rise; None: none says anything yet."""
    spec = as_published(spec, read_settings(state).get(spec.motor_id))
    time_us, nights = microseconds(last["time"]), spec.settings.nights
    first = night_of(time_us, nights)
    published = [night for night in nights_back(state.output, BLOCKS) if night >= first]
    begins = [event.date for event in spec.file.baseline_events]
    begins += [decision.night for decision in decisions if decision.kind == "baseline_reset"]
    if any(first < begin <= max(published, default=first) for begin in begins):
        reason = "a new baseline has begun since: no night says whether it was one"
        return row_of(spec.motor_id, time_us + 1, (RISEN, CLEAR), reason)
    for label in sorted(published)[:MOST_NIGHTS]:
        try:
            before = nights_before(
                state.output, spec, decisions, read_checkpoint(state, spec.motor_id), label
            )
        except Insufficient:
            return None
        blocks = before.blocks_of(state.output, spec, label, time_us)
        if blocks is None:
            continue
        change = rise_of(before.watch, blocks).change
        is_so = change.value >= INTRADAY_SHARE * last["change_percent"] / 100.0
        verdict = CONFIRMED if is_so else WITHDRAWN
        reason = (
            f"{verdict} by the night of {label}: drain flow {_in_words(change)} against the nights "
            f"before, reported was {last['change_percent']:+.0f} %"
        )
        end_us = night_labelled(label, nights).end_us
        return row_of(spec.motor_id, end_us, (RISEN, verdict), reason, change, label)
    return None


def _in_words(change: Estimate) -> str:
    return in_percent(*(100.0 * end for end in (change.value, change.lower, change.upper)))


def _run_id(spec: MotorSpec) -> str:
    return hash_of({"version": own_version(), "config": config_hash(spec)})

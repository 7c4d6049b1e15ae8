"""The intraday check of a fleet: each motor's night so far, rows of `intraday`, and notifications.

A check holds a lock against another check, and never that of the nightly run.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leakage import LeakageError
from leakage.watch import NightBlocks, Watch
from leakage.watch.choices import INTRADAY_SHARE
from leakage.watch.intraday import Rise, is_going_on, rise_of, rises_so_far, sudden_rise
from leakage.watch.nights import Estimate
from pipeline.arrays import SECOND_US
from pipeline.clock import latest_us, microseconds
from pipeline.config import Fleet, MotorSpec
from pipeline.config.hashes import config_hash, hash_of, own_version
from pipeline.config.nights import DAY, Night, night_of, nights_between
from pipeline.config.nights import night as night_labelled
from pipeline.config.settings import BLOCK_S
from pipeline.errors import LogError, MotorLeakageError, StoreError
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.intraday.rows import (
    CONFIRMED,
    NOT_JUDGED,
    WITHDRAWN,
    last_rows,
    publish_rows,
    row_of,
)
from pipeline.logs.files import reaches_us, slice_night, stat_log, with_span
from pipeline.logs.finding import find_logs
from pipeline.logs.processed import FileRecord, as_published, read_processed, read_settings
from pipeline.night.column_change import COLUMNS, USUAL_NIGHTS, column_change, usual_readings
from pipeline.night.fit_night import (
    choose_parts,
    clean_channels,
    require_enough,
    require_parts,
)
from pipeline.night.sample_rows import block_rows
from pipeline.night.statistics import BLOCK_COLUMNS, block_frame, night_statistics, sensor_ratio
from pipeline.night.time_base import Insufficient
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import OF_INTRADAY, deliver, open_outbox, receivers_of
from pipeline.schema import BLOCKS, Row
from pipeline.store.atomic_files import locked
from pipeline.store.state import StateDatabase, open_state
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.checkpoint import decode, key_of
from pipeline.trends.course import Course, watch_settings
from pipeline.trends.decisions import Decision, read_decisions
from pipeline.trends.motor_states import CLEAR, RISEN
from pipeline.trends.nights import read_blocks, read_nights
from pipeline.trends.sentences import in_percent
from pipeline.trends.tasks import (
    Record,
    TrendMotor,
    circuits_of,
    decisions_of,
    read_checkpoint,
    trend_hash,
)
from pipeline.trends.watch_columns import WatchColumns
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


# The night so far, with the cleaning, blocks and watch of the nightly run

# Latest samples are left out: what follows may be a halt, and its guard time reaches back [µs].
SETTLE_US = 30 * SECOND_US
# Latest samples of a channel that say how far it goes: a single wrong stamp does not.
LATEST = 5
# After a pause as long, blocks are left out for as long: oil and motor are cold [µs].
WARM_UP_US = 20 * 60 * SECOND_US
FEWEST_BLOCKS = 2


def read_so_far(
    spec: MotorSpec, known: Mapping[str, FileRecord], latest_us: int
) -> tuple[Night, dict[str, RawChannel]]:
    """Return the night of the newest samples in a motor's logs, and its channels.

    `known` are the logs as the last nightly run read them; where none is new, there is no night so
    far.

    Raises Insufficient if there are no new samples.
    """
    nights, faults = spec.settings.nights, list[str]()
    logs = list[RawLog]()
    for path in _newest_logs(spec, known, latest_us, faults):
        try:
            logs.append(read_log(path, spec.file.logs, spec.file.channels, latest_us))
        except LogError as error:
            faults.append(error.message)
    stamps = [
        channel.time_us for log in logs for channel in log.channels.values() if len(channel.time_us)
    ]
    if not stamps:
        raise Insufficient("", faults[-1] if faults else "no new samples since the nightly run")
    newest_us = max(int(np.median(some[-LATEST:])) for some in stamps)
    night = night_labelled(night_of(newest_us, nights), nights)
    return night, slice_night(logs, night, reaches_us(spec))


def _newest_logs(
    spec: MotorSpec, known: Mapping[str, FileRecord], latest_us: int, faults: list[str]
) -> list[Path]:
    """Return logs of the newest night and the day before, by their ends; none without a new log."""
    ends, is_new = dict[Path, int](), False
    for name, path in find_logs(spec)[0].items():
        record, before = stat_log(name, path), known.get(name)
        if before is not None and _state(before) == _state(record):
            record = before
        elif record.status == "ok":
            record, is_new = with_span(record, path, spec, latest_us), True
        if record.last_us is not None:
            ends[path] = record.last_us
        elif record.message:
            faults.append(record.message)
    if not is_new or not ends:
        return []
    nights = spec.settings.nights
    label = night_of(max(ends.values()), nights)
    first_us = night_labelled(label - DAY, nights).start_us
    in_order = sorted(ends, key=lambda path: (ends[path], path))
    return [path for path in in_order if ends[path] >= first_us]


def _state(record: FileRecord) -> tuple[int, int]:
    """Return what differs where a log was written to."""
    return record.size, record.modified_ns


def blocks_so_far(
    spec: MotorSpec, watch_columns: WatchColumns, night: Night, channels: dict[str, RawChannel]
) -> tuple[NightBlocks, int]:
    """Return short blocks of a warm motor, by the night's own rules, and their end [µs].

    Raises Insufficient or LeakageError where they say nothing.
    """
    samples, quality = clean_channels(spec.file, spec.settings, night, channels)
    require_enough(samples, quality)
    samples = samples.only(samples.time_us <= samples.time_us[-1:] - SETTLE_US)
    samples, outside = choose_parts(spec.file, night, samples)
    require_parts(samples, outside)
    motor = spec.stated.motor(night.date, spec.file.flushing.mode)
    ratio = sensor_ratio(motor.oil, samples)
    # Blocks are not merged: what follows is not there yet.
    statistics = night_statistics(spec.stated, motor, night, samples, is_merged=False)
    rows = block_rows(spec, night.date, motor, statistics, ratio)
    begins = np.array([block.start_us for block in statistics.blocks])
    warm = _warm(begins, night.start_us)
    if np.count_nonzero(warm) < FEWEST_BLOCKS:
        raise Insufficient("", "the motor has not run for long enough yet")
    stored = block_frame([row for row, is_warm in zip(rows, warm, strict=True) if is_warm])
    blocks = watch_columns.blocks(spec, stored)
    if blocks is None:
        raise Insufficient("", "the nights before are of another model")
    return watch_columns.night_blocks(blocks), statistics.blocks[-1].end_us


def _warm(begins_us: np.ndarray, night_start_us: int) -> np.ndarray:
    """Return blocks that do not follow a start of the motor; over the night's border it ran on."""
    pause = np.diff(begins_us, prepend=night_start_us) >= WARM_UP_US
    started = np.maximum.accumulate(np.where(pause, begins_us, night_start_us - WARM_UP_US))
    return begins_us - started >= WARM_UP_US


@dataclass(frozen=True, slots=True)
class NightsBefore:
    """Watch of a motor after the last published night before another."""

    watch: Watch
    watch_columns: WatchColumns
    merged: int  # short blocks in a longer as the nights store it
    usual: Mapping[str, float]  # as of `usual_readings`

    def columns_changed(self, spec: MotorSpec, blocks: NightBlocks) -> str | None:
        """Return why blocks look like those of other columns or units than the nights before."""
        change = column_change(spec, self.usual, _readings(blocks)) if self.usual else None
        return change and change.words

    def blocks_of(
        self, output: Path, spec: MotorSpec, label: dt.date, begin_us: int
    ) -> NightBlocks | None:
        """Return published blocks of a night from a time on; its last one where it ends before."""
        rows = read_rows(output, BLOCKS, [spec.motor_id], BLOCK_COLUMNS, nights=[label])
        stored = self.watch_columns.blocks(spec, rows) if rows.height else None
        if stored is None:
            return None
        blocks = self.watch_columns.night_blocks(stored)
        is_late = stored.rows["block_end"].dt.timestamp("us").to_numpy() > begin_us
        is_late[-1] = True
        parts = (blocks.middle_s, blocks.drives, blocks.flow, blocks.conditions)
        return NightBlocks(blocks.day, *(part[is_late] for part in parts))


def nights_before(
    output: Path,
    spec: MotorSpec,
    decisions: Sequence[Decision],
    content: bytes | None,
    label: dt.date,
) -> NightsBefore:
    """Return the watch before a night, by what the last nightly run left of it.

    Raises Insufficient if there is none; StoreError if a published table is damaged.
    """
    checkpoint, trends, last = decode(content), trend_hash(spec, decisions), label - DAY
    if checkpoint is None:
        raise Insufficient("", "the nightly run has not published a night yet")
    if checkpoint.key != key_of(trends):
        raise Insufficient("", "settings, events or resets have changed: the nightly run redoes it")
    record = Record(trends, checkpoint.last_night)
    motor = TrendMotor(spec, tuple(decisions), record, trends, label, last, content)
    nights = read_nights(output, [(motor,)], with_rows=False).get(spec.motor_id)
    course = nights and Course.of(output, nights)
    if not course:
        raise Insufficient("", "there is no night before")
    while course.nights_to_come:
        course.step()
    needed, watch = watch_settings(spec).baseline_nights, course.watch
    if watch is None:
        raise Insufficient("", f"{len(course.waiting)} of {needed} nights of a baseline")
    watched = dt.date.fromordinal(watch.day)
    if any(watched < event.date <= label for event in spec.file.changes):
        raise Insufficient("", "an event is dated on it: the nightly run judges it first")
    watch_columns, begin = course.nights.watch_columns, course.nights.labels[course.period.first]
    usual = nights_between(max(label - USUAL_NIGHTS * DAY, begin), last)
    before = read_blocks(output, spec, watch_columns, usual)
    apart = [
        float(np.median(np.diff(blocks.middle_s))) for blocks in before if len(blocks.flow) > 1
    ]
    merged = max(1, round(float(np.median(apart)) / BLOCK_S)) if apart else 1
    rows = [
        {COLUMNS[name]: value for name, value in _readings(blocks).items()} for blocks in before
    ]
    return NightsBefore(watch, watch_columns, merged, usual_readings(rows))


def _readings(blocks: NightBlocks) -> dict[str, float]:
    """Return mean readings of some blocks, by channel."""
    temperature, pressure, speed = blocks.conditions.mean(axis=0).tolist()
    readings = (pressure, temperature, speed, float(blocks.flow.mean()))
    return dict(zip(COLUMNS, readings, strict=True))

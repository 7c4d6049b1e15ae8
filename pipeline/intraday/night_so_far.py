"""The night so far of a motor: its logs up to now, as blocks; and its watch up to the night before.

The same cleaning, blocks and watch as the nightly run's.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leakage.watch import NightBlocks, Watch
from pipeline.arrays import SECOND_US
from pipeline.config import MotorSpec
from pipeline.config.nights import DAY, Night, night_of, nights_between
from pipeline.config.nights import night as night_labelled
from pipeline.config.settings import BLOCK_S
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, read_log
from pipeline.logs.files import reaches_us, slice_night, stat_log, with_span
from pipeline.logs.finding import find_logs
from pipeline.logs.processed import FileRecord
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
from pipeline.schema import BLOCKS
from pipeline.store.tables import read_rows
from pipeline.trends.checkpoint import decode, key_of
from pipeline.trends.course import Course, watch_settings
from pipeline.trends.decisions import Decision
from pipeline.trends.nights import read_blocks, read_nights
from pipeline.trends.tasks import Record, TrendMotor, trend_hash
from pipeline.trends.watch_columns import WatchColumns

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

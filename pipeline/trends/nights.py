"""Nights of motors as published: most by the checkpoint of a run before, the others read."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.special import ndtri

from leakage.estimation.blocks import merge
from leakage.estimation.identifiability import WITH_VALUE
from leakage.estimation.validation import agreement
from leakage.watch import Estimate, NightBlocks
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.nights import DAY, nights_between
from pipeline.config.nights import night as night_labelled
from pipeline.night.statistics import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import (
    ALARMS,
    BLOCKS,
    FAILED,
    FITS,
    INSUFFICIENT_DATA,
    LOG_FILES,
    NIGHTS,
    NO_NEW_DATA,
    OF_NIGHT,
    OK,
    PARAMETERS,
    Row,
    Table,
)
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.checkpoint import (
    OPERATED,
    MotorCheckpoint,
    Records,
    blank_records,
    decode,
    key_of,
)
from pipeline.trends.decisions import LEAKAGE, SENSORS, Decision
from pipeline.trends.tasks import Circuit, TrendMotor
from pipeline.trends.watch_columns import WatchColumns

# Nights whose blocks are in memory together.
NIGHTS_AT_ONCE = 32
NO_LOG = f"{NO_NEW_DATA.replace('_', ' ')}: no log covers this night"
OTHER_KIND = "its statistics are of another model"
FIT_COLUMNS = (
    *("motor_id", "night", "is_primary", "flushing_mode", "coefficients"),
    *("fitted_leakage_verdict", "fitted_leakage_l_per_min", "fitted_leakage_upper"),
)
PARAMETER_COLUMNS = (
    *("motor_id", "night", "flushing_mode", "parameter"),
    *("value", "lower", "upper", "verdict", "reason"),
)
FILE_COLUMNS = ("motor_id", "night", "message")
# Half of a 95 % interval over the standard error.
HALF = float(ndtri(0.975))
# The model of the night before is at most so old.
MODEL_AGE = 31 * DAY
# Nights without a log after which nothing is said of a motor until it has logs again.
LONGEST_SILENCE = 92
# Nights before, whose mean share of running hours a night without a log takes.
NIGHTS_BEFORE = 30
EVENT_WORDS = {
    "overhaul": "overhaul",
    "oil_change": "oil change",
    "meter_changed": "other flow meter",
    "sensor_changed": "other sensor",
    "flushing_change": "change of flushing",
    "motor_exchanged": "motor exchanged",
}
# What begins with a motor's first night.
FIRST_NIGHTS = "first nights"
OTHER_SETTINGS = "other settings from"


@dataclass
class PublishedNights:
    """A motor's nights as they are published, a record each, those without a log as well.

    The watch goes over the nights from `beginning` on; None where nobody needs it. `resumes`: it
    goes on from the checkpoint.
    """

    motor: TrendMotor
    checkpoint: MotorCheckpoint | None = None
    records: Records = field(default_factory=lambda: blank_records([]))
    beginning: dt.date | None = None
    resumes: bool = False
    # By night: rows of `nights` and of `fits`, of `parameters` by name, and what is said of log
    # files, of the nights that were read.
    rows: dict[dt.date, Row] = field(default_factory=dict)
    fits: dict[dt.date, Row] = field(default_factory=dict)
    parameters: dict[dt.date, dict[str, Row]] = field(default_factory=dict)
    messages: dict[dt.date, list[str]] = field(default_factory=dict)
    alarms: list[Row] = field(default_factory=list)  # what is published of the motor
    # By number of the day, from `beginning` on: the blocks, and the factor of all samples.
    blocks: dict[int, NightBlocks] = field(default_factory=dict)
    factors: dict[int, Array] = field(default_factory=dict)
    # Why the blocks of some nights do not count.
    excluded: dict[dt.date, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.records)

    @property
    def spec(self) -> MotorSpec:
        """The motor."""
        return self.motor.spec

    @cached_property
    def watch_columns(self) -> WatchColumns:
        """Its columns as the watch has them."""
        return WatchColumns.of(self.spec, self.motor.until)

    @property
    def rows_from(self) -> dt.date:
        """First night whose rows are read."""
        if self.checkpoint is None:
            return dt.date.min
        return min(self.motor.first or dt.date.max, self.checkpoint.last_night + DAY)

    @cached_property
    def labels(self) -> tuple[dt.date, ...]:
        """Labels of the nights."""
        return tuple(self.records["night"].tolist())

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Days since the first night, shape (n,)."""
        days = self.records["night"].astype(np.int64)
        since: NDArray[np.int64] = days - days[0]
        return since

    def place_from(self, date: dt.date) -> int:
        """Place of the first night from a date on; behind the last where there is none yet."""
        return int(np.searchsorted(self.records["night"], np.datetime64(date)))

    def running_hours(self, end: int) -> Array:
        """Return running hours since the first night; without a log the mean of the 30 before."""
        hours: Array = self.records["running_hours"][:end]
        logged = np.isfinite(hours)
        sums = np.concatenate([[0.0], np.cumsum(hours[logged])])
        # Logged nights before each night, and the mean of the last thirty of them.
        before = np.cumsum(logged) - logged
        first = np.maximum(before - NIGHTS_BEFORE, 0)
        usual = (sums[before] - sums[first]) / np.maximum(before - first, 1)
        whole: Array = np.cumsum(np.where(logged, hours, usual))
        return whole

    def periods(self, of_what: str = LEAKAGE) -> tuple[BaselinePeriod, ...]:
        """Return the baseline periods of the leakage, or of a sensor's zero."""
        return periods_of(self.spec, self.motor.decisions, self.records, of_what)

    def why_no_blocks(self, night: dt.date) -> str:
        """Return why a night has no blocks that count, in words."""
        if night in self.excluded:
            return self.excluded[night]
        row = self.rows.get(night)
        if row is None:
            return NO_LOG
        status = "no blocks" if row["status"] == OK else row["status"].replace("_", " ")
        return ": ".join(filter(None, (status, row["reason"])))

    def is_refused(self, night: dt.date) -> bool:
        """Return whether a night has samples of which too few count."""
        return self.rows.get(night, {}).get("status") in (FAILED, INSUFFICIENT_DATA)

    def fitted_leakage(self, night: dt.date) -> Estimate | None:
        """Return leakage at the reference conditions by a night's own fit; None if it has none."""
        fit = self.fits.get(night, {})
        upper = fit.get("fitted_leakage_upper")
        if upper is None or fit["fitted_leakage_verdict"] not in WITH_VALUE:
            return None
        value = fit["fitted_leakage_l_per_min"]
        return Estimate(value, (upper - value) / HALF)

    def previous_model_fit_percent(self, night: dt.date) -> float | None:
        """Fit of the model of the night before on a night's samples; None without either."""
        earlier = [
            label
            for label, fit in self.fits.items()
            if night - MODEL_AGE <= label < night and fit["coefficients"]
        ]
        factor = self.factors.get(night.toordinal())
        if factor is None or not earlier:
            return None
        theta = np.array(self.fits[max(earlier)]["coefficients"])
        if len(theta) != len(factor) - 2:
            return None
        channel = self.spec.file.channels["leakage_flow"]
        return agreement(factor, theta, channel.resolution).fit_percent


def read_nights(
    output: Path, circuits: Sequence[Circuit], *, with_rows: bool = True
) -> dict[str, PublishedNights]:
    """Return the nights of motors that have any; without rows what their watches need alone."""
    motors = {
        motor.spec.motor_id: PublishedNights(motor, _checkpoint(motor))
        for circuit in circuits
        for motor in circuit
    }
    if with_rows:
        _read_rows(output, motors)
    for nights in motors.values():
        nights.records = _records(nights)
    motors = {name: nights for name, nights in motors.items() if len(nights)}
    for circuit in circuits:
        names = [motor.spec.motor_id for motor in circuit]
        _set_beginnings([motors[name] for name in names if name in motors])
    _add_blocks(output, motors)
    return motors


def _checkpoint(motor: TrendMotor) -> MotorCheckpoint | None:
    """Return what the run before left of a motor, where it is of these settings and nights."""
    checkpoint = decode(motor.checkpoint) if motor.is_as_recorded else None
    if checkpoint is None or motor.record is None:
        return None
    expected = key_of(motor.trend_hash), motor.record.last_night
    return checkpoint if (checkpoint.key, checkpoint.last_night) == expected else None


def _set_beginnings(circuit: Sequence[PublishedNights]) -> None:
    """Set where the watches of a circuit's motors begin: all of them see what moves one."""
    begins = [_beginning(nights, first)[0] for nights in circuit if (first := nights.motor.first)]
    for nights in circuit if begins else ():
        since = min(begins)
        first = min(since, nights.motor.first or since)
        nights.beginning, nights.resumes = _beginning(nights, first)


def read_blocks(
    output: Path, spec: MotorSpec, watch_columns: WatchColumns, nights: Collection[dt.date]
) -> list[NightBlocks]:
    """Return blocks of some of a motor's nights, in time order, without those that do not count."""
    rows = read_rows(output, BLOCKS, [spec.motor_id], BLOCK_COLUMNS, nights=nights)
    parts = rows.sort("night").partition_by("night", maintain_order=True)
    blocks = (_night_blocks(watch_columns, watch_columns.blocks(spec, part)) for part in parts)
    return [night for night in blocks if night is not None]


def _read_rows(output: Path, motors: Mapping[str, PublishedNights]) -> None:
    """Read the rows that are needed of some motors."""
    read_from = {name: nights.rows_from for name, nights in motors.items()}
    models_from = {
        name: max(dt.date.min + MODEL_AGE, night) - MODEL_AGE for name, night in read_from.items()
    }
    made_from = {name: first for name, nights in motors.items() if (first := nights.motor.first)}
    for row in _rows_since(output, NIGHTS, OF_NIGHT, read_from):
        motors[row["motor_id"]].rows[row["night"]] = row
    for name, nights in motors.items():
        unpublished = nights.motor.unpublished.items()
        nights.rows |= {night: row for night, row in unpublished if night >= read_from[name]}
    for row in _rows_since(output, FITS, FIT_COLUMNS, models_from):
        if row["is_primary"]:
            motors[row["motor_id"]].fits[row["night"]] = row
    for row in _rows_since(output, PARAMETERS, PARAMETER_COLUMNS, made_from):
        nights, night = motors[row["motor_id"]], row["night"]
        if row["flushing_mode"] == nights.fits.get(night, {}).get("flushing_mode"):
            nights.parameters.setdefault(night, {})[row["parameter"]] = row
    for row in _rows_since(output, LOG_FILES, FILE_COLUMNS, made_from):
        if row["message"]:
            messages = motors[row["motor_id"]].messages
            messages.setdefault(row["night"], []).append(row["message"])
    for row in read_rows(output, ALARMS, list(made_from)).drop("run_id").to_dicts():
        motors[row["motor_id"]].alarms.append(row)


def _rows_since(
    output: Path, table: Table, columns: Sequence[str], first: Mapping[str, dt.date]
) -> Iterator[Row]:
    """Yield rows of some motors, of each from a night of its own on."""
    for night, motors in _by_night(first).items():
        labels = list(takewhile(night.__le__, nights_back(output, table)))
        yield from read_rows(output, table, motors, columns, nights=labels).iter_rows(named=True)


def _by_night(first: Mapping[str, dt.date]) -> dict[dt.date, list[str]]:
    """Return motors by night."""
    motors: dict[dt.date, list[str]] = {}
    for motor_id, night in first.items():
        motors.setdefault(night, []).append(motor_id)
    return motors


def _records(nights: PublishedNights) -> Records:
    """Return a motor's nights in order, by its checkpoint and its rows; no block is counted yet."""
    known = blank_records([])
    if nights.checkpoint is not None:
        before = nights.checkpoint.records
        known = before[before["known"] & (before["night"] < np.datetime64(nights.rows_from))]
    # A night of which a run only said that there is no log has no row of `fits`.
    labels = sorted(nights.rows.keys() & nights.fits.keys())
    new = blank_records(labels)
    for record, night in zip(new, labels, strict=True):
        record["known"] = True
        for name in OPERATED:
            record[name] = _or_nan(nights.rows[night][name])
    return every_night(np.concatenate([known, new]), nights.motor.until)


def _beginning(nights: PublishedNights, first: dt.date) -> tuple[dt.date, bool]:
    """Return the night from which on a watch has to go, and whether the checkpoint leads there."""
    checkpoint = nights.checkpoint
    if checkpoint is None:
        return nights.labels[0], False
    # The nights to come may begin a baseline period of their own: that of the night before decides.
    place = max(nights.place_from(first) - 1, 0)
    period = nights.labels[period_at(nights.periods(), place).first]
    watch = checkpoint.watch
    if watch is not None and watch.period == period and watch.day < first.toordinal():
        return min(first, checkpoint.last_night), True
    return period, False


def _add_blocks(output: Path, motors: Mapping[str, PublishedNights]) -> None:
    """Read the blocks of the nights that the watches are to take, some nights at a time."""
    needed = {name: nights.beginning or dt.date.max for name, nights in motors.items()}
    for begin, some in _by_night(needed).items():
        every = {night for name in some for night in motors[name].labels if night >= begin}
        labels = sorted(every)
        for at in range(0, len(labels), NIGHTS_AT_ONCE):
            chosen = labels[at : at + NIGHTS_AT_ONCE]
            rows = read_rows(output, BLOCKS, some, BLOCK_COLUMNS, nights=chosen)
            for (name, night), part in rows.partition_by("motor_id", "night", as_dict=True).items():
                _take(motors[name], night, part)


def _take(nights: PublishedNights, night: dt.date, rows: pl.DataFrame) -> None:
    """Put a night's blocks into a motor's nights."""
    place = nights.place_from(night)
    if place == len(nights) or nights.labels[place] != night:
        return
    record, watch_columns = nights.records[place], nights.watch_columns
    record["model"] = rows["model_hash"][0]
    stored = watch_columns.blocks(nights.spec, rows)
    blocks = _night_blocks(watch_columns, stored)
    if stored is None or blocks is None:
        nights.excluded[night] = OTHER_KIND
        return
    record["charge"] = _or_nan(stored.charge_bar)
    record["viscosity"] = _or_nan(stored.viscosity_ratio)
    record["blocks"] = len(blocks.flow)
    nights.blocks[blocks.day] = blocks
    nights.factors[blocks.day] = merge(stored.factors)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _night_blocks(watch_columns: WatchColumns, stored: StoredBlocks | None) -> NightBlocks | None:
    """Return blocks of a night as the watch takes them; None where they do not count."""
    if stored is None or stored.rows["model_hash"].n_unique() != 1:
        return None
    blocks = watch_columns.night_blocks(stored)
    is_finite = np.isfinite(blocks.drives).all() and np.isfinite(blocks.flow).all()
    return blocks if is_finite else None


def every_night(records: Records, until: dt.date) -> Records:
    """Return records of every night up to a day, but for those behind a long silence."""
    known = records[records["known"] & (records["night"] <= np.datetime64(until))]
    if not len(known):
        return known
    days = known["night"].astype(np.int64)
    numbers = np.arange(days[0], np.datetime64(until).astype(np.int64) + 1)
    silent = numbers - days[np.searchsorted(days, numbers, "right") - 1]
    labels = nights_between(known["night"][0].item(), until)
    whole = blank_records([labels[place] for place in np.flatnonzero(silent <= LONGEST_SILENCE)])
    whole[np.searchsorted(whole["night"], known["night"])] = known
    return whole


@dataclass(frozen=True, slots=True)
class BaselinePeriod:
    """Places of its nights, half open, and what it begins with, in words."""

    first: int
    end: int
    reason: str


def periods_of(
    spec: MotorSpec, decisions: Collection[Decision], records: Records, of_what: str = LEAKAGE
) -> tuple[BaselinePeriod, ...]:
    """Return the baseline periods of a motor's leakage, or of a sensor's zero."""
    labels = records["night"]
    borders = [] if of_what in SENSORS else _changed_settings(spec, records)
    events = spec.file.changes if of_what in SENSORS else spec.file.baseline_events
    for event in sorted(events, key=lambda event: event.date):
        # What happened before the first night is nothing that its nights show.
        if event.date >= labels[0].item():
            words = f"{EVENT_WORDS[event.kind]} on {event.date}{_noted(event.note)}"
            borders.append((event.date, words))
    for decision in decisions:
        # Of a sensor's zero, or under any other name of the leakage; without either.
        reset = decision.indicator if decision.indicator in (*SENSORS, "") else LEAKAGE
        if decision.kind == "baseline_reset" and reset in (of_what, ""):
            words = f"reset from {decision.night}{_noted(decision.note)}"
            borders.append((decision.night, words))
    starts: dict[int, list[str]] = {0: []}
    for date, words in borders:
        place = int(np.searchsorted(labels, np.datetime64(date)))
        if place < len(records):
            starts.setdefault(place, []).append(words)
    places = [*sorted(starts), len(records)]
    return tuple(
        BaselinePeriod(first, end, "; ".join(starts[first]) or FIRST_NIGHTS)
        for first, end in pairwise(places)
    )


def _noted(note: str) -> str:
    return f": {note}" if note else ""


def period_at(periods: tuple[BaselinePeriod, ...], place: int) -> BaselinePeriod:
    """Return the baseline period of a night; the last night's for nights to come."""
    return next((period for period in periods if place < period.end), periods[-1])


def _changed_settings(spec: MotorSpec, records: Records) -> list[tuple[dt.date, str]]:
    """Return nights whose statistics were shaped by other settings than those before.

    The oil is dated by an event of its own, and periods set by hand are of their night alone.
    """
    known = records[records["model"] != b""]
    if len(np.unique(known["model"])) < 2:
        return []
    changes = []
    before: tuple[bytes, str] | None = None
    for model, label in zip(known["model"].tolist(), known["night"].tolist(), strict=True):
        if spec.file.periods.within(night_labelled(label, spec.settings.nights)):
            continue
        now = model, spec.file.oil_on(label)
        if before is not None and now[0] != before[0] and now[1] == before[1]:
            changes.append((label, f"{OTHER_SETTINGS} {label}"))
        before = now
    return changes

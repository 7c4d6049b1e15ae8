"""Nights of motors as published: most by the checkpoint of a run before, the others read."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.special import ndtri

from leakage.estimation.blocks import merge
from leakage.estimation.identifiability import WITH_VALUE
from leakage.estimation.validation import agreement
from leakage.watch import Estimate, NightBlocks
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.night.stored_blocks import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import (
    ALARMS,
    BLOCKS,
    FITS,
    LOG_FILES,
    NIGHTS,
    OF_NIGHT,
    PARAMETERS,
    Table,
)
from pipeline.schema.fits import NO_NEW_DATA, OK
from pipeline.store.tables import nights_back, read_rows
from pipeline.trends.nights.checkpoint import MotorCheckpoint
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import (
    OPERATED,
    History,
    blank_records,
    every_night,
    period_at,
    periods_of,
)
from pipeline.trends.nights.watch_columns import WatchColumns

Row = dict[str, Any]

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
MODEL_AGE = dt.timedelta(days=31)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Nights of a motor that a run needs.

    `first` and `until` are the first and the last whose trends are made; without a first one none
    are, and the motor is only seen by the others of its oil circuit.
    """

    spec: MotorSpec
    decisions: tuple[Decision, ...]
    checkpoint: MotorCheckpoint | None
    first: dt.date | None
    until: dt.date
    # Rows of nights as far as these fill them, which are not in `nights` yet.
    unpublished: Mapping[dt.date, Row] = field(default_factory=dict)

    @property
    def rows_from(self) -> dt.date:
        """First night whose rows are read."""
        if self.checkpoint is None:
            return dt.date.min
        after = self.checkpoint.last_night + dt.timedelta(days=1)
        return after if self.first is None else min(self.first, after)


@dataclass(slots=True)
class PublishedNights:
    """A motor's nights as they are published.

    The watch goes over the nights from `beginning` on, be it for the other motors of its oil
    circuit alone; None where nobody needs it. `resumes`: it goes on from the checkpoint.
    """

    wanted: Wanted
    history: History = field(init=False)
    beginning: dt.date | None = None
    resumes: bool = False
    # By night: rows of `nights` and of `fits`, of `parameters` by name, and what is said of log
    # files, of the nights that were read.
    rows: dict[dt.date, Row] = field(default_factory=dict)
    fits: dict[dt.date, Row] = field(default_factory=dict)
    parameters: dict[dt.date, dict[str, Row]] = field(default_factory=dict)
    messages: dict[dt.date, list[str]] = field(default_factory=dict)
    alarms: list[Row] = field(default_factory=list)  # what is published of the motor
    # By number of the day, from `blocks_from` on: the blocks, and the factor of all samples.
    blocks: dict[int, NightBlocks] = field(default_factory=dict)
    factors: dict[int, Array] = field(default_factory=dict)
    # Why the blocks of some nights do not count.
    excluded: dict[dt.date, str] = field(default_factory=dict)

    @property
    def blocks_from(self) -> dt.date:
        """First night whose blocks are needed."""
        return self.beginning or dt.date.max

    def why_no_blocks(self, night: dt.date) -> str:
        """Return why a night has no blocks that count, in words."""
        if night in self.excluded:
            return self.excluded[night]
        row = self.rows.get(night)
        if row is None:
            return NO_LOG
        status = "no blocks" if row["status"] == OK else row["status"].replace("_", " ")
        return ": ".join(filter(None, (status, row["reason"])))

    def fitted_leakage(self, night: dt.date) -> Estimate | None:
        """Leakage at the reference conditions by a night's own fit; None where it has none."""
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
        channel = self.wanted.spec.file.channels["leakage_flow"]
        return agreement(factor, theta, channel.resolution).fit_percent


def read_nights(output: Path, circuits: Sequence[Sequence[Wanted]]) -> dict[str, PublishedNights]:
    """Return the nights of the motors of some oil circuits; nothing of a motor without a night."""
    motors = {
        wanted.spec.motor_id: PublishedNights(wanted) for circuit in circuits for wanted in circuit
    }
    _read_rows(output, motors)
    for motor in motors.values():
        motor.history = _history(motor)
    motors = {name: motor for name, motor in motors.items() if len(motor.history)}
    for circuit in circuits:
        names = [wanted.spec.motor_id for wanted in circuit if wanted.spec.motor_id in motors]
        _set_beginnings([motors[name] for name in names])
    _add_blocks(output, motors)
    return motors


def _set_beginnings(circuit: Sequence[PublishedNights]) -> None:
    """Set where the watches of a circuit's motors begin: all of them see what moves one."""
    firsts = [(motor, motor.wanted.first) for motor in circuit]
    begins = [_beginning(motor, first)[0] for motor, first in firsts if first is not None]
    for motor, first in firsts if begins else ():
        since = min(begins)
        motor.beginning, motor.resumes = _beginning(motor, min(since, first or since))


def read_blocks(
    output: Path, spec: MotorSpec, watch_columns: WatchColumns, nights: Collection[dt.date]
) -> list[NightBlocks]:
    """Blocks of some of a motor's nights, in order of time, without those that do not count."""
    rows = read_rows(output, BLOCKS, [spec.motor_id], BLOCK_COLUMNS, nights=nights)
    parts = rows.sort("night").partition_by("night", maintain_order=True)
    blocks = (_night_blocks(watch_columns, watch_columns.blocks(spec, part)) for part in parts)
    return [night for night in blocks if night is not None]


def _read_rows(output: Path, motors: Mapping[str, PublishedNights]) -> None:
    """Read the rows that are needed of some motors."""
    read_from = {name: motor.wanted.rows_from for name, motor in motors.items()}
    models_from = {
        name: max(dt.date.min + MODEL_AGE, night) - MODEL_AGE for name, night in read_from.items()
    }
    made_from = {name: first for name, motor in motors.items() if (first := motor.wanted.first)}
    for row in _rows_since(output, NIGHTS, OF_NIGHT, read_from):
        motors[row["motor_id"]].rows[row["night"]] = row
    for name, motor in motors.items():
        unpublished = motor.wanted.unpublished
        new = {night: row for night, row in unpublished.items() if night >= read_from[name]}
        motor.rows.update(new)
    for row in _rows_since(output, FITS, FIT_COLUMNS, models_from):
        if row["is_primary"]:
            motors[row["motor_id"]].fits[row["night"]] = row
    for row in _rows_since(output, PARAMETERS, PARAMETER_COLUMNS, made_from):
        motor, night = motors[row["motor_id"]], row["night"]
        if row["flushing_mode"] == motor.fits.get(night, {}).get("flushing_mode"):
            motor.parameters.setdefault(night, {})[row["parameter"]] = row
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


def _history(motor: PublishedNights) -> History:
    """Return a motor's nights in order, by its checkpoint and its rows; no block is counted yet."""
    wanted, known = motor.wanted, blank_records([])
    if wanted.checkpoint is not None:
        before = wanted.checkpoint.records
        known = before[before["known"] & (before["night"] < np.datetime64(wanted.rows_from))]
    # A night of which a run only said that there is no log has no row of `fits`.
    labels = sorted(motor.rows.keys() & motor.fits.keys())
    new = blank_records(labels)
    for record, night in zip(new, labels, strict=True):
        record["known"] = True
        for name in OPERATED:
            value = motor.rows[night][name]
            record[name] = np.nan if value is None else value
    records = every_night(np.concatenate([known, new]), wanted.until)
    watch_columns = WatchColumns.of(wanted.spec, wanted.until)
    return History(wanted.spec, watch_columns, records, wanted.decisions)


def _beginning(motor: PublishedNights, first: dt.date) -> tuple[dt.date, bool]:
    """Return the night from which on a watch has to go to know a first one and those after it.

    And whether it goes on from the checkpoint.
    """
    history, checkpoint = motor.history, motor.wanted.checkpoint
    if checkpoint is None:
        return history.nights[0], False
    # The nights to come may begin a baseline period of their own: that of the night before decides.
    place = max(history.place_from(first) - 1, 0)
    period = history.nights[period_at(periods_of(history), place).first]
    watch = checkpoint.watch
    if watch is not None and watch.period == period and watch.day < first.toordinal():
        return min(first, checkpoint.last_night), True
    return period, False


def _add_blocks(output: Path, motors: Mapping[str, PublishedNights]) -> None:
    """Read the blocks of the nights that the watches are to take, some nights at a time."""
    needed = {name: motor.blocks_from for name, motor in motors.items()}
    for begin, some in _by_night(needed).items():
        nights = {night for name in some for night in motors[name].history.nights if night >= begin}
        labels = sorted(nights)
        for at in range(0, len(labels), NIGHTS_AT_ONCE):
            chosen = labels[at : at + NIGHTS_AT_ONCE]
            rows = read_rows(output, BLOCKS, some, BLOCK_COLUMNS, nights=chosen)
            for (name, night), part in rows.partition_by("motor_id", "night", as_dict=True).items():
                _take(motors[name], night, part)


def _take(motor: PublishedNights, night: dt.date, rows: pl.DataFrame) -> None:
    """Put a night's blocks into a motor's nights."""
    history = motor.history
    place = history.place_from(night)
    if place == len(history) or history.nights[place] != night:
        return
    history.records["model"][place] = rows["model_hash"][0]
    stored = history.watch_columns.blocks(history.spec, rows)
    blocks = _night_blocks(history.watch_columns, stored)
    if stored is None or blocks is None:
        motor.excluded[night] = OTHER_KIND
        return
    history.records["charge"][place] = _or_nan(stored.charge_bar)
    history.records["viscosity"][place] = _or_nan(stored.viscosity_ratio)
    history.records["blocks"][place] = len(blocks.flow)
    motor.blocks[blocks.day] = blocks
    motor.factors[blocks.day] = merge(stored.factors)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _night_blocks(watch_columns: WatchColumns, stored: StoredBlocks | None) -> NightBlocks | None:
    """Return blocks of a night as the watch takes them; None where they do not count."""
    if stored is None or stored.rows["model_hash"].n_unique() != 1:
        return None
    blocks = watch_columns.night_blocks(stored)
    is_finite = np.isfinite(blocks.drives).all() and np.isfinite(blocks.flow).all()
    return blocks if is_finite else None

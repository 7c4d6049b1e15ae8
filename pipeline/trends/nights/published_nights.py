"""Nights of motors as published: most by the checkpoint of a run before, the others read."""

from __future__ import annotations

import datetime as dt
import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.special import ndtri

from leakage.estimation.block_statistics import merge
from leakage.estimation.identifiability import TOLD
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
    Records,
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
    """A motor's nights as the tables have them.

    The watch is told the nights from `beginning` on, be it for the other motors of its oil circuit
    alone; None where nobody needs it. `resumes`: it goes on from the checkpoint.
    """

    wanted: Wanted
    history: History
    beginning: dt.date | None
    resumes: bool
    # By night: rows of `nights` and of `fits`, of `parameters` by name, and what is said of log
    # files, of the nights that were read.
    rows: Mapping[dt.date, Row]
    fits: Mapping[dt.date, Row]
    parameters: Mapping[dt.date, Mapping[str, Row]]
    messages: Mapping[dt.date, Sequence[str]]
    alarms: Sequence[Row]  # what is published of the motor
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
        """Why a night has no blocks that count, in words."""
        if night in self.excluded:
            return self.excluded[night]
        row = self.rows.get(night)
        if row is None:
            return NO_LOG
        status = "no blocks" if row["status"] == OK else row["status"].replace("_", " ")
        return ": ".join(one for one in (status, row["reason"]) if one)

    def fitted_leakage(self, night: dt.date) -> Estimate | None:
        """Leakage at the reference conditions by a night's own fit; None where it has none."""
        fit = self.fits.get(night, {})
        upper = fit.get("fitted_leakage_upper")
        if upper is None or fit["fitted_leakage_verdict"] not in TOLD:
            return None
        value = fit["fitted_leakage_l_per_min"]
        return Estimate(value, (upper - value) / HALF)

    def previous_model_fit_percent(self, night: dt.date) -> float | None:
        """Fit of the model of the night before on a night's samples; None without either."""
        earlier = [
            one
            for one, fit in self.fits.items()
            if night - MODEL_AGE <= one < night and fit["coefficients"]
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
    """The published nights of the motors of some oil circuits; of those without a night nothing."""
    read = _Rows(output, [one for circuit in circuits for one in circuit])
    found: dict[str, PublishedNights] = {}
    for circuit in circuits:
        told = [(one, history) for one in circuit if (history := _history(one, read)) is not None]
        begins = [
            _beginning(one, history, one.first)[0] for one, history in told if one.first is not None
        ]
        since = min(begins, default=None)
        for one, history in told:
            motor_id = one.spec.motor_id
            beginning: tuple[dt.date | None, bool] = None, False
            if since is not None:
                # The others see it from the first night on that any of them is told.
                beginning = _beginning(one, history, min(since, one.first or since))
            found[motor_id] = PublishedNights(
                one,
                history,
                *beginning,
                read.nights[motor_id],
                read.fits[motor_id],
                read.parameters[motor_id],
                read.messages[motor_id],
                read.alarms[motor_id],
            )
    _add_blocks(output, found)
    return found


def read_blocks(
    output: Path, spec: MotorSpec, watch_columns: WatchColumns, nights: Collection[dt.date]
) -> list[NightBlocks]:
    """Blocks of some of a motor's nights, in order of time, without those that do not count."""
    rows = read_rows(output, BLOCKS, [spec.motor_id], BLOCK_COLUMNS, nights=nights)
    parts = rows.sort("night").partition_by("night", maintain_order=True)
    found = (_night_blocks(watch_columns, watch_columns.blocks(spec, part)) for part in parts)
    return [one for one in found if one is not None]


class _Rows:
    """Rows by motor, and then by night; of parameters also by name."""

    def __init__(self, output: Path, wanted: Sequence[Wanted]) -> None:
        self.nights: defaultdict[str, dict[dt.date, Row]] = defaultdict(dict)
        self.fits: defaultdict[str, dict[dt.date, Row]] = defaultdict(dict)
        self.parameters: defaultdict[str, dict[dt.date, dict[str, Row]]] = defaultdict(dict)
        self.messages: defaultdict[str, dict[dt.date, list[str]]] = defaultdict(dict)
        self.alarms: defaultdict[str, list[Row]] = defaultdict(list)
        read_from = {one.spec.motor_id: one.rows_from for one in wanted}
        models_from = {name: max(dt.date.min + MODEL_AGE, one) for name, one in read_from.items()}
        models_from = {name: one - MODEL_AGE for name, one in models_from.items()}
        made_from = {one.spec.motor_id: one.first for one in wanted if one.first is not None}
        for row in _rows_since(output, NIGHTS, OF_NIGHT, read_from):
            self.nights[row["motor_id"]][row["night"]] = row
        for one in wanted:
            self.nights[one.spec.motor_id] |= {
                night: row for night, row in one.unpublished.items() if night >= one.rows_from
            }
        for row in _rows_since(output, FITS, FIT_COLUMNS, models_from):
            if row["is_primary"]:
                self.fits[row["motor_id"]][row["night"]] = row
        for row in _rows_since(output, PARAMETERS, PARAMETER_COLUMNS, made_from):
            fit = self.fits[row["motor_id"]].get(row["night"], {})
            if row["flushing_mode"] == fit.get("flushing_mode"):
                named = self.parameters[row["motor_id"]].setdefault(row["night"], {})
                named[row["parameter"]] = row
        for row in _rows_since(output, LOG_FILES, FILE_COLUMNS, made_from):
            if row["message"]:
                some = self.messages[row["motor_id"]].setdefault(row["night"], [])
                some.append(row["message"])
        for row in read_rows(output, ALARMS, list(made_from)).drop("run_id").to_dicts():
            self.alarms[row["motor_id"]].append(row)


def _rows_since(
    output: Path, table: Table, columns: Sequence[str], first: Mapping[str, dt.date]
) -> Iterator[Row]:
    """Rows of some motors, of each from a night of its own on."""
    for night, motors in _by_night(first).items():
        labels = list(takewhile(night.__le__, nights_back(output, table)))
        yield from read_rows(output, table, motors, columns, nights=labels).iter_rows(named=True)


def _by_night(first: Mapping[str, dt.date]) -> dict[dt.date, list[str]]:
    """Motors by night."""
    found: dict[dt.date, list[str]] = {}
    for motor_id, night in first.items():
        found.setdefault(night, []).append(motor_id)
    return found


def _history(wanted: Wanted, read: _Rows) -> History | None:
    """A motor's nights; None where there is none. Their blocks are not counted yet."""
    motor_id = wanted.spec.motor_id
    rows, fits = read.nights[motor_id], read.fits[motor_id]
    known: Records = blank_records([])
    if wanted.checkpoint is not None:
        before = wanted.checkpoint.records
        known = before[before["known"] & (before["night"] < np.datetime64(wanted.rows_from))]
    # A night of which a run only said that there is no log has no row of `fits`.
    labels = sorted(rows.keys() & fits.keys())
    new = blank_records(labels)
    for record, night in zip(new, labels, strict=True):
        record["known"] = True
        for name in OPERATED:
            value = rows[night][name]
            record[name] = np.nan if value is None else value
    records = every_night(np.concatenate([known, new]), wanted.until)
    if not len(records):
        return None
    watch_columns = WatchColumns.of(wanted.spec, wanted.until)
    return History(wanted.spec, watch_columns, records, wanted.decisions)


def _beginning(wanted: Wanted, history: History, first: dt.date) -> tuple[dt.date, bool]:
    """From which night on a watch has to be told the nights, to tell one and those after it.

    And whether it goes on from the checkpoint.
    """
    if wanted.checkpoint is None:
        return history.nights[0], False
    # The nights to come may begin a baseline period of their own: that of the night before decides.
    place = max(history.place_from(first) - 1, 0)
    period = history.nights[period_at(periods_of(history), place).first]
    watch = wanted.checkpoint.watch
    if watch is not None and watch.period == period and watch.day < first.toordinal():
        return min(first, wanted.checkpoint.last_night), True
    return period, False


def _add_blocks(output: Path, motors: Mapping[str, PublishedNights]) -> None:
    """Read the blocks of the nights that the watches are to be told, some nights at a time."""
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
    found = _night_blocks(history.watch_columns, stored)
    if stored is None or found is None:
        motor.excluded[night] = OTHER_KIND
        return
    history.records["charge"][place] = _or_nan(stored.charge_bar)
    history.records["viscosity"][place] = _or_nan(stored.viscosity_ratio)
    history.records["blocks"][place] = len(found.flow)
    motor.blocks[found.day] = found
    motor.factors[found.day] = merge(stored.factors)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _night_blocks(watch_columns: WatchColumns, stored: StoredBlocks | None) -> NightBlocks | None:
    """Blocks of a night as the watch takes them; None where they do not count."""
    if stored is None or stored.rows["model_hash"].n_unique() != 1:
        return None
    found = watch_columns.night_blocks(stored)
    is_finite = np.isfinite(found.drives).all() and np.isfinite(found.flow).all()
    return found if is_finite else None

"""Nights of the motors for the trends: most as kept by a run before, the others read anew."""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.errors import StoreError
from pipeline.night.stored_blocks import BLOCK_COLUMNS
from pipeline.schema import ALARMS, BLOCK_STATISTICS, FITS, OPERATION, PARAMETERS
from pipeline.store.tables import read_rows
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.from_tables import (
    FIT_COLUMNS,
    OPERATION_COLUMNS,
    PARAMETER_COLUMNS,
    add_blocks,
    rows_by_night,
)
from pipeline.trends.nights.history import History, every_night
from pipeline.trends.nights.kept_nights import (
    KeptMonth,
    TableFolders,
    key_of,
    read_months,
    write_month,
)
from pipeline.trends.nights.records import Layout, Records, blank_records, record_type
from pipeline.trends.nights.tonight import Tonight

log = logging.getLogger(__name__)

Row = dict[str, Any]
# After all nights.
NEVER = "9999-12-31"


def read_nights(
    output: Path,
    specs: Sequence[MotorSpec],
    decisions: Mapping[str, Sequence[Decision]],
    since: Mapping[str, dt.date],
    tonight: Tonight,
) -> dict[str, MotorNights]:
    """The published nights of some motors; raises StoreError if a table file is damaged."""
    folders = TableFolders(output)
    found = {}
    for spec in specs:
        layout = Layout.of(spec, tonight.night)
        key = key_of(spec, layout, decisions[spec.motor_id])
        first = since.get(spec.motor_id)
        found[spec.motor_id] = MotorNights(
            key,
            layout,
            folders,
            read_months(output, spec.motor_id, key, layout),
            NEVER if first is None else first.isoformat(),
        )
    nights = set[str]().union(*(one.nights for one in found.values()))
    alarms = set[str]().union(*(one.alarms for one in found.values()))
    made = rows_by_night(
        specs,
        {motor_id: one.layout for motor_id, one in found.items()},
        *(
            read_rows(output, table, list(found), columns, nights=_dates(nights))
            for table, columns in (
                (FITS, FIT_COLUMNS),
                (PARAMETERS, PARAMETER_COLUMNS),
                (OPERATION, OPERATION_COLUMNS),
            )
        ),
    )
    _add_blocks(output, found, made)
    told = defaultdict(list)
    for row in (
        read_rows(output, ALARMS, list(found), nights=_dates(alarms)).drop("run_id").to_dicts()
    ):
        told[row["motor_id"]].append(row)
    for spec in specs:
        one = found[spec.motor_id]
        said = tuple(decisions[spec.motor_id])
        one.take_nights(spec, said, made.get(spec.motor_id), nights, tonight.of(spec.motor_id))
        one.take_alarms(told[spec.motor_id], alarms)
    return found


def _add_blocks(
    output: Path, motors: Mapping[str, MotorNights], made: Mapping[str, History]
) -> None:
    """Read the blocks of nights that were read anew and have no fit."""
    poor = {
        motor_id: nights.tolist()
        for motor_id, one in made.items()
        if len(nights := one.records["night"][~one.records["fitted"]])
    }
    if not poor:
        return
    labels = set().union(*poor.values())
    rows = read_rows(output, BLOCK_STATISTICS, list(poor), BLOCK_COLUMNS, nights=labels)
    for (motor_id,), own in rows.partition_by("motor_id", as_dict=True).items():
        history = made[motor_id]
        add_blocks(history.spec, motors[motor_id].layout, history.records, own)


@dataclass(slots=True)
class MotorNights:
    """A motor's nights: what is kept of them, what is to be read, and what comes of both.

    Nights are YYYY-MM-DD where they name files.
    """

    # key, layout: what shapes its records.
    key: str
    layout: Layout
    folders: TableFolders
    months: Mapping[str, KeptMonth]  # what is kept
    # First night that is to be made anew: from it on words are needed, not figures alone.
    since: str
    # nights, alarms: nights of which rows are to be read, of the fits and of `alarms`.
    nights: set[str] = field(default_factory=set)
    alarms: set[str] = field(default_factory=set)
    until: str = NEVER  # nights before this one are filtered as they are to be
    history: History | None = None  # the nights; None without rows
    # The motor's rows of `alarms`: whole from `since` on, before it night, indicator and state.
    published: list[Row] = field(default_factory=list)
    _records: Records = field(init=False)

    def __post_init__(self) -> None:
        self.until = self.since
        self._records = blank_records(self.layout, [])
        for month in self.folders.months.keys() | self.months.keys():
            kept = self.months.get(month)
            if kept is None:
                self.nights |= self.folders.files_read(month).keys()
                self.alarms |= self.folders.files(ALARMS, month).keys()
            else:
                self._look_at(month, kept)

    def _look_at(self, month: str, kept: KeptMonth) -> None:
        """Note the nights of a month that have changed or are to be made anew."""
        # What this run may have published is looked at file by file: over a network the time of a
        # folder can be an older one.
        if month >= self.since[:7] or not self.folders.same(month, kept):
            self.nights |= _differing(kept.files, self.folders.files_read(month))
            self.alarms |= _differing(kept.alarms, self.folders.files(ALARMS, month))
            self.nights |= _differing(kept.blocks, self._blocks(month, kept.blocks))
        if month >= self.since[:7]:
            self.nights |= {one for one in _labels(kept.records["night"]) if one >= self.since}
            self.alarms |= {one for one in kept.states if one >= self.since}
        self.until = min(self.until, kept.until or NEVER)

    def _blocks(self, month: str, nights: Iterable[str]) -> dict[str, str]:
        """Stamps of the files of `block_statistics`, by night, of some nights."""
        files = self.folders.files(BLOCK_STATISTICS, month)
        return {night: files.get(night, "") for night in nights}

    def take_nights(
        self,
        spec: MotorSpec,
        decisions: tuple[Decision, ...],
        made: History | None,
        nights: Collection[str],
        until: dt.date,
    ) -> None:
        """Put what was read, of all these nights, beside what is kept of the others."""
        kept = self._joined(one.records for one in self.months.values())
        anew = np.isin(kept["night"], np.array(sorted(nights), dtype="M8[D]"))
        new = blank_records(self.layout, []) if made is None else made.records
        read = np.append(kept["night"][anew], new["night"])
        self.until = min((self.until, *_labels(read)))
        self._records = self._joined([kept[~anew], new])
        if len(self._records):
            places = np.searchsorted(self._records["night"], new["night"]).tolist()
            words = {} if made is None else {places[at]: one for at, one in made.words.items()}
            whole = History(spec, self.layout, self._records, words, decisions)
            self.history = every_night(whole, until)

    def take_alarms(self, rows: Sequence[Row], nights: Collection[str]) -> None:
        """The same of the rows of `alarms`."""
        self.published = list(rows)
        for kept in self.months.values():
            for night, states in kept.states.items():
                if night not in nights:
                    date = dt.date.fromisoformat(night)
                    self.published += [
                        {"night": date, "indicator": indicator, "to_state": state}
                        for indicator, state in states
                    ]

    @property
    def filter_from(self) -> dt.date:
        """`until` as a date."""
        return dt.date.fromisoformat(self.until)

    def _joined(self, parts: Iterable[Records]) -> Records:
        """Records by night."""
        # As bytes: for a concatenation the types of all fields would be compared.
        whole = np.frombuffer(b"".join(part.tobytes() for part in parts), record_type(self.layout))
        sorted_: Records = whole[np.argsort(whole["night"], kind="stable")]
        return sorted_

    def keep(self, motor_id: str, done: Records | None) -> None:
        """Keep the nights for the next run; those that cannot be kept are read again then.

        `done` are the filtered records; None if they were not filtered.
        """
        states: dict[str, list[tuple[str, str]]] = {}
        for row in self.published:
            said = states.setdefault(row["night"].isoformat(), [])
            said.append((row["indicator"], row["to_state"]))
        for month in self.folders.months:
            before = self.months.get(month)
            if before is not None and month < self.until[:7] and self.folders.same(month, before):
                continue
            after = self._month(month, states, done)
            if before is None or after.encoded(self.key) != before.encoded(self.key):
                try:
                    write_month(self.folders.output, motor_id, month, self.key, after)
                except StoreError as error:
                    log.warning("%s; the next run reads the nights again", error)
                    return

    def _month(
        self, month: str, states: Mapping[str, Sequence[tuple[str, str]]], done: Records | None
    ) -> KeptMonth:
        whole = self._records
        records = whole[whole["night"].astype("M8[M]") == np.datetime64(month)]
        until = None
        if done is None:
            until = min((one for one in _labels(records["night"]) if one >= self.until), default="")
        else:
            # Nights after tonight are not done yet.
            ready = done[np.isin(done["night"], records["night"])]
            records[np.searchsorted(records["night"], ready["night"])] = ready
        alarms = self.folders.files(ALARMS, month)
        return KeptMonth(
            self.folders.months[month],
            self.folders.files_read(month),
            self._blocks(month, _labels(records["night"][~records["fitted"]])),
            alarms,
            {night: sorted(states[night]) for night in sorted(alarms.keys() & states.keys())},
            records,
            until or None,
        )


def _labels(nights: NDArray[np.datetime64]) -> list[str]:
    labels: list[str] = np.datetime_as_string(nights).tolist()
    return labels


def _dates(nights: Iterable[str]) -> list[dt.date]:
    return [dt.date.fromisoformat(night) for night in nights]


def _differing(before: Mapping[str, str], now: Mapping[str, str]) -> set[str]:
    """Nights of which a file has come, gone or changed."""
    return {night for night, _ in before.items() ^ now.items()}

"""Mending of damaged output, by a run or by `check --repair`.

Nothing is mended in its place. A damaged file is put aside, and its nights are forgotten, so that a
run makes them anew from logs or stored blocks. A missing file stays listed until it is there again:
if a run is broken off, the next one sees it. Each step can be repeated.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath

from pipeline.errors import StoreError
from pipeline.logs.processed import forget_nights
from pipeline.messages import counted
from pipeline.schema import DECISIONS, TABLES
from pipeline.store.atomic_files import move, remove
from pipeline.store.published import (
    OF_MOTORS,
    OF_TRENDS,
    TABLE_OF,
    TableFault,
    accepted,
    files_there,
    look_at,
    look_at_files,
    note,
    proves_itself,
    share_due,
    verify_tables,
)
from pipeline.store.state import State
from pipeline.store.tables import (
    MONTH_PREFIX,
    PUT_ASIDE,
    days_of,
    files_of,
    name_of,
    read_table,
    whole_file,
)
from pipeline.trends.nights.decisions import Decision, put_back
from pipeline.trends.nights.trend_record import note_touched

log = logging.getLogger(__name__)

# Rows of these are made anew from the night's stored blocks if its log is gone.
FROM_BLOCKS = {"parameters"}
# All files are due in each run.
EVERY_DAY = 1
LOST = ("table_altered", "table_missing")
NO_LOGS = (
    "the logs of that night are gone, or were not asked for; the next run makes it anew where they "
    "are there, and `check --repair` gives it up"
)


@dataclass(slots=True)
class Damage:
    """Damage to published files that a run finds, and mends as far as possible.

    Parameters
    ----------
    state
        State of an output folder, of which the caller holds the lock.

    Attributes
    ----------
    found
        Faults by path.
    """

    state: State
    found: dict[str, TableFault] = field(default_factory=dict)
    # By motor, the nights with a fit of which rows were lost.
    _fitted: defaultdict[str, set[dt.date]] = field(default_factory=lambda: defaultdict(set))

    def look_around(self, prove_within_days: int) -> None:
        """Prove the files that were written to since, and a share of the others.

        Raises StoreError if something cannot be read or written; what was done before then holds.
        """
        sound, faults = {}, []
        for one in look_at_files(self.state, share_due(self.state, prove_within_days)):
            if one.fault is None:
                sound[one.name] = one.sha256
            else:
                faults.append(one.fault)
        note(self.state, sound)
        self.mend(faults)

    def take_stock(self) -> None:
        """List what is there and proves itself, where the state file was lost or is new.

        Raises StoreError if the state cannot be written, or a file is of a newer version.
        """
        output, proven, faults = self.state.output, {}, []
        for table, path in ((one, path) for one in TABLES for path in files_of(output, one)):
            looked = look_at(self.state, name_of(output, path))
            if looked.fault is None and accepted(self.state, looked.name):
                continue
            if proves_itself(path, table, looked.content):
                proven[looked.name] = looked.sha256
            else:
                message = "it is not listed, and is damaged or not what a run publishes"
                faults.append(TableFault(looked.name, "table_altered", message))
        note(self.state, proven)
        self.mend(faults)

    def mend(self, faults: Iterable[TableFault]) -> None:
        """Name faults that are new, and let damaged and missing files be made anew.

        Raises StoreError if something cannot be written.
        """
        new = [one for one in faults if one.path not in self.found]
        for one in new:
            log.warning("%s", one)
        self.found |= {one.path: one for one in new}
        lost = [one for one in new if one.code in LOST and MONTH_PREFIX in one.path]
        self.forget([one.path for one in lost])
        for one in lost:
            path = self.state.output / "tables" / one.path
            if one.code == "table_altered":
                move(path, path.with_suffix(PUT_ASIDE))
            if one.path.split("/")[0] not in OF_MOTORS | OF_TRENDS:
                note(self.state, {one.path: None})  # nothing makes it anew

    def forget(self, names: Iterable[str]) -> None:
        """Let the nights of some files be made anew."""
        nights: defaultdict[dt.date, set[str]] = defaultdict(set)
        touched: list[dt.date] = []
        for name in names:
            table, label = name.split("/")[0], PurePosixPath(name).stem
            if table in OF_MOTORS:
                for night in days_of(label):
                    nights[night].add(table)
            if table in OF_MOTORS | OF_TRENDS:
                touched.append(days_of(label)[0])
        if nights:
            refit = {night for night, tables in nights.items() if tables <= FROM_BLOCKS}
            for motor_id, some in forget_nights(self.state, nights, refit=refit).items():
                self._fitted[motor_id] |= some
        if touched:
            motors = self.state.rows("SELECT motor_id FROM trends")
            note_touched(self.state, ((motor_id, min(touched)) for (motor_id,) in motors))

    def left(self, made: Mapping[str, Collection[dt.date]]) -> Iterator[TableFault]:
        """Faults that were found and are not mended, given the nights made by motor."""
        mended: dict[dt.date, str] = {}
        for path, fault in self.found.items():
            table = path.split("/")[0]
            is_made_anew = table in OF_MOTORS | OF_TRENDS or MONTH_PREFIX not in path
            if table not in TABLE_OF or not is_made_anew:
                continue
            now = look_at(self.state, path).fault
            if now is not None and now.code == "table_unreadable":
                yield now
            elif now is not None or not (self.state.output / "tables" / path).exists():
                yield replace(now or fault, message=f"not made anew: {NO_LOGS}")
            elif table in OF_MOTORS:
                for night in days_of(PurePosixPath(path).stem):
                    mended.setdefault(night, path)
        for night, path in mended.items():
            lost = [
                motor_id
                for motor_id, some in sorted(self._fitted.items())
                if night in some and night not in made.get(motor_id, ())
            ]
            if lost:
                message = f"rows of {', '.join(lost)} are not made anew: {NO_LOGS}"
                yield TableFault(path, "rows_lost", message)


def restore_decisions(state: State) -> None:
    """Put back decisions that a restored state file lacks, from the table of the last run.

    Raises StoreError if the state cannot be read or written.
    """
    path = whole_file(state.output, DECISIONS)
    try:
        rows = read_table(path, DECISIONS).drop("run_id").to_dicts() if path.exists() else []
    except StoreError as error:
        log.warning("%s; what people said is not put back from it", error)
        return
    if count := put_back(state, (Decision(**row) for row in rows)):
        log.warning("put back from the table `decisions`: %s", counted(count, "decision"))


def repair(state: State) -> tuple[tuple[TableFault, ...], tuple[TableFault, ...]]:
    """Put aside what is not as published, and let the next run make it anew.

    The caller holds the lock. What was put aside before goes, and what no run can make anew is
    missed no more. Returns the faults that were found, and those that are left.

    Raises StoreError if something cannot be read or written.
    """
    for name in files_there(state.output):
        if name.endswith(PUT_ASIDE):
            remove(state.output / "tables" / name)
    damage = Damage(state)
    damage.look_around(EVERY_DAY)
    lost = [one.path for one in damage.found.values() if one.code in LOST]
    note(state, {name: None for name in lost if not (state.output / "tables" / name).exists()})
    return tuple(damage.found.values()), tuple(verify_tables(state.output))

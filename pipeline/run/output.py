"""An output as a run finds it: whose it is, motors under other names than before, and damage.

A damaged file is renamed. The nights of a file that is gone are forgotten, so that they are made
anew from logs or stored blocks. Wherever a run is broken off, the next does the same again.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath

import polars as pl

from pipeline.config import Fleet
from pipeline.errors import StoreError, UsageError
from pipeline.logs.processed import forget_nights
from pipeline.notification.outbox import rename_motor
from pipeline.schema import DECISIONS, TABLES, Table
from pipeline.store.heartbeat import runs_back
from pipeline.store.published import (
    OF_MOTORS,
    OF_TRENDS,
    TableFault,
    accepted_digests,
    note,
    set_aside,
    verify_files,
)
from pipeline.store.publishing import Publisher
from pipeline.store.state import StateDatabase, read_state_file
from pipeline.store.tables import MONTH_PREFIX, days_of, files_of, read_table, whole_file
from pipeline.trends.tasks import note_touched

log = logging.getLogger(__name__)

FLEET = "fleet"  # of `meta`: the fleet's name
# Tables of the state file with a motor's rows.
OF_A_MOTOR = ("logs", "nights", "trends", "decisions")
# Rows of these are made anew from the night's stored blocks if its log is gone.
FROM_BLOCKS = {"parameters"}
LOST = ("table_altered", "table_missing")

# Nights by motor.
Nights = Mapping[str, Collection[dt.date]]


def require_own_output(fleet: Fleet) -> None:
    """Refuse the output of another fleet, before anything is written to it.

    Raises UsageError (``fleet_output``).
    """
    try:
        with read_state_file(fleet.output) as state:
            name = state.meta(FLEET) or next(runs_back(fleet.output), {}).get("fleet", "")
            motors = {motor_id for (motor_id,) in state.rows("SELECT motor_id FROM motors")}
    except StoreError:  # which the run mends, or names
        name, motors = "", set()
    own = {name for spec in fleet.motors for name in (spec.motor_id, spec.file.formerly)}
    if name in ("", fleet.name, fleet.formerly) and (not motors or motors & own):
        return
    raise UsageError(
        "fleet_output",
        f"{fleet.output} is of the fleet {name!r}, with other motors or another name than this "
        f"one, {fleet.name!r}; nothing was done: name another folder in `folders.output`, put the "
        "fleet's own state.db back, or, of a fleet that was renamed, write "
        f'formerly = "{name}" into its file',
    )


def claim_output(state: StateDatabase, staging: Path, fleet: Fleet) -> None:
    """Note whose output it is, and give motors that were renamed what is published of them.

    Each file is replaced whole, and the state last: where it is broken off, the next run goes on.
    """
    state.set_meta(FLEET, fleet.name)
    present = {spec.motor_id for spec in fleet.motors}
    known = {motor_id for (motor_id,) in state.rows("SELECT motor_id FROM motors")}
    for spec in fleet.motors:
        old, new = spec.file.formerly, spec.motor_id
        if old in known - present:
            _rename_rows(state, staging, old, new)
            with state.transaction():
                rename_motor(state, old, new)
                _rename_state(state, old, new)


def _rename_rows(state: StateDatabase, staging: Path, old: str, new: str) -> None:
    publisher = Publisher(state, staging, "")
    for table in TABLES:
        if "motor_id" in table.schema:
            for path in files_of(state.output, table):
                if MONTH_PREFIX in path.parent.name:
                    publisher.change(table, path.stem, partial(_rename, table, old, new))
    decisions = whole_file(state.output, DECISIONS)
    if decisions.exists():
        publisher.whole(DECISIONS, _rename(DECISIONS, old, new, read_table(decisions, DECISIONS)))


def _rename(table: Table, old: str, new: str, rows: pl.DataFrame) -> pl.DataFrame:
    """Return rows of a file under the new name; of a night under both names those under the old."""
    is_old = pl.col("motor_id") == old
    moved = rows.filter(is_old).with_columns(motor_id=pl.lit(new))
    if "id" in rows.columns:  # begins with the motor's name
        moved = moved.with_columns(pl.col("id").str.replace(f"{old} ", f"{new} ", literal=True))
    key = ["motor_id", "night"] if "night" in table.key else list(table.key)
    others = rows.filter(~is_old).join(moved, on=key, how="anti", nulls_equal=True)
    return pl.concat([others, moved]).sort(table.order)


def _rename_state(state: StateDatabase, old: str, new: str) -> None:
    state.write(
        "INSERT INTO motors SELECT ?, settings FROM motors WHERE motor_id = ?"
        " ON CONFLICT (motor_id) DO UPDATE SET settings = excluded.settings",
        *(new, old),
    )
    for table in OF_A_MOTOR:
        change = f"UPDATE OR REPLACE {table} SET motor_id = ? WHERE motor_id = ?"
        state.write(change, new, old)
    state.write("DELETE FROM motors WHERE motor_id = ?", old)
    # Of decisions that came back from the table under the new name, where this was broken off.
    key = "motor_id, indicator, time, kind, night"
    again = f"rowid NOT IN (SELECT min(rowid) FROM decisions GROUP BY {key})"
    state.write(f"DELETE FROM decisions WHERE {again}")


def find_damage(state: StateDatabase, *, every_file: bool = False) -> tuple[TableFault, ...]:
    """Name files that are gone or damaged, and rename these.

    Raises StoreError if the state cannot be read or written, or a file is not to be renamed.
    """
    sound, faults = [], []
    for file in verify_files(state, every_file=every_file):
        if file.fault is None:
            sound.append((file.name, file.sha256, file.accepted))
            continue
        faults.append(file.fault)
        log.warning("%s", file.fault)
        if file.fault.code == "table_altered":
            set_aside(state, file.name)
    with state.transaction():
        # An intraday check may have published meanwhile.
        note(
            state,
            {
                name: digest
                for name, digest, accepted in sound
                if accepted_digests(state, name) == accepted
            },
        )
    return tuple(faults)


def forget_lost(state: StateDatabase, faults: Sequence[TableFault]) -> Nights:
    """Let the nights of lost files be made anew; returns those of them that had a fit.

    Raises StoreError if the state cannot be written.
    """
    lost = [fault.path for fault in faults if fault.code in LOST]
    tables: defaultdict[dt.date, set[str]] = defaultdict(set)
    for name in lost:
        for night in _nights_of(name):
            tables[night].add(name.split("/")[0])
    touched = [
        days_of(PurePosixPath(name).stem)[0]
        for name in lost
        if name.split("/")[0] in OF_MOTORS | OF_TRENDS
    ]
    with state.transaction():
        refit = {night for night, names in tables.items() if names <= FROM_BLOCKS}
        fitted = forget_nights(state, tables, refit=refit)
        if touched:
            motors = state.rows("SELECT motor_id FROM trends")
            note_touched(state, ((motor_id, min(touched)) for (motor_id,) in motors))
        note(state, dict.fromkeys(lost))
    return fitted


def damage_left(faults: Sequence[TableFault], fitted: Nights, made: Nights) -> Iterator[TableFault]:
    """Yield what of the damage a run has not made up for, given the nights that it has made."""
    for fault in faults:
        if fault.code not in LOST:
            yield fault
            continue
        motors = sorted(
            motor_id
            for motor_id, nights in fitted.items()
            if set(nights).intersection(_nights_of(fault.path)).difference(made.get(motor_id, ()))
        )
        if motors:
            message = (
                f"rows of {', '.join(motors)} are not made anew: their logs are gone, or were not "
                "asked for; a run makes them where the logs are there"
            )
            yield TableFault(fault.path, "rows_lost", message)


def _nights_of(name: str) -> list[dt.date]:
    """Return nights of a file with rows of motors; none of another file."""
    return days_of(PurePosixPath(name).stem) if name.split("/")[0] in OF_MOTORS else []

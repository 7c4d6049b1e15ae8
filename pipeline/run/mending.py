"""Damage to an output: a run names it, and lets what was lost be made anew.

A damaged file is renamed. The nights of a file that is gone are forgotten, so that they are made
anew from logs or stored blocks. Wherever a run is broken off, the next one does the same again.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import PurePosixPath

from pipeline.logs.processed import forget_nights
from pipeline.store.published import (
    OF_MOTORS,
    OF_TRENDS,
    TableFault,
    accepted_digests,
    longest_unproven,
    note,
    set_aside,
    verify_files,
)
from pipeline.store.state import State
from pipeline.store.tables import days_of
from pipeline.trends.nights.trend_record import note_touched

log = logging.getLogger(__name__)

# Rows of these are made anew from the night's stored blocks if its log is gone.
FROM_BLOCKS = {"parameters"}
LOST = ("table_altered", "table_missing")

# Nights by motor.
Nights = Mapping[str, Collection[dt.date]]


def find_damage(state: State, *, every_file: bool = False) -> tuple[TableFault, ...]:
    """Name files that are gone or damaged, and rename these; prove others, or every one.

    Raises StoreError if the state cannot be read or written, or a file is not to be renamed.
    """
    sound, faults = [], []
    for file in verify_files(state, None if every_file else longest_unproven(state)):
        if file.fault is None:
            sound.append((file.name, file.sha256, file.accepted))
            continue
        faults.append(file.fault)
        log.warning("%s", file.fault)
        if file.fault.code == "table_altered":
            set_aside(state, file.name)
    with state.transaction():
        # An intraday check may have published one meanwhile.
        note(
            state,
            {
                name: digest
                for name, digest, accepted in sound
                if accepted_digests(state, name) == accepted
            },
        )
    return tuple(faults)


def forget_lost(state: State, faults: Sequence[TableFault]) -> Nights:
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
    """Return nights of a file with rows of motors; none of another one."""
    return days_of(PurePosixPath(name).stem) if name.split("/")[0] in OF_MOTORS else []

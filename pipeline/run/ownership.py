"""Which fleet an output is of, and motors of it under other names than before."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.config import Fleet
from pipeline.errors import StoreError, UsageError
from pipeline.notification.outbox import rename_motor
from pipeline.schema import DECISIONS, RUNS, TABLES, Table
from pipeline.store.publishing import Publisher
from pipeline.store.state import State, read_state_file
from pipeline.store.tables import MONTH_PREFIX, files_of, read_table, whole_file

FLEET = "fleet"  # of `meta`: the fleet's name
# Tables of the state file with a motor's rows.
OF_A_MOTOR = ("logs", "nights", "trends", "decisions")


@contextmanager
def own_output(fleet: Fleet) -> Iterator[None]:
    """Refuse the output of another fleet, before anything is written to it.

    Raises UsageError (``fleet_output``).
    """
    try:
        with read_state_file(fleet.output) as state:
            name = state.meta(FLEET) or _newest(fleet.output).get("fleet", "")
            motors = {motor_id for (motor_id,) in state.rows("SELECT motor_id FROM motors")}
    except StoreError:  # which the run mends, or names
        name, motors = "", set()
    own = {name for spec in fleet.motors for name in (spec.motor_id, spec.file.formerly)}
    if name in ("", fleet.name, fleet.formerly) and (not motors or motors & own):
        yield
        return
    raise UsageError(
        "fleet_output",
        f"{fleet.output} is of the fleet {name!r}, with other motors or another name than this "
        f"one, {fleet.name!r}; nothing was done: name another folder in `folders.output`, put the "
        "fleet's own state.db back, or, of a fleet that was renamed, write "
        f'formerly = "{name}" into its file',
    )


def claim_output(state: State, fleet: Fleet) -> None:
    """Note whose output it is."""
    state.set_meta(FLEET, fleet.name)


def newest_run(output: Path) -> str:
    """Return start of the newest run in the tables; empty without one that can be read."""
    start = _newest(output).get("started_at")
    return start.isoformat() if start else ""


def _newest(output: Path) -> dict[str, Any]:
    try:
        for path in reversed(files_of(output, RUNS)):
            rows = read_table(path, RUNS).sort("started_at")
            if not rows.is_empty():
                return rows.row(-1, named=True)
    except StoreError:  # which the run mends, or names
        pass
    return {}


def take_over_renamed(state: State, staging: Path, fleet: Fleet) -> None:
    """Give motors that were renamed what is published of them under the names before.

    Each file is replaced whole, and the state last: where it is broken off, the next run goes on.
    """
    present = {spec.motor_id for spec in fleet.motors}
    known = {motor_id for (motor_id,) in state.rows("SELECT motor_id FROM motors")}
    for spec in fleet.motors:
        old, new = spec.file.formerly, spec.motor_id
        if old in known - present:
            _rename_rows(state, staging, old, new)
            with state.transaction():
                rename_motor(state, old, new)
                _rename_state(state, old, new)


def _rename_rows(state: State, staging: Path, old: str, new: str) -> None:
    publisher = Publisher(state, staging, "")
    for table in TABLES:
        if "motor_id" in table.schema:
            for path in files_of(state.output, table):
                if MONTH_PREFIX in path.parent.name:
                    publisher.change(table, path.stem, partial(_renamed, table, old, new))
    decisions = whole_file(state.output, DECISIONS)
    if decisions.exists():
        publisher.whole(DECISIONS, _renamed(DECISIONS, old, new, read_table(decisions, DECISIONS)))


def _renamed(table: Table, old: str, new: str, rows: pl.DataFrame) -> pl.DataFrame:
    """Rows of a file under the new name; of a night under both names those under the old one."""
    is_old = pl.col("motor_id") == old
    moved = rows.filter(is_old).with_columns(motor_id=pl.lit(new))
    if "id" in rows.columns:  # begins with the motor's name
        moved = moved.with_columns(pl.col("id").str.replace(f"{old} ", f"{new} ", literal=True))
    key = ["motor_id", "night"] if "night" in table.key else list(table.key)
    others = rows.filter(~is_old).join(moved, on=key, how="anti", nulls_equal=True)
    return pl.concat([others, moved]).sort(table.order)


def _rename_state(state: State, old: str, new: str) -> None:
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

"""Retention: removal of table files of old nights.

Refits and trends are made from `blocks`, nothing from the others. A removal is announced
before the file goes: after a crash in between, the next pruning removes it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import UsageError
from pipeline.schema import TABLES
from pipeline.store.atomic_files import remove
from pipeline.store.published import announce, note
from pipeline.store.state import State
from pipeline.store.tables import days_of, files_of, name_of

# Tables that may be pruned, and what is lost with each.
LOSSES: Mapping[str, str] = {
    "predictions": "the report's course of measured and predicted flow",
    "residual_tests": "tests of the fit's errors, and their correlations lag by lag",
    "error_budget": "the share of each tolerance in ±; the sum stays in fits and parameters",
    "blocks": "a changed setting of the fit then needs the logs of these nights, and "
    "a watch that is made anew begins with the first night that is left",
}


@dataclass(frozen=True, slots=True)
class OldFiles:
    """Files of a table that are to be removed, and what is lost with them."""

    table: str
    # First and last night that they may have.
    first: dt.date
    last: dt.date
    names: tuple[str, ...]
    size_bytes: int
    loss: str


def require_prunable(tables: Sequence[str]) -> None:
    """Raise UsageError (``prune_table``) for a table that cannot be pruned."""
    if strangers := sorted(set(tables) - LOSSES.keys()):
        raise UsageError(
            "prune_table",
            f"{', '.join(strangers)} cannot be pruned; tables that can: {', '.join(LOSSES)}",
        )


def old_files(
    output: Path, kept: Mapping[str, int], newest_night: dt.date | None
) -> tuple[OldFiles, ...]:
    """Files older than the days kept of each table, back from the newest night; None: none are.

    A file of a month is as old as the last night of it.
    """
    found = []
    for table in TABLES:
        if newest_night is None or table.name not in kept:
            continue
        first_kept = newest_night - dt.timedelta(days=kept[table.name] - 1)
        old = [file for file in files_of(output, table) if days_of(file.stem)[-1] < first_kept]
        if old:
            first, last = days_of(old[0].stem)[0], days_of(old[-1].stem)[-1]
            names = tuple(name_of(output, path) for path in old)
            size = sum(path.stat().st_size for path in old)
            found.append(OldFiles(table.name, first, last, names, size, LOSSES[table.name]))
    return tuple(found)


def prune(state: State, old: Sequence[OldFiles]) -> None:
    """Remove such files; the caller holds the output's lock.

    Raises StoreError if the state cannot be written or a file not be removed; pruning again does
    the rest.
    """
    names = [name for months in old for name in months.names]
    announce(state, dict.fromkeys(names))
    for name in names:
        path = state.output / "tables" / name
        remove(path)
        with suppress(OSError):  # not empty
            path.parent.rmdir()
    note(state, dict.fromkeys(names))

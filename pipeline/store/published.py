"""Published table files: the SHA-256 of each, in the state file, proves it, its footer included.

Before a file is put into its place the digest that comes is noted beside its own: wherever a run
was broken off, a file is as it was or as it comes, and both are right. Page checksums, which do not
cover a footer, alone prove a file that is not listed, as the state file was lost.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.errors import StoreError, UsageError
from pipeline.schema import BLOCKS, NIGHT_TABLES, NIGHTS, TABLES, TREND_TABLES
from pipeline.store.atomic_files import move, remove
from pipeline.store.state import STATE_FILE, StateDatabase, is_sound, read_state_file
from pipeline.store.tables import ENDING, MONTH_PREFIX, days_of, files_of, from_parquet, name_of

TABLE_OF = {table.name: table for table in TABLES}
# A night's own part of `nights` is of its motor's task.
OF_MOTORS = {table.name for table in (NIGHTS, *NIGHT_TABLES)}
OF_TRENDS = {table.name for table in TREND_TABLES}
# Stands for no file where a digest is expected.
NO_FILE = ""
# Ending of a damaged file: no reader takes it for a table.
ASIDE = ".damaged"
# Tables that may be pruned, and what is lost with each.
LOSSES: Mapping[str, str] = {
    "predictions": "the report's course of measured and predicted flow",
    "residual_tests": "tests of the fit's errors, and their correlations lag by lag",
    "error_budget": "the share of each tolerance in ±; the sum stays in fits and parameters",
    "blocks": "a changed setting of the fit then needs the logs of these nights, and "
    "a watch that is made anew has the nights that are left; those of a baseline in force stay",
}


@dataclass(frozen=True, slots=True)
class TableFault:
    """A damaged, missing or unknown file."""

    path: str  # relative to the folder of the tables; of another file, to the output folder
    # ``table_altered``, ``table_missing``, ``table_unreadable``, ``table_unlisted``, ``rows_lost``
    # or ``state_damaged``.
    code: str
    message: str  # the fault, and a remedy

    def __str__(self) -> str:
        return f"{self.code}: {self.path}: {self.message}"


def announce(state: StateDatabase, coming: Mapping[str, str | None]) -> None:
    """Note what comes into the places of files: SHA-256 by name; None: the file goes."""
    state.write_all(
        "INSERT INTO files (name, sha256, coming) VALUES (?, '', ?)"
        " ON CONFLICT (name) DO UPDATE SET coming = excluded.coming",
        [(name, digest or NO_FILE) for name, digest in coming.items()],
    )


def note(state: StateDatabase, files: Mapping[str, str | None]) -> None:
    """Note files that are in their places: SHA-256 by name; None: there is none."""
    rows = [
        (name, digest, *_stamp(state.output, name))
        for name, digest in files.items()
        if digest is not None
    ]
    with state.transaction():
        state.write_all("DELETE FROM files WHERE name = ?", ((name,) for name in files))
        state.write_all(
            "INSERT INTO files (name, sha256, size, modified_ns) VALUES (?, ?, ?, ?)", rows
        )


def _stamp(output: Path, name: str) -> tuple[int, int]:
    """Return size and time of a file, which differ once it is written to; zeros: gone."""
    try:
        status = os.stat(f"{output}/tables/{name}")  # noqa: PTH116 - thousands in every run
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns


@dataclass(frozen=True, slots=True)
class VerifiedFile:
    """A file that was read; without content and digest where there is none to be read."""

    name: str
    accepted: frozenset[str]  # digests that it may have, `NO_FILE` among them for none
    content: bytes = b""
    sha256: str | None = None
    fault: TableFault | None = None


def accepted_digests(state: StateDatabase, name: str) -> frozenset[str]:
    """Return digests that a file may have; none where it is not listed."""
    listed = state.rows("SELECT sha256, coming FROM files WHERE name = ?", name)
    return frozenset(digest for row in listed for digest in row if digest is not None)


def verify_file(state: StateDatabase, name: str) -> VerifiedFile:
    """Read a file and compare it; with a fault twice, as a run may have published it in between.

    Raises StoreError (``store_newer``) for an unlisted file of a newer version of the program.
    """
    file = _verify(state, name)
    return file if file.fault is None else _verify(state, name)


def _verify(state: StateDatabase, name: str) -> VerifiedFile:
    accepted = accepted_digests(state, name)
    try:
        content = (state.output / "tables" / name).read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        file, code, message = VerifiedFile(name, accepted), "table_missing", "the file is gone"
    except OSError as error:
        message = f"it cannot be read: {error.strerror}; correct its permissions, or the disk"
        return VerifiedFile(name, accepted, fault=TableFault(name, "table_unreadable", message))
    else:
        file = VerifiedFile(name, accepted, content, hashlib.sha256(content).hexdigest())
        code, message = "table_altered", "it is not what was published"
        if not accepted and _is_whole(state.output / "tables" / name, name.split("/")[0], content):
            return file
    if (file.sha256 or NO_FILE) in (accepted or {NO_FILE}):
        return file
    return replace(file, fault=TableFault(name, code, f"{message}; {_remedy(name)}"))


def _is_whole(path: Path, table: str, content: bytes) -> bool:
    """Return True where the page checksums of a file prove it and its nights are of its name."""
    try:
        rows = from_parquet(path, TABLE_OF[table], content)
    except StoreError as error:
        if error.code == "store_newer":
            raise
        return False
    has_nights = MONTH_PREFIX in path.parent.name and "night" in rows.columns
    return not has_nights or set(rows["night"].drop_nulls()) <= set(days_of(path.stem))


def _remedy(name: str) -> str:
    table = name.split("/")[0]
    if table in OF_MOTORS:
        return "`fit-fleet --repair` makes it anew where the logs of its nights are there"
    if table in OF_TRENDS or MONTH_PREFIX not in name:
        return "`fit-fleet --repair` makes it anew"
    return "nothing makes it anew"


def verify_files(state: StateDatabase, *, every_file: bool = False) -> Iterator[VerifiedFile]:
    """Read the files that are gone, were written to since, or are not listed; or all."""
    rows = state.rows("SELECT name, size, modified_ns FROM files WHERE coming IS NULL")
    as_noted = {name for name, *stamp in rows if tuple(stamp) == _stamp(state.output, name)}
    listed = {name for (name,) in state.rows("SELECT name FROM files")}
    for name in sorted(listed.union(_published_names(state.output))):
        if every_file or name not in as_noted:
            yield verify_file(state, name)


def _published_names(output: Path) -> Iterator[str]:
    """Return names of the files that are in places of tables."""
    return (name_of(output, path) for table in TABLES for path in files_of(output, table))


def set_aside(state: StateDatabase, name: str) -> None:
    """Rename a damaged file; the next run finds it gone, and lets it be made anew."""
    path = state.output / "tables" / name
    with suppress(FileNotFoundError):
        move(path, path.with_suffix(ASIDE))


def faults_of(output: Path) -> tuple[TableFault, ...]:
    """Return faults of the published files that are gone, or were written to since."""
    with read_state_file(output) as state:
        return tuple(file.fault for file in verify_files(state) if file.fault)


def verify_tables(output: Path) -> Iterator[TableFault]:
    """Yield faults of all files of an output: each is read; a run may be publishing meanwhile."""
    if not is_sound(output):
        message = "the next run makes it anew from logs and tables"
        yield TableFault(STATE_FILE, "state_damaged", message)
        return
    with read_state_file(output) as state:
        yield from (file.fault for file in verify_files(state, every_file=True) if file.fault)
        there = (name_of(output, path) for path in (output / "tables").rglob(f"*{ENDING}"))
        for name in sorted(set(there).difference(_published_names(output))):
            message = "it was not published by a run; delete it"
            yield TableFault(name, "table_unlisted", message)


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
    output: Path,
    days: Mapping[str, int],
    newest_night: dt.date | None,
    of_baselines: Collection[dt.date] = (),
) -> tuple[OldFiles, ...]:
    """Return files older than the days of their table; a month is as old as its last night.

    Blocks of `of_baselines` stay: a watch that is made anew, as by a late log, begins with them.
    """
    stale = []
    for table in TABLES:
        if newest_night is None or table.name not in days:
            continue
        first_day = newest_night - dt.timedelta(days=days[table.name] - 1)
        needed = set(of_baselines) if table is BLOCKS else set()
        old = [file for file in files_of(output, table) if days_of(file.stem)[-1] < first_day]
        old = [file for file in old if needed.isdisjoint(days_of(file.stem))]
        if old:
            first, last = days_of(old[0].stem)[0], days_of(old[-1].stem)[-1]
            names = tuple(name_of(output, path) for path in old)
            size = sum(path.stat().st_size for path in old)
            stale.append(OldFiles(table.name, first, last, names, size, LOSSES[table.name]))
    return tuple(stale)


def prune(state: StateDatabase, old: Sequence[OldFiles]) -> None:
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

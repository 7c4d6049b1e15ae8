"""Published table files: the SHA-256 of each proves it, its footer included.

The state file lists them. Before a file is put into its place the digest that comes is noted
beside its own, afterwards alone: wherever a run was broken off, a file is as it was or as it comes,
and both are right. Page checksums do not cover a footer, and a query engine compares neither.

All raise StoreError if the state file cannot be read or written.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.schema import NIGHT_TABLES, TABLES, TREND_TABLES, Table
from pipeline.store.atomic_files import TEMPORARY_PREFIX, put
from pipeline.store.state import STATE_FILE, State, is_sound, read_state_file
from pipeline.store.tables import (
    MONTH_PREFIX,
    PUT_ASIDE,
    days_of,
    from_parquet,
    name_of,
)

# List of all files and their SHA-256 for others to compare, written at a run's end.
MANIFEST_FILE = "manifest.json"
TABLE_OF = {table.name: table for table in TABLES}
OF_MOTORS = {table.name for table in NIGHT_TABLES}
OF_TRENDS = {table.name for table in TREND_TABLES}
AGAIN = "a run makes it anew"
# Stands for no file where a digest is expected.
NO_FILE = ""


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


def announce(state: State, coming: Mapping[str, str | None]) -> None:
    """Note what comes into the places of files: SHA-256 by name; None: the file goes."""
    state.write_all(
        "INSERT INTO files (name, sha256, coming) VALUES (?, '', ?)"
        " ON CONFLICT (name) DO UPDATE SET coming = excluded.coming",
        [(name, digest or NO_FILE) for name, digest in coming.items()],
    )


def note(state: State, files: Mapping[str, str | None]) -> None:
    """Note files that are in their places: SHA-256 by name; None: there is none."""
    now = dt.datetime.now(dt.UTC).isoformat()
    rows = [
        (name, digest, *_stamp(state.output, name), now)
        for name, digest in files.items()
        if digest is not None
    ]
    with state.transaction():
        state.write_all("DELETE FROM files WHERE name = ?", ((name,) for name in files))
        state.write_all(
            "INSERT INTO files (name, sha256, size, modified_ns, proven) VALUES (?, ?, ?, ?, ?)",
            rows,
        )


def accepted(state: State, name: str) -> tuple[str, ...]:
    """Digests that a file may have, `NO_FILE` among them for none; empty where it is not listed."""
    rows = state.rows("SELECT sha256, coming FROM files WHERE name = ?", name)
    return tuple(one for row in rows for one in row if one is not None)


def distrust(state: State, name: str) -> None:
    """Let the next run look at a file, whatever it is now."""
    state.write(
        "INSERT INTO files (name, sha256, modified_ns) VALUES (?, 'unknown', -1)"
        " ON CONFLICT (name) DO UPDATE SET modified_ns = -1",
        name,
    )


def _stamp(output: Path, name: str) -> tuple[int, int]:
    """Size and time of a file, which differ once it was written to; zeros where it is gone."""
    try:
        found = os.stat(f"{output}/tables/{name}")  # noqa: PTH116 - thousands in every run
    except OSError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


def share_due(state: State, days: int, now: dt.datetime | None = None) -> set[str]:
    """Files that a run proves, the longest unproven first, so that all are within some days."""
    overdue = ((now or dt.datetime.now(dt.UTC)) - dt.timedelta(days)).isoformat()
    rows = state.rows("SELECT name, proven FROM files ORDER BY proven, name")
    share = ceil(len(rows) / days)
    return {name for place, (name, proven) in enumerate(rows) if place < share or proven <= overdue}


@dataclass(frozen=True, slots=True)
class Looked:
    """A file that was looked at; without content and digest where there is none to be read."""

    name: str
    content: bytes = b""
    sha256: str | None = None
    fault: TableFault | None = None


def digests_here(state: State) -> dict[str, str]:
    """SHA-256 of listed files as they were noted; those that were written to since are left out."""
    rows = state.rows("SELECT name, sha256, size, modified_ns FROM files WHERE coming IS NULL")
    return {name: one for name, one, *stamp in rows if tuple(stamp) == _stamp(state.output, name)}


def look_at_files(state: State, due: Collection[str] | None = ()) -> Iterator[Looked]:
    """Read the published files that are gone, were written to since, or are due; None: all are."""
    as_noted = digests_here(state)
    for (name,) in state.rows("SELECT name FROM files ORDER BY name"):
        if due is None or name in due or name not in as_noted:
            yield look_at(state, name)


def look_at(state: State, name: str) -> Looked:
    """Read a file and compare it.

    A fault is looked at twice: a run may have published the file in between, or a read have failed.
    """
    looked = _look_at(state, name)
    return looked if looked.fault is None else _look_at(state, name)


def _look_at(state: State, name: str) -> Looked:
    known = accepted(state, name)
    try:
        content = (state.output / "tables" / name).read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        looked, code, message = Looked(name), "table_missing", "the file is gone"
    except OSError as error:
        message = f"it cannot be read: {error.strerror}; correct its permissions, or the disk"
        return Looked(name, fault=TableFault(name, "table_unreadable", message))
    else:
        looked = Looked(name, content, hashlib.sha256(content).hexdigest())
        code, message = "table_altered", "it is not what was published"
    if known and (looked.sha256 or NO_FILE) not in known:
        return replace(looked, fault=TableFault(name, code, f"{message}; {_again(name)}"))
    return looked


def _again(name: str) -> str:
    """The words for a file that is damaged or gone: who makes it anew."""
    table = name.split("/")[0]
    if table in OF_MOTORS:
        return f"{AGAIN} where the logs of that night are there"
    if table in OF_TRENDS or MONTH_PREFIX not in name:
        return AGAIN
    return "it told of a run, and nothing makes it anew"


def faults_of(output: Path) -> tuple[TableFault, ...]:
    """Faults of the published files that are gone, or written to since."""
    with read_state_file(output) as state:
        return tuple(one.fault for one in look_at_files(state) if one.fault is not None)


def verify_tables(output: Path) -> Iterator[TableFault]:
    """Faults of all files of an output: each is read; a run may be publishing meanwhile."""
    if not is_sound(output):
        message = "the next run makes it anew from logs and tables"
        yield TableFault(STATE_FILE, "state_damaged", message)
        return
    with read_state_file(output) as state:
        there = files_there(output)  # before the list: a run announces a file first
        yield from (one.fault for one in look_at_files(state, None) if one.fault is not None)
        for name in there:
            if not (accepted(state, name) or name.endswith(PUT_ASIDE)):
                message = "it was not published by a run; delete it"
                yield TableFault(name, "table_unlisted", message)


def files_there(output: Path) -> list[str]:
    """Names of all files below the folder of the tables."""
    tables = output / "tables"
    return [
        name_of(output, Path(folder, file))
        for folder, _, files in os.walk(tables)
        for file in sorted(files)
        if not file.startswith(TEMPORARY_PREFIX)
    ]


def proves_itself(path: Path, table: Table, content: bytes) -> bool:
    """True where the own checksums of a file's content prove it, and its nights are those named.

    Raises StoreError if it is of a newer version of the program.
    """
    try:
        rows = from_parquet(path, table, content)
    except StoreError as error:
        if error.code == "store_newer":
            raise
        return False
    has_nights = MONTH_PREFIX in path.parent.name and "night" in rows.columns
    return not has_nights or set(rows["night"].drop_nulls()) <= set(days_of(path.stem))


def write_manifest(state: State) -> None:
    """Write the list of published files for others."""
    files = dict(state.rows("SELECT name, sha256 FROM files ORDER BY name"))
    put(state.output / MANIFEST_FILE, json.dumps({"sha256": files}, indent=0).encode())

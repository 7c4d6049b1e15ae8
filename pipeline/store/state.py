"""The state of an output folder: a SQLite file, `state.db`, with all that is no analyst's table.

The holder of the run's lock writes all but the decisions and what the intraday check delivers.
Workers never open it: SQLite's log does not work across machines. It can be lost: the logs and
tables give the same tables again, and the table `decisions` what people have said.
"""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

from pipeline.errors import StoreError
from pipeline.store.atomic_files import make_folders, move, store_errors

log = logging.getLogger(__name__)

STATE_FILE = "state.db"
STATE_FILES = (STATE_FILE, f"{STATE_FILE}-wal", f"{STATE_FILE}-shm")
# Of `PRAGMA user_version`: an earlier output is put aside and made anew from the logs.
VERSION = 4
# What a run leaves in an output folder; the state comes last, as it says of which version all is.
OUTPUT = ("tables", "report", "views.sql", *STATE_FILES[::-1])
# Of `meta`: start of the last run.
LAST_RUN = "last_run"
# So long a command waits for the transaction of another process [s].
BUSY_S = 30.0

SCHEMA = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE motors (motor_id TEXT PRIMARY KEY, settings TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE logs (
    motor_id TEXT NOT NULL REFERENCES motors, path TEXT NOT NULL,
    size INTEGER NOT NULL, modified_ns INTEGER NOT NULL, sha256 TEXT, read_with TEXT NOT NULL,
    rows INTEGER, first_us INTEGER, last_us INTEGER, nights TEXT NOT NULL, status TEXT NOT NULL,
    error_code TEXT, message TEXT, inode INTEGER NOT NULL, changed_ns INTEGER NOT NULL,
    PRIMARY KEY (motor_id, path)
) WITHOUT ROWID;
CREATE TABLE nights (
    motor_id TEXT NOT NULL REFERENCES motors, night TEXT NOT NULL, status TEXT NOT NULL,
    statistics_hash TEXT NOT NULL, figures_hash TEXT NOT NULL, roller_identified INTEGER,
    logs TEXT NOT NULL, stays TEXT NOT NULL, refused TEXT NOT NULL, row TEXT,
    PRIMARY KEY (motor_id, night)
) WITHOUT ROWID;
CREATE TABLE files (
    name TEXT PRIMARY KEY, sha256 TEXT NOT NULL, coming TEXT,
    size INTEGER NOT NULL DEFAULT 0, modified_ns INTEGER NOT NULL DEFAULT 0
) WITHOUT ROWID;
CREATE TABLE trends (
    motor_id TEXT PRIMARY KEY, trend_hash TEXT NOT NULL, last_night TEXT NOT NULL,
    redo_from TEXT, checkpoint BLOB
);
CREATE TABLE queues (
    topic TEXT NOT NULL, receiver TEXT NOT NULL, notified_since TEXT NOT NULL,
    fault TEXT NOT NULL DEFAULT '', summarised TEXT NOT NULL DEFAULT '',
    PRIMARY KEY (topic, receiver)
) WITHOUT ROWID;
CREATE TABLE notices (
    topic TEXT NOT NULL, receiver TEXT NOT NULL, key TEXT NOT NULL, said TEXT NOT NULL,
    times INTEGER NOT NULL, since TEXT NOT NULL, tries INTEGER NOT NULL,
    PRIMARY KEY (topic, receiver, key),
    FOREIGN KEY (topic, receiver) REFERENCES queues ON DELETE CASCADE
) WITHOUT ROWID;
CREATE TABLE decisions (
    motor_id TEXT NOT NULL, indicator TEXT NOT NULL, time TEXT NOT NULL, kind TEXT NOT NULL,
    night TEXT NOT NULL, finding TEXT, note TEXT NOT NULL, worn TEXT, sound TEXT
);
"""


class StateDatabase:
    """The open state file of an output folder."""

    def __init__(self, output: Path, connection: sqlite3.Connection) -> None:
        self.output = output
        self._connection = connection

    def rows(self, query: str, *values: Any) -> list[tuple[Any, ...]]:
        """Return rows of a query; raises StoreError (``store_read``)."""
        with _errors("store_read"):
            return self._connection.execute(query, values).fetchall()

    def write(self, statement: str, *values: Any) -> None:
        """Change something, by itself or in the transaction that is open; raises StoreError."""
        with _errors("store_write"):
            self._connection.execute(statement, values)

    def write_all(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        """Change something for each of some rows of values, as `write`."""
        with self.transaction(), _errors("store_write"):
            self._connection.executemany(statement, rows)

    def meta(self, name: str) -> str:
        """Return a value by its name; empty where there is none."""
        rows = self.rows("SELECT value FROM meta WHERE name = ?", name)
        return str(rows[0][0]) if rows else ""

    def set_meta(self, name: str, value: str) -> None:
        """Keep a value by its name."""
        self.write("INSERT OR REPLACE INTO meta VALUES (?, ?)", name, value)

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Do changes whole, on the disk, or not at all; within another it is part of that.

        Raises StoreError if they cannot be written.
        """
        if self._connection.in_transaction:
            yield
            return
        self.write("BEGIN IMMEDIATE")
        try:
            yield
            self.write("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                self._connection.rollback()
            raise


@contextmanager
def _errors(code: str) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        how = "read" if code == "store_read" else "written"
        raise StoreError(code, f"{STATE_FILE} cannot be {how}: {error}") from error


@contextmanager
def open_state(output: Path) -> Iterator[StateDatabase]:
    """Open the state file for changes; it is made where there is none.

    Raises StoreError: ``store_write``; ``store_newer``, ``store_older``: it is of another version
    of the program.
    """
    with store_errors(output):
        make_folders(output)
    with _errors("store_write"):
        connection = sqlite3.connect(
            output / STATE_FILE,
            timeout=BUSY_S,
            isolation_level=None,
            check_same_thread=False,  # tasks are drawn by other threads, too
        )
    with closing(connection):
        state = StateDatabase(output, connection)
        for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
            state.write(f"PRAGMA {pragma}")
        if _version(state) == 0:
            with state.transaction():
                if _version(state) == 0:  # nobody else was faster
                    _make_tables(state)
        yield state


@contextmanager
def read_state_file(output: Path) -> Iterator[StateDatabase]:
    """Open the state file for reading; an empty state where there is none.

    Raises StoreError as `open_state`.
    """
    place = (output / STATE_FILE).resolve()
    with ExitStack() as stack:
        with _errors("store_read"):
            state = None
            if place.exists():
                state = StateDatabase(output, stack.enter_context(closing(_reader(place))))
            # Where a first run has only just begun there is nothing in it yet.
            if state is None or not _version(state):
                empty = sqlite3.connect(":memory:", isolation_level=None)
                state = StateDatabase(output, stack.enter_context(closing(empty)))
                _make_tables(state)
        state.write("PRAGMA query_only = ON")
        yield state


def _reader(place: Path) -> sqlite3.Connection:
    """Return connection to a file; if nothing can be written beside it, at rest."""
    connection = sqlite3.connect(
        f"{place.as_uri()}?mode=rw", timeout=BUSY_S, isolation_level=None, uri=True
    )
    try:
        connection.execute("PRAGMA schema_version")
    except sqlite3.OperationalError:
        connection.close()
        connection = sqlite3.connect(
            f"{place.as_uri()}?mode=ro&immutable=1", isolation_level=None, uri=True
        )
    return connection


def _make_tables(state: StateDatabase) -> None:
    for statement in SCHEMA.split(";\n"):
        state.write(statement)
    state.write(f"PRAGMA user_version = {VERSION}")


def _version(state: StateDatabase) -> int:
    ((version,),) = state.rows("PRAGMA user_version")
    if version > VERSION:
        message = f"{STATE_FILE} is of version {version}; update the program"
        raise StoreError("store_newer", message)
    if 0 < version < VERSION:
        what = "`fit-fleet` puts this output aside and makes it anew from the logs"
        raise StoreError("store_older", f"{STATE_FILE} is of an earlier version; {what}")
    return int(version)


def make_ready(output: Path, newest_run: Mapping[str, Any] | None = None) -> None:
    """Put aside a damaged or older state file, or an output of an earlier version.

    Raises StoreError if a file cannot be moved, or is of a newer version of the program.
    """
    version = _version_of(output / STATE_FILE)
    if version is None:
        _put_aside(output, STATE_FILES, f"{STATE_FILE} is damaged, and made anew from the tables")
    elif 0 < version < VERSION:
        _put_aside(output, OUTPUT, "the output is of an earlier version")
    elif version and newest_run and _is_older(output, newest_run["started_at"].isoformat()):
        _put_aside(output, STATE_FILES, f"{STATE_FILE} is older than the tables")
    elif version == 0 and (output / "tables").is_dir():
        log.warning("%s is gone; it is made anew from logs and tables", STATE_FILE)


def _put_aside(output: Path, names: Sequence[str], why: str) -> None:
    aside = next(place for n in count(1) if not (place := output / f"old-{n}").exists())
    log.warning("%s: put aside in %s; all nights are made anew from their logs", why, aside.name)
    with store_errors(aside):
        make_folders(aside)
    for name in names:
        if (output / name).exists():
            move(output / name, aside / name)


def _is_older(output: Path, newest_run: str) -> bool:
    with read_state_file(output) as state:
        return state.meta(LAST_RUN) < newest_run


def is_sound(output: Path) -> bool:
    """Return True for a state file that SQLite finds whole, and where there is none."""
    return _version_of(output / STATE_FILE) is not None


def _version_of(place: Path) -> int | None:
    """Return version of a file; 0 where there is none or it is empty, None where it is damaged."""
    if not place.exists():
        return 0
    try:
        with closing(_reader(place.resolve())) as connection:
            if connection.execute("PRAGMA quick_check(1)").fetchall() != [("ok",)]:
                return None
            return int(connection.execute("PRAGMA user_version").fetchone()[0])
    except sqlite3.OperationalError as error:  # which says nothing of its content
        raise StoreError("store_write", f"{place.name} cannot be opened: {error}") from error
    except sqlite3.DatabaseError:
        return None

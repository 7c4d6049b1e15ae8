"""Outputs of clones from before `state.db`, which had a file a night: taken over once.

Their tables and decisions stay. What else they knew is as if it was lost: nights are made anew from
their logs, and stay as they are where these are gone. May go in 2028, with its test.
"""

from __future__ import annotations

import logging
import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree

import polars as pl
from pydantic import TypeAdapter

from pipeline.errors import StoreError
from pipeline.schema import NIGHTLY_TABLES, TABLES, WHOLE_TABLES, Table
from pipeline.store.atomic_files import move, remove
from pipeline.store.locks import locked
from pipeline.store.state import State
from pipeline.store.tables import (
    ENDING,
    MONTH_PREFIX,
    PUT_ASIDE,
    labelled_file,
    read_table,
    table_folder,
    write_table,
)
from pipeline.trends.nights.decisions import Decision, put_back

log = logging.getLogger(__name__)

OLD_FOLDERS = ("manifest", "ledger", "history")
JOURNAL = "decisions.jsonl"
DECISION = TypeAdapter(Decision)
OLD_FILES = (JOURNAL, "decisions.damaged", "outbox.json", "outbox.copy.json")
# Of a night, of a day of looks, and of a run.
OLD_NAME = re.compile(r"(looks-)?\d{4}-\d{2}-\d{2}|\d{8}T\d{12}Z")
MONTHLY = tuple(one for one in TABLES if one not in (*NIGHTLY_TABLES, *WHOLE_TABLES))


@contextmanager
def taken_over(state: State) -> Iterator[bool]:
    """Join an old output's files to those of months, and yield whether it was an old one.

    The caller, who holds the lock, then takes stock. Where that is broken off the next run goes on;
    until then a query may see rows twice.

    Raises LockedError while a look is under way; StoreError if a file cannot be written, or is of a
    newer version of the program.
    """
    output = state.output
    old = _old_files(output)
    is_old = bool(old) or any((output / name).exists() for name in (*OLD_FOLDERS, *OLD_FILES))
    if not is_old:
        yield False
        return
    log.warning("the output is of an older version; its tables and decisions are taken over")
    with locked(output / "look"):
        for (month, table), paths in old.items():
            _join(labelled_file(output, table, month), table, paths)
    put_back(state, _decisions(output / JOURNAL))
    yield True
    for folder in (*(output / name for name in OLD_FOLDERS), *(output / "look").glob("*/")):
        rmtree(folder, ignore_errors=True)
    for path in (*(output / name for name in OLD_FILES), *(output / "look").glob("outbox.*")):
        remove(path)


def _old_files(output: Path) -> dict[tuple[str, Table], list[Path]]:
    """Files that are not a month's, in order, by month and table."""
    found: defaultdict[tuple[str, Table], list[Path]] = defaultdict(list)
    for table in MONTHLY:
        for path in sorted(table_folder(output, table).glob(f"{MONTH_PREFIX}*/*{ENDING}")):
            if OLD_NAME.fullmatch(path.stem):
                found[path.parent.name.removeprefix(MONTH_PREFIX), table].append(path)
    return found


def _join(place: Path, table: Table, paths: list[Path]) -> None:
    """Make one file of those of a month's nights; damaged ones are put aside."""
    parts = []
    for path in (place, *paths) if place.exists() else paths:
        try:
            parts.append(read_table(path, table))
        except StoreError as error:
            if error.code != "store_read":
                raise
            log.warning("%s; its nights are made anew where their logs are there", error)
            move(path, path.with_suffix(PUT_ASIDE))
    if parts:
        rows = pl.concat(parts).unique(table.key, keep="last", maintain_order=True)
        write_table(place, rows.sort(table.order))
    for path in paths:
        remove(path)


def _decisions(journal: Path) -> Iterator[Decision]:
    """Decisions in an old journal; damaged lines are left out."""
    content = journal.read_bytes() if journal.exists() else b""
    for line in content.splitlines():
        with suppress(ValueError):
            decision = DECISION.validate_json(line)
            # Times without a zone do not compare with others.
            if decision.time.tzinfo is not None:
                yield decision

"""Outputs of versions up to 0.9 (a file a night, a run, a day of looks): taken over once.

Each month of a small table becomes one file. May go in 2028, with its test.
"""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import polars as pl

from pipeline.errors import LockedError, StoreError
from pipeline.schema import LOOKS, NIGHTLY_TABLES, TABLES, WHOLE_TABLES, Table
from pipeline.store.atomic_files import move, read, remove, remove_all
from pipeline.store.encoding import prepare_table
from pipeline.store.locks import locked
from pipeline.store.manifest import MONTH_PREFIX, WHOLE, update_manifest
from pipeline.store.sealed import read_if_whole, unseal
from pipeline.store.tables import (
    ENDING,
    PUT_ASIDE,
    damaged,
    groups_of,
    month_file,
    month_stamps,
    name_of,
)

log = logging.getLogger(__name__)

# Lets the nights of table files be made anew, by the files' names.
Forget = Callable[[list[str]], object]
# SHA-256 that a file may have, by its name.
Listed = Mapping[str, tuple[str | None, ...]]
# Of a night, of a day of looks, and of a run.
OLD_NAME = re.compile(r"(looks-)?\d{4}-\d{2}-\d{2}|\d{8}T\d{12}Z")
MONTHLY = tuple(one for one in TABLES if one not in (*NIGHTLY_TABLES, *WHOLE_TABLES))
OLD_TABLES = {table.name for table in MONTHLY}


def take_over(output: Path, forget: Forget) -> None:
    """Put the tables of an older version into files of months; the caller holds the lock.

    Where that is broken off, the next run goes on; until then a query may see rows twice.

    Raises StoreError if a file cannot be written, or is of a newer version of the program.
    """
    folders = sorted((output / "manifest").glob(f"{MONTH_PREFIX}*"))
    listed = {name: some for folder in folders for name, some in _listed(folder)}
    old = {(table, month) for table in MONTHLY for month in _old_months(output, table)}
    months = {folder.name.removeprefix(MONTH_PREFIX) for folder in folders}
    months |= {month for _, month in old}
    if months:
        log.warning("the tables are of an older version: each month becomes one file")
    for month in sorted(months):
        tables = [table for table in MONTHLY if (table, month) in old]
        with suppress(LockedError), _looks_held(output, tables):
            _take_month(output, month, tables, listed, forget)


@contextmanager
def _looks_held(output: Path, tables: Sequence[Table]) -> Iterator[None]:
    """Hold the lock of looks, if their tables are taken over."""
    with locked(output / "look") if LOOKS in tables else nullcontext():
        yield


def _listed(folder: Path) -> Iterator[tuple[str, tuple[str | None, ...]]]:
    """Files of the old manifests of a month, and what each may be."""
    for path in sorted(folder.glob("*.json")):
        document = read_if_whole(path, unseal) or {"files": {}, "coming": {}}
        yield from ((name, (digest,)) for name, digest in document["files"].items())
        yield from ((name, tuple(some)) for name, some in document["coming"].items())


def _old_months(output: Path, table: Table) -> list[str]:
    """Months of a table with files that are not the month's."""
    return [month for month in month_stamps(output, table) if _sources(output, table, month)]


def _sources(output: Path, table: Table, month: str) -> list[Path]:
    paths = month_file(output, table, month).parent.glob(f"*{ENDING}")
    return sorted(path for path in paths if OLD_NAME.fullmatch(path.stem))


def _take_month(
    output: Path, month: str, tables: Sequence[Table], listed: Listed, forget: Forget
) -> None:
    """Take a month over: its files, and then its manifest."""
    folder = f"{MONTH_PREFIX}{month}"
    files: dict[str, str | None] = {}
    old: list[Path] = []
    for table in tables:
        place, sources = month_file(output, table, month), _sources(output, table, month)
        name, there = name_of(output, place), {name_of(output, path) for path in sources}
        known = {one for one in listed if one.startswith(f"{table.name}/{folder}/")} - {name}
        # One that is there and was not listed has all of them: this was broken off.
        gone = set() if place.exists() and name not in listed else known - there
        parts = []
        for path in (place, *sources):
            try:
                parts.append(_rows(output, path, table, listed))
            except StoreError as error:
                if error.code != "store_read":
                    raise
                log.warning("%s; its nights are made anew", error)
                gone.add(name_of(output, path))
                forget([name_of(output, path)])
                move(path, path.with_suffix(PUT_ASIDE))
        forget(sorted(gone - there))
        rows = pl.concat(parts).unique(table.key, keep="last", maintain_order=True)
        prepared = prepare_table(place, [rows.sort(table.order)])
        prepared.land()
        files[name] = prepared.sha256
        old += sources
    for name, accepted in listed.items():
        path = output / "tables" / name
        is_here = folder in name or (month == WHOLE and MONTH_PREFIX not in name)
        is_old = name.split("/")[0] in OLD_TABLES and OLD_NAME.fullmatch(path.stem)
        if is_here and not is_old and name not in files:
            files[name] = accepted[0] if len(accepted) == 1 else _digest(path, accepted)
    update_manifest(output, files)
    for path in old:
        remove(path)
    remove_all(output / "manifest" / folder)


def _rows(output: Path, path: Path, table: Table, listed: Listed) -> pl.DataFrame:
    """Rows of a file that is what its manifest says; none if there is no file."""
    empty = pl.DataFrame(schema=table.schema)
    try:
        content = read(path)
    except FileNotFoundError:
        return empty
    except OSError as error:
        raise damaged(path, table, error) from error
    accepted = listed.get(name_of(output, path))
    if accepted and hashlib.sha256(content).hexdigest() not in accepted:
        raise damaged(path, table, ValueError("it is not what its manifest says"))
    return pl.concat([empty, *groups_of(path, table, content)])


def _digest(path: Path, accepted: Sequence[str | None]) -> str | None:
    """Which of the digests a file has; None for another."""
    try:
        found = hashlib.sha256(read(path)).hexdigest()
    except OSError:
        return None
    return found if found in accepted else None

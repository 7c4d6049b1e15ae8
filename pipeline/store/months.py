"""Months of a table as one file: nights of a month that is long over are joined.

The folder of a month is made anew beside the tables and exchanged with the present one in one step:
who lists it sees all nights, or the one file. A night that comes late parts its month again, and a
later run joins it. Manifests list old and new files meanwhile, that of the month as the first and
the longest: as long as something is coming in it, a run that was broken off is to be settled.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import logging
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq

from pipeline.errors import StoreError
from pipeline.schema import (
    BLOCK_STATISTICS,
    MOTOR_OUTCOMES,
    NIGHT_TABLES,
    RUNS,
    TREND_TABLES,
    Table,
)
from pipeline.store.atomic_files import can_exchange, exchange, flush_disk, put, read, remove_all
from pipeline.store.encoding import encode_table, parts_of, row_groups, write_parts
from pipeline.store.manifest import (
    Key,
    Manifest,
    announce,
    manifest_key,
    manifest_keys,
    read_manifest,
    update_manifest,
)
from pipeline.store.tables import ENDING, month_file, month_stamps, published_rows

log = logging.getLogger(__name__)

# Trends read `block_statistics` night by night.
JOINED = (*(one for one in NIGHT_TABLES if one is not BLOCK_STATISTICS), *TREND_TABLES, RUNS)
JOINED += (MOTOR_OUTCOMES,)
# Folder below the staging folder.
ASIDE = "months"


def last_month_over(tonight: dt.date, nights: int) -> str:
    """The last month, YYYY-MM, that ended so many nights before tonight.

    Examples
    --------
    >>> last_month_over(dt.date(2026, 3, 17), 14), last_month_over(dt.date(2026, 3, 13), 14)
    ('2026-02', '2026-01')
    """
    day = tonight - dt.timedelta(days=nights)
    return f"{(day + dt.timedelta(days=1)).replace(day=1) - dt.timedelta(days=1):%Y-%m}"


def join_months(output: Path, staging: Path, last: str, but: Collection[str] = ()) -> None:
    """Join the files of each month up to one, YYYY-MM, but some; the caller holds the lock.

    What cannot be joined stays night by night.

    Raises StoreError if a manifest cannot be read or written; nothing is lost, and the next run
    goes on.
    """
    months = {month for table in JOINED for month in month_stamps(output, table)}
    months = {month for month in months if month <= last and month not in but}
    if not months or not can_exchange(staging / ASIDE):
        return
    for month in sorted(months):
        settle(output, month)
        remove_all(staging / ASIDE)
        made: dict[Table, Path] = {}
        for table in JOINED:
            try:
                files = _files_to_join(output, table, month)
                if files:
                    made[table] = _joined(output, staging, table, month, files)
            except StoreError as error:
                log.warning("%s; %s of %s stays night by night", error, month, table.name)
        _exchange(output, month, made)


def part_month(output: Path, staging: Path, tables: Iterable[Table], month: str) -> list[Table]:
    """Part joined files of a month into those of its nights; the caller holds the lock.

    Returns those of the tables whose joined file is damaged; it stays.

    Raises StoreError if files cannot be written.
    """
    joined = [table for table in tables if month_file(output, table, month).exists()]
    made: dict[Table, Path] = {}
    damaged = []
    settle(output, month)
    if joined:
        remove_all(staging / ASIDE)
    for table in joined:
        try:
            made[table] = _parted(output, staging, table, month)
        except StoreError as error:
            if error.code != "store_read":
                raise
            log.warning("%s; it is put aside", error)
            damaged.append(table)
    _exchange(output, month, made)
    return damaged


def settle(output: Path, month: str) -> None:
    """End what a run has announced of a month and was broken off in.

    Raises StoreError if a manifest cannot be read or written.
    """
    if (read_manifest(output, month, month) or Manifest()).coming:
        _settle(output, month)


def _settle(output: Path, month: str) -> None:
    """Let the manifests of a month say what is there, that of the month at the end."""
    own = (month, month)
    for key in sorted(manifest_keys(output, month), key=lambda key: (key == own, key)):
        coming = (read_manifest(output, *key) or Manifest()).coming
        there = {name: _digest(output / "tables" / name) for name in coming}
        settled = {name: digest for name, digest in there.items() if digest in coming[name]}
        if settled:
            update_manifest(output, *key, settled)


def _exchange(output: Path, month: str, made: Mapping[Table, Path]) -> None:
    """Put new folders of a month into the places of the present ones, with their manifests."""
    if made:
        flush_disk(next(iter(made.values())))  # once, and not for each of the files
    changes: defaultdict[Key, dict[str, tuple[str | None, str | None]]] = defaultdict(dict)
    for table, folder in made.items():
        place = month_file(output, table, month).parent
        below = place.relative_to(output / "tables").as_posix()
        for name in sorted({path.name for one in (folder, place) for path in one.iterdir()}):
            change = _digest(place / name), _digest(folder / name)
            changes[manifest_key(f"{below}/{name}")][f"{below}/{name}"] = change
    own = (month, month)
    for key in sorted(changes, key=lambda key: (key != own, key)):
        announce(output, *key, changes[key])
    try:
        for table, folder in made.items():
            exchange(folder, month_file(output, table, month).parent)
    finally:
        settle(output, month)


def _files_to_join(output: Path, table: Table, month: str) -> list[Path]:
    """Published files of a month; none if they are joined, or if there is anything else.

    A damaged file that was put aside is not to go with the folder.
    """
    path = month_file(output, table, month)
    files = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    names = [one.relative_to(output / "tables").as_posix() for one in files]
    manifests = (read_manifest(output, *manifest_key(name)) or Manifest() for name in names)
    listed = all(one.accepted(name) for one, name in zip(manifests, names, strict=True))
    return files if listed and files != [path] else []


def _joined(output: Path, staging: Path, table: Table, month: str, files: Sequence[Path]) -> Path:
    """A new folder with the rows of some files in one."""
    places = dict(sorted((name, path) for path in files for name in parts_of(path)))

    def parts() -> Iterator[tuple[str, pl.DataFrame]]:
        for name, path in places.items():
            yield name, published_rows(output, path, table, [name])

    made = staging / ASIDE / table.name / f"{month}{ENDING}"
    put(made, lambda stream: write_parts(stream, parts()), durable=False)
    with pq.ParquetFile(made, page_checksum_verification=True) as file:
        for place, group in enumerate(row_groups(rows for _, rows in parts())):
            found = pl.from_arrow(file.read_row_group(place, use_threads=False))
            if not group.equals(found):  # type: ignore[arg-type]
                raise StoreError("store_write", f"{made.name} is not what it was made from")
    return made.parent


def _parted(output: Path, staging: Path, table: Table, month: str) -> Path:
    """A new folder with a file for each night of a joined month."""
    path = month_file(output, table, month)
    folder = staging / ASIDE / table.name
    for name in parts_of(path):
        rows = published_rows(output, path, table, [name])
        put(folder / f"{name}{ENDING}", encode_table(name, rows), durable=False)
    return folder


def _digest(path: Path) -> str | None:
    """SHA-256 of a file; None without one."""
    try:
        return hashlib.sha256(read(path)).hexdigest()
    except FileNotFoundError:
        return None

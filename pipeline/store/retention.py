"""Retention: table files of old nights that need not be kept for ever, and what goes with them.

Only tables that nothing is made from may be pruned by the config; `block_statistics` has to be
named, as refits and trends are made from it. Manifests forget a file before it is removed: what a
crash leaves in between is a file that no manifest lists, and the next pruning removes it.
"""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pipeline.config import Retention
from pipeline.errors import UsageError
from pipeline.schema import TABLES
from pipeline.store.atomic_files import remove
from pipeline.store.manifest import Manifest, announce, read_manifest, update_manifest
from pipeline.store.tables import night_paths

# What goes with each table, in words. Of the others figures, trends and alarms are made.
LOSSES: Mapping[str, str] = {
    "predictions": "the report's course of measured and predicted flow",
    "starts": "the search start by start; how many met the minimum stays in fits",
    "residual_tests": "residual correlations lag by lag; residual_verdicts stays",
    "sensitivities": "the share of each tolerance in ±; the sum stays in fits and parameters",
    "block_statistics": "a changed setting of the fit then needs the logs of these nights, and "
    "trends that are made anew leave out nights too poor for a fit of their own",
}
# Never pruned unless it is named: what is published is made from it.
NEEDED = ("block_statistics",)


@dataclass(frozen=True, slots=True)
class OldFiles:
    """The files of a table that are older than what is to be kept.

    Attributes
    ----------
    table
        Its name.
    nights
        Their nights, sorted.
    size_bytes
        Of all of them.
    loss
        What goes with them, in words.
    """

    table: str
    nights: tuple[dt.date, ...]
    size_bytes: int
    loss: str


def nights_kept(retention: Retention, tables: Sequence[str], keep: int | None) -> dict[str, int]:
    """How many nights are to be kept, by table: as configured, or as asked for.

    Parameters
    ----------
    retention
        The config.
    tables
        Tables that are asked for; none: those of the config.
    keep
        Nights to keep of them; None: as configured.

    Raises
    ------
    UsageError
        ``prune_table``: a table that is never pruned, or of which it is not said how many nights
        are to be kept.
    """
    configured = {name: n for name, n in retention.model_dump().items() if n is not None}
    if not tables:
        if keep is not None:
            raise UsageError("prune_table", "--keep needs --tables: name what is to be pruned")
        return configured
    strangers = sorted(set(tables) - LOSSES.keys())
    if strangers:
        raise UsageError(
            "prune_table",
            f"{', '.join(strangers)} cannot be pruned; tables that can: {', '.join(LOSSES)}",
        )
    unsaid = [name for name in tables if keep is None and name not in configured]
    if unsaid:
        raise UsageError(
            "prune_table",
            f"how many nights of {', '.join(unsaid)} are to be kept is said neither with --keep "
            "nor under [retention]",
        )
    return {name: configured[name] if keep is None else keep for name in tables}


def old_files(
    output: Path, kept: Mapping[str, int], tonight: dt.date | None
) -> tuple[OldFiles, ...]:
    """Files of nights before the newest so many days, by table; nothing is removed.

    Parameters
    ----------
    output
        Output folder.
    kept
        Days to keep by table.
    tonight
        Night from which they count back, that itself included; None: nothing is old.
    """
    if tonight is None:
        return ()
    found = []
    for table in TABLES:
        if table.name not in kept:
            continue
        first_kept = tonight - dt.timedelta(days=kept[table.name] - 1)
        files = {night: path.stat().st_size for night, path in night_paths(output, table).items()}
        old = {night: size for night, size in files.items() if night < first_kept}
        if old:
            size = sum(old.values())
            found.append(OldFiles(table.name, tuple(old), size, LOSSES[table.name]))
    return tuple(found)


def prune(output: Path, old: Sequence[OldFiles]) -> None:
    """Remove such files; the caller holds the output's lock.

    Raises
    ------
    StoreError
        If a manifest cannot be written or a file not be removed; what was removed till then is
        consistent, and pruning again does the rest.
    """
    by_night: defaultdict[dt.date, list[str]] = defaultdict(list)
    for one in old:
        for night in one.nights:
            by_night[night].append(f"{one.table}/month={night:%Y-%m}/{night}.parquet")
    for night, names in sorted(by_night.items()):
        month = f"{night:%Y-%m}"
        manifest = read_manifest(output, month, night.isoformat()) or Manifest()
        going = {name: (manifest.files.get(name), None) for name in names}
        announce(output, month, night.isoformat(), going)
        for name in names:
            path = output / "tables" / name
            remove(path)
            # A month without files is no part of the table.
            with suppress(OSError):
                path.parent.rmdir()
        update_manifest(output, month, night.isoformat(), dict.fromkeys(names))

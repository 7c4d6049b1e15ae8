"""Room on the disk, looked at before a run begins: a full disk would end it half way."""

from __future__ import annotations

import shutil
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.schema import NIGHT_TABLES, NIGHTLY_TABLES, TREND_TABLES
from pipeline.store.tables import files_of

MIB = 1024**2
# Staged rows are not compressed, and each table file is written beside the one that it replaces.
STAGING_FACTOR = 6
# Published files whose size tells that of the next.
NIGHTS_LOOKED_AT = 14


def require_space(output: Path, minimum_free_mib: float) -> None:
    """Refuse a run for which there is too little room; nothing is written.

    Raises StoreError (``disk_space``) where less is free than the minimum and one more night of the
    fleet.
    """
    if not minimum_free_mib:
        return
    there = next(one for one in (output, *output.parents) if one.exists())
    free = shutil.disk_usage(there).free
    needed = int(minimum_free_mib * MIB) + bytes_a_night(output)
    if free < needed:
        raise StoreError(
            "disk_space",
            f"{output} has {free / MIB:.0f} MiB free, and a night asks for {needed / MIB:.0f} MiB, "
            f"of which execution.minimum_free_mib is {minimum_free_mib:g}; nothing was done: free "
            "space, or prune",
        )


def bytes_a_night(output: Path) -> int:
    """Bytes that a night of the fleet takes while it is made, from the newest files of the tables.

    The file of a month is written whole beside the one before it.
    """
    needed = 0
    for table in (*NIGHT_TABLES, *TREND_TABLES):
        sizes = [path.stat().st_size for path in files_of(output, table)[-NIGHTS_LOOKED_AT:]]
        if table in NIGHTLY_TABLES:
            needed += STAGING_FACTOR * max(sizes, default=0)
        else:
            needed += 2 * max(sizes, default=0)
    return needed

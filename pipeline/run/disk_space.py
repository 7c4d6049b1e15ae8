"""Whether there is room for a run, told before it begins: a full disk would end it half way."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial
from itertools import islice
from pathlib import Path

from pipeline.config import Execution, MotorSpec
from pipeline.errors import StoreError
from pipeline.logs.ledger import read_ledger
from pipeline.logs.locations import logs_of
from pipeline.schema import FITS
from pipeline.store.tables import night_paths
from pipeline.workers.local import Crew

MIB = 1024**2
# A motor's night with the shipped types: 40 KiB of tables, six times that while it is staged.
NIGHT_BYTES = 300_000
# Staged rows are not compressed, and each table file is written beside the one that it replaces.
STAGING_FACTOR = 6
# Published nights whose size tells that of the next.
NIGHTS_LOOKED_AT = 14


def require_space(
    output: Path, specs: Sequence[MotorSpec], execution: Execution, crew: Crew | None = None
) -> None:
    """Refuse a run for which there is too little room; nothing is written.

    Raises
    ------
    StoreError
        ``disk_space``.
    """
    minimum_free_mib = execution.minimum_free_mib
    if not minimum_free_mib:
        return
    free = shutil.disk_usage(_there(output)).free
    needed = int(minimum_free_mib * MIB)
    # Most nights there is room for all: only then is it worth to look at the logs.
    if free > 100 * needed:
        return
    count = partial(new_files, output)
    with Crew() if crew is None else nullcontext(crew) as workers:
        nights = sum(workers.run_tasks(count, specs, lambda *_: 0, execution, first=True))
    needed += nights * bytes_a_night(output)
    if free < needed:
        raise StoreError(
            "disk_space",
            f"{output} has {free / MIB:.0f} MiB free, and {nights} new log files ask for "
            f"{needed / MIB:.0f} MiB, of which execution.minimum_free_mib is {minimum_free_mib:g}; "
            "nothing was done: free space, or prune",
        )


def new_files(output: Path, spec: MotorSpec) -> int:
    """Log files of a motor that its ledger does not know by name and size."""
    known = read_ledger(output, spec.motor_id).files
    sizes = logs_of(spec).sizes()
    return sum(name not in known or known[name].size != size for name, size in sizes.items())


def bytes_a_night(output: Path) -> int:
    """Bytes that a motor's night takes while it is made, from the newest nights of the tables."""
    files = reversed(night_paths(output, FITS).values())
    n_motors = sum(1 for _ in (output / "ledger").glob("*/"))
    tables = output / "tables"
    sizes = [
        sum(one.stat().st_size for one in tables.glob(f"*/{path.parent.name}/{path.name}"))
        for path in islice(files, NIGHTS_LOOKED_AT)
    ]
    if not sizes or not n_motors:
        return NIGHT_BYTES
    return STAGING_FACTOR * max(sizes) // n_motors


def _there(path: Path) -> Path:
    """The nearest folder above that is there."""
    return next(one for one in (path, *path.parents) if one.exists())

"""Runs of which one call fails, each in turn: what is left, and what the next run makes of it."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from pipeline.errors import StoreError
from tests.pipeline.faults.disk import Disk, Kind, on
from tests.pipeline.faults.fleet import (
    TinyFleet,
    check_old_or_new,
    check_repaired,
    check_tables,
    remembered_fits,
    temporary,
)


@dataclass(slots=True)
class Tally:
    """Results of the points that were tried."""

    # Points by the call that failed, after which files were whole, old or new, and the next run
    # repaired everything.
    survived: Counter[str] = field(default_factory=Counter)
    # Points by the end of the run: an error, a failed motor, or no effect.
    ends: Counter[str] = field(default_factory=Counter)


@cache
def count_points(fleet: TinyFleet, kind: Kind) -> int:
    """Number of calls of a run that can fail in a way; the run passes if none of them fails."""
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(2):  # the first is slower, and beats more often
            output = fleet.copy(Path(folder) / "out")
            with remembered_fits(), on(Disk(kind, 0)) as disk:
                fleet.run(output, workers=1)
        assert not disk.struck
        check_repaired(output, fleet)
    return disk.seen


def try_points(
    fleet: TinyFleet, output: Path, kind: Kind, points: Iterable[int], *, lasting: bool = False
) -> Tally:
    """Let a run fail at each point, look at what it leaves, and let the next one repair it."""
    tally = Tally()
    with remembered_fits():
        for point in points:
            fleet.copy(output)
            disk = Disk(kind, point, lasting)
            end, failed = _run_on(disk, fleet, output)
            assert disk.struck, f"{kind}: there is no point {point}"
            check_old_or_new(output, fleet, failed)
            if not lasting and disk.struck not in ("unlink", "rmdir"):
                assert temporary(output) == []
            fleet.run(output)
            check_repaired(output, fleet)
            tally.survived[disk.struck] += 1
            tally.ends[end] += 1
    return tally


def _run_on(disk: Disk, fleet: TinyFleet, output: Path) -> tuple[str, list[str]]:
    """End of a run on a disk, and the motors that failed."""
    try:
        with on(disk):
            # One at a time, calls come in the same order in each run. A disk that goes on failing
            # fails those of several threads.
            result = fleet.run(output, workers=2 if disk.lasting else 1)
    except StoreError:
        return "error", []
    failed = [outcome.motor_id for outcome in result.failed]
    if not failed:
        # A run that says that all went well has published all.
        check_tables(output, fleet)
    return "motor failed" if failed else "as if nothing had been", failed

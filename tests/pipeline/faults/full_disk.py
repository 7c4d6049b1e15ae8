"""Runs on file systems of some sizes, each too small: `python -m tests.pipeline.faults.full_disk`.

Arguments: the folder of the tiny fleet, a folder to work in, `tmpfs` or `limit`, how many KiB lie
between two sizes, and how many sizes are tried at most. With `tmpfs` the output lies on a file
system of that size, which is mounted for it: the caller gives a mount namespace. With `limit`
no file may become larger.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import StoreError
from tests.pipeline.faults.fleet import (
    TinyFleet,
    check_old_or_new,
    check_repaired,
    remembered_fits,
    temporary,
)

KIB = 1024
# Larger than all that the tiny fleet writes.
ENOUGH_KIB = 65536


@contextmanager
def tmpfs(work: Path, fleet: TinyFleet, room_kib: int) -> Iterator[Path]:
    """An output on a file system with so much room left; there is enough once the run is over."""
    place = work / "mounted"
    place.mkdir(exist_ok=True)
    _mount(place, ENOUGH_KIB)
    try:
        output = fleet.copy(place / "out")
        used = subprocess.check_output(["df", "--output=used", "-k", place], text=True)
        _mount(place, int(used.split()[-1]) + room_kib, remount=True)
        yield output
        _mount(place, ENOUGH_KIB, remount=True)
        finish(fleet, output)
    finally:
        subprocess.run(["umount", place], check=True)


def _mount(place: Path, size_kib: int, *, remount: bool = False) -> None:
    options = f"{'remount,' * remount}size={size_kib}k"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", place], check=True)


@contextmanager
def limit(work: Path, fleet: TinyFleet, room_kib: int) -> Iterator[Path]:
    """An output whose files may be no larger than that, until the run is over."""
    output = fleet.copy(work / "out")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_kib * KIB, before[1]))
    try:
        yield output
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    finish(fleet, output)


def finish(fleet: TinyFleet, output: Path) -> None:
    """With room again, the next run repairs all."""
    fleet.run(output)
    check_repaired(output, fleet)


def main(folder: str, work: str, way: str, step_kib: str, most: str) -> None:
    """Try sizes until one is large enough; writes how many were not, and how the runs ended."""
    fleet, ends = TinyFleet(Path(folder)), []
    with remembered_fits():
        # The first size leaves no room at all.
        for number in range(int(most)):
            room_kib = number * int(step_kib)
            with (tmpfs if way == "tmpfs" else limit)(Path(work), fleet, room_kib) as output:
                try:
                    failed = [one.motor_id for one in fleet.run(output).failed]
                    ends.append("motor failed" if failed else "ok")
                except StoreError as error:
                    failed = []
                    ends.append(error.code)
                check_old_or_new(output, fleet, failed)
                assert temporary(output) == []
            if ends[-1] == "ok":
                break
    sys.stdout.write(json.dumps(ends) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])

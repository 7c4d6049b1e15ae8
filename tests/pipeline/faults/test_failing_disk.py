"""Every call to the disk fails once: what is published stays whole, and the next run repairs all.

As SQLite is tested ("How SQLite Is Tested", I/O error testing): the Nth call fails, for N = 1, 2,
3, … until a run passes in which none does.
"""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.store import atomic_files
from tests.pipeline.calling import contents
from tests.pipeline.faults import disk
from tests.pipeline.faults.disk import CALLS, DOORS, KINDS, Disk, Kind, on
from tests.pipeline.faults.fleet import TinyFleet
from tests.pipeline.faults.sweep import count_points, try_points

SEED = 7
# Tried in every run of the tests.
POINTS: dict[Kind, int] = {"EIO": 2, "ENOSPC": 2, "short": 1, "flipped": 2}
SLICES = 4
# Every third point of those that fail as others do: `ENOSPC` strikes calls that `EIO` strikes too,
# and a disk that goes on failing fails first where one does that fails once.
STRIDE = 3
EACH_KIND = [(one, False) for one in KINDS]


def some_points(n: int, count: int, part: int = 0) -> list[int]:
    """So many of n points, the same in every run."""
    chosen = np.random.default_rng([SEED, part]).choice(n, count, replace=False)
    return sorted(int(one) + 1 for one in chosen)


@pytest.mark.parametrize(("kind", "lasting"), [*EACH_KIND, ("ENOSPC", True)])
def test_some_points(tiny_fleet: TinyFleet, tmp_path: Path, kind: Kind, lasting: bool) -> None:
    n = count_points(tiny_fleet, kind)
    points = some_points(n, POINTS[kind], 0 if lasting else KINDS.index(kind))
    tally = try_points(tiny_fleet, tmp_path / "out", kind, points, lasting=lasting)
    assert tally.survived.total() == len(points)


@pytest.mark.full
@pytest.mark.parametrize("part", range(SLICES))
@pytest.mark.parametrize(("kind", "lasting"), [*EACH_KIND, ("EIO", True), ("ENOSPC", True)])
def test_every_point(
    tiny_fleet: TinyFleet, tmp_path: Path, kind: Kind, lasting: bool, part: int
) -> None:
    output = tmp_path / "out"
    n = count_points(tiny_fleet, kind)
    stride = STRIDE if lasting or kind == "ENOSPC" else 1
    points = range(1 + part * stride, n + 1, SLICES * stride)
    tally = try_points(tiny_fleet, output, kind, points, lasting=lasting)
    sys.stdout.write(
        f"{kind}{', lasting' * lasting}, {part + 1} of {SLICES}: {tally.survived.total()} points "
        f"tried and survived; {dict(tally.ends)}; {dict(tally.survived)}\n"
    )
    assert tally.survived.total() == len(points)
    # The next point is none: a run passes without a fault.
    tiny_fleet.copy(output)
    with on(Disk(kind, n + 1, lasting)) as sound:
        tiny_fleet.run(output, workers=1)
    assert not sound.struck


def test_nothing_reaches_the_disk_but_through_the_one_door(
    tiny_fleet: TinyFleet, tmp_path: Path
) -> None:
    """Whatever has content in the output, staged rows too, went through calls that can be failed.

    Compiled libraries open files without Python knowing of it, so it is contents that are compared;
    and Python is asked to report what it opens, renames and removes itself.
    """
    output = tiny_fleet.copy(tmp_path / "out")
    before = hashed(output)
    written: dict[int, Any] = {}
    hashes: set[str] = set()

    class Watched(Disk):
        """Notes the hash of all that is written to a file until it is closed."""

        def __getattr__(self, name: str) -> Any:
            real = super().__getattr__(name)

            def write(handle: int, data: Any) -> int:
                taken = real(handle, data)
                written.setdefault(handle, hashlib.sha256()).update(bytes(data)[:taken])
                return int(taken)

            def close(handle: int) -> None:
                if handle in written:
                    hashes.add(written.pop(handle).hexdigest())
                real(handle)

            return {"write": write, "close": close}.get(name, real)

    doors = {disk.__file__, __file__, *(str(door.__file__) for door in DOORS)}
    strangers: list[tuple[str, str]] = []
    listening = True

    def listen(event: str, arguments: tuple[Any, ...]) -> None:
        if not listening or event not in WRITING or not str(arguments[0]).startswith(str(output)):
            return
        if event == "open" and not _writes(*arguments[1:]):
            return
        if sys._getframe(1).f_code.co_filename not in doors:
            strangers.append((event, str(arguments[0])))

    staged: list[str] = []

    def remove_all(folder: Path) -> None:
        staged.extend(hashed(folder).values())
        really_remove_all(folder)

    really_remove_all = atomic_files.remove_all
    sys.addaudithook(listen)  # there is no way to take it away again, only to close its ears
    with pytest.MonkeyPatch.context() as patched, on(Watched("EIO", 0)):
        patched.setattr("pipeline.store.publishing.remove_all", remove_all)
        tiny_fleet.run(output)
    listening = False
    after = hashed(output)
    new = {
        name: one
        for name, one in after.items()
        if before.get(name) != one and not name.startswith(STATE)
    }
    assert len(new) > 15
    assert set(new.values()) <= hashes
    assert len(staged) >= 4  # of each motor, those of its nights and of its trends
    assert set(staged) <= hashes
    assert set(strangers) <= {("open", str(output / "lock"))}


# SQLite writes by itself; who holds the lock is written into a file that was there.
STATE = ("state.", "lock")
WRITING = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink"}


def _writes(mode: str | None, flags: int) -> bool:
    return bool(set(mode or "") & set("wax+")) or bool(
        flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    )


def hashed(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256(one).hexdigest() for name, one in contents(folder).items()}


def test_every_call_of_the_doors_can_be_failed() -> None:
    """Every call of `os` that they make can be made to fail, or changes nothing on the disk."""
    harmless = {
        "close", "fstat", "lstat", "scandir", "posix_fadvise", "sync",
        "O_APPEND", "O_CLOEXEC", "O_CREAT", "O_EXCL", "O_RDONLY", "O_RDWR", "O_TRUNC", "O_WRONLY",
        "POSIX_FADV_DONTNEED", "fsencode", "strerror",
    }  # fmt: skip
    source = "".join(Path(str(door.__file__)).read_text("utf-8") for door in DOORS)
    used = {name.split("(")[0].split(")")[0] for name in source.split("os.")[1:]}
    used = {"".join(c for c in name.split()[0] if c.isalnum() or c == "_") for name in used}
    assert set(CALLS) <= used
    assert used - harmless - set(CALLS) <= {"path", "stat"}

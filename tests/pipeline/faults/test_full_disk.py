"""A small file system that is really full: what is published stays, and room is all that it needs.

tmpfs where one may be mounted, else a limit on the size of files: one of them there always is.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.pipeline.faults.fleet import ENVIRONMENT, TinyFleet

# As root there needs to be no other user namespace, but it does no harm.
NAMESPACE = ["unshare", "--map-root-user", "--mount"]


@cache
def way() -> str:
    """Method of filling a disk that is available here."""
    try:
        tried = subprocess.run(
            [*NAMESPACE, "mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", "/mnt"],
            capture_output=True,
        )
    except OSError:
        return "limit"
    return "limit" if tried.returncode else "tmpfs"


def ends_of(fleet: TinyFleet, work: Path, way: str, step_kib: int, most: int) -> list[str]:
    """Ends of runs with increasing room on the disk."""
    command = [sys.executable, "-m", "tests.pipeline.faults.full_disk"]
    arguments = [str(fleet.folder), str(work), way, str(step_kib), str(most)]
    command = [*(NAMESPACE if way == "tmpfs" else []), *command, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_no_room(tiny_fleet: TinyFleet, tmp_path: Path) -> None:
    """None at all; enough to stage but not to publish; and a little more than that."""
    ends = ends_of(tiny_fleet, tmp_path, way(), 160 if way() == "tmpfs" else 8, 3)
    assert set(ends) <= {"store_write", "motor failed", "ok"}
    assert ends[0] != "ok"
    assert len(ends) >= 2


@pytest.mark.full
@pytest.mark.parametrize("how", ["tmpfs", "limit"])
def test_more_and_more_room(tiny_fleet: TinyFleet, tmp_path: Path, how: str) -> None:
    """Page by page until there is enough; without tmpfs, the limit on files is all."""
    how = how if way() == "tmpfs" else "limit"
    ends = ends_of(tiny_fleet, tmp_path, how, 16 if how == "tmpfs" else 4, 1000)
    assert ends[-1] == "ok"
    assert len(ends) > 10
    sys.stdout.write(
        f"full disk ({how}): {len(ends) - 1} sizes tried and survived, {Counter(ends)}\n"
    )

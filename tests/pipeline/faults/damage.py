"""Damage to a file of an output, and what a run says of it."""

from __future__ import annotations

import os
from pathlib import Path

from pipeline.run.fleet import RunResult
from pipeline.run.mending import repair
from pipeline.store.published import TableFault, verify_tables
from pipeline.store.state import open_state
from tests.pipeline.simulated import NIGHT

MONTH = f"{NIGHT:%Y-%m}"
# Of a file: all of it is due in the next run.
EVERY_RUN = {"prove_within_days": 1}


def flip(path: Path, place: int) -> None:
    """Flip a bit of a byte of a file; its time stays, as it does on a disk."""
    state = path.stat()
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def rot(path: Path) -> None:
    """Flip a bit of the content; of a table, in a first page, whose header no checksum covers."""
    flip(path, min(path.stat().st_size // 3, 210))


def rot_of_footer(path: Path) -> None:
    flip(path, path.stat().st_size - 100)


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def name_of(path: Path, output: Path) -> str:
    return path.relative_to(output).as_posix().removeprefix("tables/")


def codes(output: Path) -> list[str]:
    return [fault.code for fault in verify_tables(output)]


def found(result: RunResult) -> list[tuple[str, str]]:
    return [(fault.path, fault.code) for fault in result.damage]


def left(result: RunResult) -> list[tuple[str, str]]:
    return [(fault.path, fault.code) for fault in result.damage_left]


def remove_aside(output: Path) -> int:
    """Remove what was put aside, which people look at; how many files it were."""
    aside = list(output.rglob("*.damaged"))
    for path in aside:
        path.unlink()
    return len(aside)


def repaired(output: Path) -> tuple[tuple[TableFault, ...], tuple[TableFault, ...]]:
    """Repair an output as the command does: faults that were found, and those that are left."""
    with open_state(output) as state:
        return repair(state)

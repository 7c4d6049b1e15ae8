"""Damage to a file of an output, and what a run says of it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from pipeline.store.published import TableFault


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


def told(damage: Iterable[TableFault]) -> list[tuple[str, str]]:
    return [(fault.path, fault.code) for fault in damage]


def remove_aside(output: Path) -> int:
    """Remove what was put aside, which people look at; how many files it were."""
    aside = list(output.rglob("*.damaged"))
    for path in aside:
        path.unlink()
    return len(aside)

"""Files written whole or not at all, and flushed."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from pipeline.errors import StoreError

TEMPORARY_PREFIX = ".writing-"
# Tables hold no secrets, and analysts are other users.
MODE = 0o644
BUFFER = 1 << 20

# Content of a file, or a function that writes it to a stream.
Write = Callable[[BinaryIO], object] | bytes


@dataclass(frozen=True, slots=True)
class Prepared:
    """A temporary file in the folder of its place, flushed."""

    path: Path  # its place
    temporary: Path  # the file

    def land(self, *, flush: bool = True) -> None:
        """Rename it to its place; not to `flush` its folder is for one who does so later.

        Raises StoreError if that fails; the place then holds the old file, or already the new one.
        """
        with store_errors(self.path):
            try:
                self.temporary.replace(self.path)
            except BaseException:
                self.drop()
                raise
            if flush:
                flush_path(self.path.parent)

    def drop(self) -> None:
        """Remove it; its place stays as it is."""
        with suppress(OSError):
            self.temporary.unlink()


def prepare(path: Path, write: Write, *, durable: bool = True) -> Prepared:
    """Write a temporary file in the folder of its place, and flush it.

    Raises StoreError if it cannot be written; nothing is left of it.
    """
    temporary = path.parent / f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}"
    with store_errors(path):
        make_folders(path.parent)
        try:
            with temporary.open("xb", BUFFER) as stream:
                os.fchmod(stream.fileno(), MODE)
                stream.write(write) if isinstance(write, bytes) else write(stream)
                stream.flush()
                if durable:
                    os.fsync(stream.fileno())
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
    return Prepared(path, temporary)


def put(path: Path, write: Write, *, durable: bool = True) -> None:
    """Write a file whole or not at all, and the folders above it.

    One that is not `durable` need not survive a power cut.

    Raises StoreError if it cannot be written; the old file then stays. If only the last flush, of
    its folder, fails, the new file may be there already.
    """
    prepare(path, write, durable=durable).land(flush=durable)


def make_folders(folder: Path) -> None:
    """Make a folder and the missing ones above it; raises OSError if one cannot be made."""
    if not folder.is_dir():
        make_folders(folder.parent)
        try:
            folder.mkdir(exist_ok=True)
        except FileExistsError as error:
            raise FileExistsError(error.errno, "there is a file in the way", folder) from error
        flush_path(folder.parent)


def flush_path(path: Path) -> None:
    """Flush a file, or the names in a folder; raises OSError if they cannot be flushed."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def move(path: Path, place: Path) -> None:
    """Rename a file within its folder, over one of that name; raises StoreError if it cannot be."""
    with store_errors(place):
        path.replace(place)
        flush_path(place.parent)


def remove(path: Path) -> None:
    """Remove a file if it is there; raises StoreError if it cannot be removed."""
    with store_errors(path, "removed"), suppress(FileNotFoundError):
        path.unlink()
        flush_path(path.parent)


def remove_leftovers(folders: Sequence[Path], *, below: bool = True) -> None:
    """Remove temporary files of a killed run from some folders, and from those below them."""
    for folder in folders:
        for path in folder.glob(f"{'**/' if below else ''}{TEMPORARY_PREFIX}*"):
            with suppress(OSError):
                path.unlink()


@contextmanager
def store_errors(path: Path, what: str = "written") -> Iterator[None]:
    """Turn a failed system call into `StoreError`."""
    try:
        yield
    except OSError as error:
        code = "store_read" if what == "read" else "store_write"
        why = error.strerror or error
        raise StoreError(code, f"{path.name} cannot be {what}: {why}") from error

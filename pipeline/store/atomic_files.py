"""Files written whole or not at all, flushed and read back.

The program writes to its output through this module and `journals` alone, by a few calls of `os`:
tests make each of them fail.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import io
import os
import secrets
import stat
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from pipeline.errors import StoreError

if TYPE_CHECKING:
    from typing_extensions import Buffer

TEMPORARY_PREFIX = ".writing-"
# Tables hold no secrets, and analysts are other users.
MODE = 0o644
PRIVATE = 0o700
BUFFER = 1 << 20

Write = Callable[[BinaryIO], object]


class Descriptor(io.RawIOBase):
    """A file that is being written, and the hash of its content."""

    def __init__(self, handle: int) -> None:
        super().__init__()
        self.handle = handle
        self.hash = hashlib.sha256()

    def writable(self) -> bool:
        return True

    def write(self, data: Buffer, /) -> int:
        """Write all of it: a disk may take less at a time."""
        rest = memoryview(data).cast("B")
        size = len(rest)
        self.hash.update(rest)
        while len(rest):
            taken = os.write(self.handle, rest)
            if taken == 0:
                raise OSError(errno.EIO, "nothing was written")
            rest = rest[taken:]
        return size


@dataclass(frozen=True, slots=True)
class Prepared:
    """A temporary file in the folder of its place, flushed and read back."""

    path: Path  # its place
    temporary: Path  # the file
    sha256: str  # of its content
    durable: bool = True  # True if it must survive a power cut

    def land(self, *, flush: bool = True) -> None:
        """Rename it to its place; not to `flush` its folder is for one who does so later.

        Raises StoreError if that fails; the place then holds the old file, or already the new one.
        """
        with store_errors(self.path):
            try:
                os.replace(self.temporary, self.path)
            except BaseException:
                self.drop()
                raise
            if self.durable and flush:
                flush_path(self.path.parent)

    def drop(self) -> None:
        """Remove it; its place stays as it is."""
        with suppress(OSError):
            os.unlink(self.temporary)


def prepare(path: Path, write: Write | bytes, *, durable: bool = True) -> Prepared:
    """Write a temporary file in the folder of its place, flush it, and read it back.

    Raises StoreError if it cannot be written, or is not read back as it was written; nothing is
    left of it.
    """
    temporary = path.parent / f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}"
    with store_errors(path):
        make_folders(path.parent)
        try:
            sha256 = _written(temporary, write, durable=durable)
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary)
            raise
    return Prepared(path, temporary, sha256, durable)


def _written(path: Path, write: Write | bytes, *, durable: bool) -> str:
    """Write a new file and read it back; returns its SHA-256."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, MODE)
    try:
        os.fchmod(handle, MODE)
        file = Descriptor(handle)
        with io.BufferedWriter(file, BUFFER) as stream:
            stream.write(write) if isinstance(write, bytes) else write(stream)
        if durable:
            os.fsync(handle)
            # Read back from the disk, if possible, not from the cache.
            if hasattr(os, "posix_fadvise"):
                os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        require_same(_hash_of(handle), file.hash.digest())
    finally:
        os.close(handle)
    return file.hash.hexdigest()


def require_same(found: bytes, expected: bytes) -> None:
    """Raise `OSError` where what was read back is not what was written."""
    if found != expected:
        raise OSError(errno.EIO, "what was read back is not what was written")


def _hash_of(handle: int) -> bytes:
    found, place = hashlib.sha256(), 0
    while part := os.pread(handle, BUFFER, place):
        found.update(part)
        place += len(part)
    return found.digest()


def put(path: Path, write: Write | bytes, *, durable: bool = True) -> str:
    """Write a file whole or not at all.

    Parameters
    ----------
    path
        The file; folders above it are made.
    write
        Its content, or a function that writes it to a stream.
    durable
        False for a file that need not survive a power cut.

    Returns
    -------
    str
        SHA-256 of the file.

    Raises
    ------
    StoreError
        If it cannot be written; the old file then stays. If only the last flush, of its folder,
        fails, the new file may be there already.
    """
    prepared = prepare(path, write, durable=durable)
    prepared.land()
    return prepared.sha256


@contextmanager
def scratch(path: Path, depth: int = 1) -> Iterator[BinaryIO]:
    """A scratch file of a run; so many folders above it are made, the next must exist.

    Raises OSError if it cannot be written.
    """
    for folder in reversed(path.parents[:depth]):
        with suppress(FileExistsError):
            os.mkdir(folder)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, MODE)
    try:
        os.fchmod(handle, MODE)
        with io.BufferedWriter(Descriptor(handle), BUFFER) as stream:
            yield stream
    finally:
        os.close(handle)


def make_private_folder(folder: Path) -> None:
    """Make a new folder that only the user of this process may enter.

    Raises OSError if it cannot be made, or is there already.
    """
    make_folders(folder.parent)
    os.mkdir(folder, PRIVATE)


def make_folders(folder: Path, *, flush: bool = True) -> None:
    """Make a folder and the missing ones above it; without `flush` somebody flushes them later.

    Raises OSError if one cannot be made.
    """
    absent = []
    while not folder.exists():
        absent.append(folder)
        folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "there is a file in the way", str(folder))
    for one in reversed(absent):
        with suppress(FileExistsError):
            os.mkdir(one)
        if flush:
            flush_path(one.parent)


def flush_path(path: Path) -> None:
    """Flush a file, or the names in a folder.

    Raises OSError if they cannot be flushed.
    """
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def flush_folders(folders: Collection[Path]) -> None:
    """Flush the names in some folders.

    Raises StoreError if they cannot be flushed.
    """
    for folder in sorted(folders):
        with store_errors(folder):
            flush_path(folder)


def flush_disk(path: Path) -> None:
    """Flush all that was written to the disk of a file or folder; one call costs less than many.

    Other disks are left alone: one that hangs would be waited for. (`syncfs`, Linux 2.6.39.)

    Raises StoreError if it cannot be flushed.
    """
    library = ctypes.CDLL(None, use_errno=True)
    with store_errors(path, "flushed"):
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            if not hasattr(library, "syncfs"):
                os.sync()
            elif library.syncfs(handle):
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        finally:
            os.close(handle)


def move(path: Path, place: Path) -> None:
    """Rename a file within its folder; a file of that name is replaced.

    Raises StoreError if it cannot be renamed.
    """
    with store_errors(place):
        os.replace(path, place)
        flush_path(place.parent)


def take_over(staging: Path, places: Mapping[Path, Path]) -> None:
    """Move scratch files of a run to places on the same disk, where they survive a power cut.

    Raises StoreError if that fails; each file is at one of both places.
    """
    if not places:
        return
    flush_disk(staging)
    for file, place in places.items():
        with store_errors(place):
            make_folders(place.parent, flush=False)
            try:
                os.replace(file, place)
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                put(place, read(file))
                os.unlink(file)
    flush_disk(place)


def remove(path: Path) -> None:
    """Remove a file if it is there.

    Raises StoreError if it cannot be removed.
    """
    with store_errors(path, "removed"), suppress(FileNotFoundError):
        os.unlink(path)
        flush_path(path.parent)


def remove_all(folder: Path) -> None:
    """Remove a folder of scratch files, as far as possible."""
    with suppress(OSError):
        if not stat.S_ISDIR(os.lstat(folder).st_mode):
            return
        for entry in os.scandir(folder):
            if entry.is_dir(follow_symlinks=False):
                remove_all(Path(entry.path))
            else:
                with suppress(OSError):
                    os.unlink(entry.path)
        os.rmdir(folder)


def remove_leftovers(folders: Sequence[Path], *, below: bool = True) -> None:
    """Remove temporary files of a killed run from some folders, and from those below them."""
    for folder in folders:
        for path in folder.glob(f"{'**/' if below else ''}{TEMPORARY_PREFIX}*"):
            with suppress(OSError):
                os.unlink(path)


def read(path: Path) -> bytes:
    """Content of a file; a read that fails is tried once more.

    Raises OSError if it cannot be read.
    """
    try:
        return _read(path)
    except FileNotFoundError:
        raise
    except OSError:
        return _read(path)


def _read(path: Path) -> bytes:
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return content_of(handle)
    finally:
        os.close(handle)


def content_of(handle: int) -> bytes:
    """Content of an open file."""
    parts, place = [], 0
    while part := os.pread(handle, BUFFER, place):
        parts.append(part)
        place += len(part)
    return b"".join(parts)


@contextmanager
def store_errors(path: Path, what: str = "written") -> Iterator[None]:
    """Turn a failed system call into `StoreError`."""
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        raise StoreError("store_write", f"{path.name} cannot be {what}: {why}") from error

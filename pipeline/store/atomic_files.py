"""Files written whole or not at all, and flushed; a folder to which one run at a time writes."""

from __future__ import annotations

import datetime as dt
import fcntl
import os
import secrets
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import BinaryIO

from pipeline.errors import LockedError, StoreError

TEMPORARY_PREFIX = ".writing-"
# Tables hold no secrets, and analysts are other users.
MODE = 0o644
BUFFER = 1 << 20
INTERRUPTS = (signal.SIGINT, signal.SIGTERM)

# Content of a file, or a function that writes it to a stream.
Write = Callable[[BinaryIO], object] | bytes


def prepare(path: Path, write: Write, *, durable: bool = True) -> Path:
    """Return a temporary file in the folder of its place, written and flushed.

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
            drop(temporary)
            raise
    return temporary


def put(path: Path, write: Write, *, durable: bool = True) -> None:
    """Write a file whole or not at all, and the folders above it.

    One that is not `durable` need not survive a power cut.

    Raises StoreError if it cannot be written; the old file then stays. If only the last flush, of
    its folder, fails, the new file may be there already.
    """
    temporary = prepare(path, write, durable=durable)
    try:
        with store_errors(path):
            temporary.replace(path)
            if durable:
                flush_path(path.parent)
    except BaseException:
        drop(temporary)
        raise


def drop(temporary: Path) -> None:
    """Remove a temporary file that has not been renamed to its place."""
    with suppress(OSError):
        temporary.unlink()


def make_folders(folder: Path) -> None:
    """Make a folder and the missing ones above it; raises OSError if any cannot be made."""
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
    """Rename a file within its folder, over any of that name; raises StoreError if it cannot be."""
    with store_errors(place):
        path.replace(place)
        flush_path(place.parent)


def remove(path: Path) -> None:
    """Remove a file if it is there; raises StoreError if it cannot be removed."""
    with store_errors(path, "removed"), suppress(FileNotFoundError):
        path.unlink()
        flush_path(path.parent)


def remove_leftovers(folder: Path, *, below: bool = False) -> None:
    """Remove temporary files of a killed run from a folder, and from those below it."""
    for path in folder.glob(f"{'**/' if below else ''}{TEMPORARY_PREFIX}*"):
        with suppress(OSError):
            path.unlink()


@contextmanager
def store_errors(path: Path, what: str = "written") -> Iterator[None]:
    """Return turn a failed system call into `StoreError`."""
    try:
        yield
    except OSError as error:
        code = "store_read" if what == "read" else "store_write"
        why = error.strerror or error
        raise StoreError(code, f"{path.name} cannot be {what}: {why}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for a run; the lock ends with the process, however that ends.

    Raises LockedError if another run holds it; StoreError if it cannot be locked.
    """
    holder = (
        f"process {os.getpid()} on {socket.gethostname()} "
        f"since {dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M:%S} UTC\n"
    )
    try:
        make_folders(folder)
        stream = (folder / "lock").open("a+", encoding="utf-8")
    except OSError as error:
        raise StoreError(
            "store_write", f"{folder} cannot be written: {error.strerror}; choose another output"
        ) from error
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = stream.read().strip() or "unknown"
            raise LockedError("locked", f"another run writes to this output: {holder}") from None
        except OSError as error:
            raise StoreError(
                "store_write", f"{folder} cannot be locked: {error.strerror}; choose a local folder"
            ) from error
        # On a full disk nobody learns who holds the lock; it is held all the same.
        with suppress(OSError):
            os.truncate(stream.fileno(), 0)
            os.write(stream.fileno(), holder.encode())
        yield


@contextmanager
def interrupts_held() -> Iterator[list[int]]:
    """Hold back a first signal, and yield the list of those that came; a second acts."""
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came  # signals go to the main thread
        return

    def hold(number: int, _: FrameType | None) -> None:
        if came:
            signal.signal(number, before[number])
            signal.raise_signal(number)
        came.append(number)

    before = {int(number): signal.signal(number, hold) for number in INTERRUPTS}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in came:
        with suppress(KeyboardInterrupt):  # the caller stops where it thinks fit
            signal.raise_signal(number)

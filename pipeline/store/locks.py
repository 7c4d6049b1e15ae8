"""One run at a time writes to a folder, and no signal breaks off what belongs together."""

from __future__ import annotations

import datetime as dt
import fcntl
import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from pipeline.errors import LockedError, StoreError
from pipeline.store.atomic_files import make_folders

INTERRUPTS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for one run; the lock ends with the process, however that ends.

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
    """Hold back a first signal, and yield the list of those that came; a second one acts."""
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

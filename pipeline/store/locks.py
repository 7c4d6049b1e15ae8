"""Locks on folders: one run at a time writes there."""

from __future__ import annotations

import datetime as dt
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.errors import LockedError, StoreError
from pipeline.store.atomic_files import make_folders


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
        # On a full disk nobody can be told who holds the lock; it is held all the same.
        with suppress(OSError):
            os.truncate(stream.fileno(), 0)
            os.write(stream.fileno(), holder.encode())
        yield

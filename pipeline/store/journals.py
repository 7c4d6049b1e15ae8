"""Journals: files to which lines are appended while others read and append."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from pipeline.store.atomic_files import (
    MODE,
    Descriptor,
    content_of,
    flush_path,
    make_folders,
    require_same,
    store_errors,
)


def append(path: Path, line: bytes) -> None:
    """Append a line to a file, flush and read it back; a line cut off before it is ended first.

    Others may append and read meanwhile.

    Raises StoreError if it cannot be written; the file is then cut back to what it was, if
    possible.
    """
    with store_errors(path):
        make_folders(path.parent)
        handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, MODE)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            size = os.fstat(handle).st_size
            torn = size > 0 and os.pread(handle, 1, size - 1) != b"\n"
            content = b"\n" + line if torn else line
            try:
                Descriptor(handle).write(memoryview(content))
                os.fsync(handle)
                require_same(os.pread(handle, len(content), size), content)
                if size == 0:
                    flush_path(path.parent)
            except BaseException:
                with suppress(OSError):
                    os.ftruncate(handle, size)
                raise
        finally:
            os.close(handle)


def blank(path: Path, chosen: Callable[[bytes], Sequence[tuple[int, int]]]) -> None:
    """Overwrite parts of a file with blanks; nobody appends to it meanwhile.

    Parameters
    ----------
    path
        The file.
    chosen
        Begin and end of each part, given the file's content.

    Raises
    ------
    StoreError
        If it cannot be written; some parts may be blank then.
    """
    with store_errors(path):
        handle = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            for begin, end in chosen(content_of(handle)):
                os.pwrite(handle, b" " * (end - begin), begin)
            os.fsync(handle)
        finally:
            os.close(handle)

"""A disk that fails: every call that our one door to the disk makes can be made to fail."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Literal

import pytest

from pipeline.store import atomic_files
from pipeline.store.state import State

# All that the program writes to its output goes through these.
DOORS = (atomic_files,)
# Their calls, and how each of them fails on a disk.
FULL = (errno.EIO, errno.ENOSPC)
CALLS = dict.fromkeys(("open", "write", "fsync", "replace", "mkdir"), FULL)
CALLS |= dict.fromkeys(("fchmod", "pread", "unlink", "rmdir"), (errno.EIO,))
# `short`: a write takes half of what it is given, and what comes next finds the disk full.
# `flipped`: what is read is not what was written. `killed`: the process dies before the call.
Kind = Literal["EIO", "ENOSPC", "short", "flipped", "killed"]
KINDS: tuple[Kind, ...] = ("EIO", "ENOSPC", "short", "flipped")


class Killed(BaseException):
    """The process is dead: nothing of it reaches the disk any more, no cleaning up either."""


@dataclass(slots=True)
class Disk:
    """The calls of a run, of which one fails."""

    kind: Kind
    point: int  # number of the one that fails, from 1, among those that can fail so; 0: none
    lasting: bool = False  # all that come after it fail as well, until the run is over
    die: Callable[[], None] | None = None  # in place of the process's death
    seen: int = 0  # calls that could have failed so far
    struck: str = ""  # name of the call that failed first; empty while none did
    counting: Lock = field(default_factory=Lock)  # threads of a run call side by side

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in CALLS:
            return real

        def call(*arguments: Any, **settings: Any) -> Any:
            if self.kind == "flipped" and name == "pread":
                content = real(*arguments)
                return _flipped(content) if content and self._fails(name) else content
            if self._fails(name):
                return self._fail(real, arguments)
            return real(*arguments, **settings)

        return call

    def pass_by(self, name: str) -> None:
        """Pass a point at which the process may die."""
        if self._fails(name):
            self._fail(None, ())

    def _fails(self, name: str) -> bool:
        if not self._can_fail(name):
            return False
        with self.counting:
            self.seen += 1
            due = self.seen == self.point or (bool(self.struck) and self.lasting)
            if due and not self.struck:
                self.struck = name
            return due

    def _can_fail(self, name: str) -> bool:
        if self.kind == "killed":
            return True
        if self.kind == "short":
            # What comes after the short write finds the disk full, once or until the end.
            return name == "write"
        if self.kind == "flipped":
            return name == "pread"
        return getattr(errno, self.kind) in CALLS[name]

    def _fail(self, real: Any, arguments: tuple[Any, ...]) -> Any:
        if self.kind == "killed":
            self.lasting = True
            if self.die is not None:
                self.die()
            raise Killed
        if self.kind == "short":
            handle, content = arguments
            if self.seen > self.point or len(content) < 2:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self.lasting = True
            return real(handle, content[: len(content) // 2])
        number = getattr(errno, self.kind)
        raise OSError(number, os.strerror(number))


def _flipped(content: bytes) -> bytes:
    place = len(content) // 2
    return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]


@contextmanager
def on(disk: Disk) -> Iterator[Disk]:
    """Let the program write to a disk."""
    with pytest.MonkeyPatch.context() as patched:
        for door in DOORS:
            patched.setattr(door, "os", disk)
        if disk.kind == "killed":
            patched.setattr(State, "write", _dying(disk))
        yield disk


def _dying(disk: Disk) -> Callable[..., None]:
    """Changes of the state file, before and after the commit of which the process may die."""
    real = State.write

    def write(state: State, statement: str, *values: Any) -> None:
        ends = statement == "COMMIT"
        if ends:
            disk.pass_by("before the commit")
        real(state, statement, *values)
        if ends:
            disk.pass_by("after the commit")

    return write

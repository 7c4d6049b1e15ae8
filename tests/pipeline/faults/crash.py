"""A process that dies, or whose calls are refused, at any call that writes below a folder.

`crash.c` is preloaded into it, so that calls of compiled libraries and of SQLite count as well. It
imports everything once and does each work in a copy of itself, so that a death costs little.
"""

from __future__ import annotations

import ctypes
import errno
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Literal

from pipeline.errors import StoreError
from tests.pipeline.faults.fleet import ENVIRONMENT

SOURCE = Path(__file__).with_name("crash.c")
# `refused`: one call is. `full`: from one call on there is no room, until the process ends.
Fault = Literal["killed", "refused", "full"]
FAULTS: dict[Fault, tuple[int, int, int]] = {
    "killed": (1, 0, 0), "refused": (0, errno.EIO, 0), "full": (0, errno.ENOSPC, 1)
}  # fmt: skip
# What works import only where they need it; their own modules are imported as they come.
LOADED = (
    *("pipeline.run.motor_task", "pipeline.run.fleet", "pipeline.run.publishing"),
    *("pipeline.trends.stage", "pipeline.intraday.check", "pipeline.cli.checking"),
)


@dataclass(frozen=True, slots=True)
class End:
    """End of a work: how it ended (``ok``, ``killed``, or the code of an error), and its calls."""

    how: str = "killed"
    failed: tuple[str, ...] = ()  # motors
    seen: int = 0  # calls that could have been struck
    struck: str = ""  # the call that was; empty for none


@dataclass(frozen=True, slots=True)
class Victim:
    """A process that works and crashes on command."""

    stdin: IO[str]
    stdout: IO[str]

    def crash_at(
        self,
        point: int,
        work: Callable[..., object],
        folder: Path,
        output: Path,
        fault: Fault = "killed",
    ) -> End:
        """Do a work, and let its call of a number, from 1, fail; 0: none does."""
        asked = [f"{work.__module__}:{work.__name__}", str(folder), str(output), point, fault]
        self.stdin.write(json.dumps(asked) + "\n")
        self.stdin.flush()
        found = json.loads(self.stdout.readline())
        return End(**found | {"failed": tuple(found["failed"])})


@contextmanager
def victim_in(folder: Path) -> Iterator[Victim]:
    """A victim, with its library in a folder."""
    library = folder / "crash.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
    environment = ENVIRONMENT | {"LD_PRELOAD": str(library)}
    with subprocess.Popen(
        [sys.executable, "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield Victim(process.stdin, process.stdout)
        process.stdin.close()
        assert process.wait(60) == 0


def main() -> None:
    """Do what the lines of stdin ask for; each time the end is a line of stdout."""
    for name in LOADED:
        importlib.import_module(name)
    for line in sys.stdin:
        asked = json.loads(line)
        importlib.import_module(asked[0].partition(":")[0])
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            end = _ended(*asked)
            os.write(writing, json.dumps(asdict(end)).encode())
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as answer:
            sys.stdout.write((answer.read() or json.dumps(asdict(End()))) + "\n")
        sys.stdout.flush()
        os.waitpid(child, 0)


def _ended(work: str, folder: str, output: str, point: int, fault: Fault) -> End:
    module, _, name = work.partition(":")
    function = getattr(importlib.import_module(module), name)
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    library.crash_struck.restype = ctypes.c_char_p
    library.crash_arm(output.encode(), point, *FAULTS[fault])
    how, failed = "ok", []
    try:
        failed = function(Path(folder), Path(output))
    except StoreError as error:
        how = error.code
    library.crash_arm(b"", 0, 0, 0, 0)
    return End(how, tuple(failed or ()), library.crash_seen(), library.crash_struck().decode())


if __name__ == "__main__":
    main()

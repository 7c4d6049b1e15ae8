"""A process that reads damaged logs, with limits: what ends it is known by the mutation."""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Any

from pipeline.config.channels import Channels
from pipeline.config.logs import Logs
from pipeline.ingest import RawLog, read_log
from tests.pipeline.ingest.fuzzing.judging import Outcome, Verdict, judged
from tests.pipeline.ingest.fuzzing.mutations import Mutation
from tests.pipeline.ingest.fuzzing.seeds import Seed, seeds

MEMORY_BYTES = 2**30
"""Memory that a process may take beyond what it has before the first damaged log."""

_ADDRESS_SPACE_BYTES = 4 * 2**30
"""Beyond that too: Arrow's allocator sets some GiB aside that it never touches."""

PATIENCE_S = 60.0
"""Without a word for so long, on a machine that may be busy, a read hangs."""

Read = Callable[[Path, Logs, Channels], RawLog]


class Reader:
    """Hands mutations to a process, and starts it anew where one has ended it.

    Parameters
    ----------
    read
        What reads a log.
    patience_s, memory_bytes
        What a mutation may take.

    Attributes
    ----------
    patience_s
        As above; of the next mutations.
    peak_bytes
        Most memory that a process has taken beyond what it had before the first damaged log.
    """

    def __init__(
        self,
        read: Read = read_log,
        patience_s: float = PATIENCE_S,
        memory_bytes: int = MEMORY_BYTES,
    ) -> None:
        self._read = read
        self._memory_bytes = memory_bytes
        self.patience_s = patience_s
        self._process: BaseProcess | None = None
        self._connection: Connection[Any, Any] | None = None
        self.peak_bytes = 0

    def __enter__(self) -> Reader:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def verdicts(self, seed: Seed, mutations: Sequence[Mutation]) -> Iterator[Verdict]:
        """One for each mutation, in their order."""
        left = list(mutations)
        while left:
            connection = self._started()
            connection.send((seed, left))
            for place in range(len(left)):
                verdict = self._next(connection)
                yield verdict
                if self._process is None:
                    left = left[place + 1 :]
                    break
            else:
                left = []

    def _next(self, connection: Connection[Any, Any]) -> Verdict:
        try:
            if connection.poll(self.patience_s):
                verdict, peak = connection.recv()
                self.peak_bytes = max(self.peak_bytes, peak)
                return verdict
            self._end()
            return Verdict(Outcome.HUNG, f"no word in {self.patience_s:g} s")
        except (EOFError, ConnectionError):
            return Verdict(Outcome.CRASHED, f"the process ended with {self._end()}")

    def _started(self) -> Connection[Any, Any]:
        if self._connection is None:
            context = multiprocessing.get_context("spawn")
            self._connection, other = context.Pipe()
            arguments = (other, self._read, self._memory_bytes)
            self._process = context.Process(target=_serve, args=arguments, daemon=True)
            self._process.start()
            other.close()
            # It has read all seeds.
            self._connection.recv()
        return self._connection

    def _end(self) -> str:
        """End the process, and say how it has ended."""
        if self._process is None or self._connection is None:
            return ""
        self._connection.close()
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        code = self._process.exitcode or 0
        self._process, self._connection = None, None
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def _serve(connection: Connection[Any, Any], read: Read, memory_bytes: int) -> None:
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory() as name, contextlib.suppress(EOFError, ConnectionError):
        # Before the limit, so that the libraries have their threads and pools.
        wholes = {seed.name: _whole(seed, Path(name)) for seed in seeds()}
        most = _address_space() + _ADDRESS_SPACE_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        before = _peak_bytes()
        connection.send(None)
        while True:
            seed, mutations = connection.recv()
            whole = wholes[seed.name]
            for mutation in mutations:
                verdict = judged(seed, whole, Path(name), mutation, read)
                taken = _peak_bytes() - before
                if taken > memory_bytes:
                    verdict = Verdict(Outcome.MEMORY, f"{taken} bytes after {verdict}")
                connection.send((verdict, taken))


def _whole(seed: Seed, folder: Path) -> RawLog:
    path = folder / seed.file_name
    path.write_bytes(seed.data)
    return read_log(path, *seed.source)


def _peak_bytes() -> int:
    # Not `ru_maxrss`: it begins with the peak of the process that started this one.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024


def _address_space() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()

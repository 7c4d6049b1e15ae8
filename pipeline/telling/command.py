"""A command of the user's own as a receiver."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import BinaryIO

from pipeline.errors import one_line
from pipeline.telling.delivery import DEADLINE_S, Delivery, UndeliveredError

# Of what a command says on stderr, the last bytes are told.
LAST_BYTES = 200


@dataclass(frozen=True, slots=True)
class Command:
    """A program that gets each delivery on its standard input; exit code 0 says that it took it.

    Attributes
    ----------
    arguments
        The program and its arguments; no shell, and nothing of a log is among them.
    """

    arguments: tuple[str, ...]
    deadline_s: float = DEADLINE_S
    name: str = "command"
    label: str = "alarms.command"

    def take(self, delivery: Delivery) -> None:
        """Run the program; only its own end is waited for, not that of what it started."""
        try:
            # Files, not pipes: a child that holds a pipe open would hold up the run.
            with TemporaryFile() as given, TemporaryFile() as said:
                given.write(delivery.content)
                given.seek(0)
                code = self._run(given, said)
                end = said.seek(0, os.SEEK_END)
                said.seek(max(0, end - LAST_BYTES))
                words = one_line(said.read().decode("utf-8", "replace").strip())
        except (OSError, ValueError) as error:
            raise UndeliveredError(one_line(str(error))) from error
        if code:
            raise UndeliveredError(f"ended with {code}{': ' if words else ''}{words}")

    def _run(self, given: BinaryIO, said: BinaryIO) -> int:
        with subprocess.Popen(  # noqa: S603 - the config names the program
            self.arguments,
            stdin=given,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        ) as process:
            try:
                return process.wait(self.deadline_s)
            except BaseException as error:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                if isinstance(error, subprocess.TimeoutExpired):
                    why = f"did not end within {self.deadline_s:g} s and was killed"
                    raise UndeliveredError(why, hung=True) from None
                raise

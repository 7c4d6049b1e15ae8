"""Deliveries and what takes them: a contract, and a command of the user's own."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import BinaryIO, Protocol

from pipeline.errors import one_line

# Longest time for a delivery to a receiver [s].
DEADLINE_S = 30.0
# Kind of a delivery with the state of every motor.
SUMMARY = "summary"
# Name of the receiver that takes summaries.
EMAIL = "email"
# Bytes at the end of a command's stderr that are quoted.
LAST_BYTES = 200


@dataclass(frozen=True, slots=True)
class Delivery:
    """Content of a delivery to a receiver."""

    id: str  # the same at each try
    content: bytes  # JSON


class UndeliveredError(Exception):
    """A receiver has not taken a delivery: why, without secrets, and if the deadline passed."""

    def __init__(self, why: str, *, hung: bool = False) -> None:
        super().__init__(why)
        self.why = why
        self.hung = hung


class Receiver(Protocol):
    """A receiver: its name in the outbox, which stays, and a label for people without secrets."""

    @property
    def name(self) -> str: ...

    @property
    def label(self) -> str: ...

    def take(self, delivery: Delivery) -> None:
        """Take a delivery, within a deadline.

        Raises UndeliveredError if it was not taken, or that is not known.
        """


@dataclass(frozen=True, slots=True)
class Command:
    """A program that gets each delivery on its standard input, and takes it with exit code 0."""

    # The program and its arguments; no shell, and nothing of a log is among them.
    arguments: tuple[str, ...]
    deadline_s: float = DEADLINE_S
    name: str = "command"
    label: str = "alarms.command"

    def take(self, delivery: Delivery) -> None:
        """Run the program; processes that it started are not waited for."""
        try:
            # Files, not pipes: a child that holds a pipe open would hold up the run.
            with TemporaryFile() as stdin, TemporaryFile() as stderr:
                stdin.write(delivery.content)
                stdin.seek(0)
                code = self._run(stdin, stderr)
                stderr.seek(max(0, stderr.seek(0, os.SEEK_END) - LAST_BYTES))
                words = one_line(stderr.read().decode("utf-8", "replace").strip())
        except (OSError, ValueError) as error:
            raise UndeliveredError(one_line(str(error))) from error
        if code:
            raise UndeliveredError(f"ended with {code}{': ' if words else ''}{words}")

    def _run(self, stdin: BinaryIO, stderr: BinaryIO) -> int:
        with subprocess.Popen(  # noqa: S603 - the config names the program
            self.arguments,
            stdin=stdin,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
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

"""The receivers that a config names, and one of them: a command of the user's own."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import BinaryIO

from pipeline.config import Alarms
from pipeline.errors import one_line
from pipeline.notification.delivery import DEADLINE_S, Delivery, Receiver, UndeliveredError

# Bytes at the end of a command's stderr that are quoted.
LAST_BYTES = 200


def receivers_of(settings: Alarms) -> tuple[Receiver, ...]:
    """All that `[alarms]` names; none by default."""
    receivers: list[Receiver] = []
    if settings.command:
        receivers.append(Command(settings.command))
    if settings.webhook_url:
        from pipeline.notification.web_hook import WebHook

        receivers.append(
            WebHook(settings.webhook_url, settings.webhook_headers, settings.webhook_secret)
        )
    if settings.email.to:
        from pipeline.notification.mail import Mail

        receivers.append(Mail(settings.email))
    return tuple(receivers)


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

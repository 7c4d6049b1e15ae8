"""Deliveries and what takes them: a contract, and what servers as receivers share."""

from __future__ import annotations

import os
import re
import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from pipeline.config.alarms import HEADER_VALUE, VARIABLE
from pipeline.errors import one_line

# Longest time for one delivery to one receiver [s].
DEADLINE_S = 30.0
# Kind of a delivery with the state of every motor.
SUMMARY = "summary"


@dataclass(frozen=True, slots=True)
class Delivery:
    """Content of one delivery to a receiver."""

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


def talk(
    to_server: Callable[[], None], words: Callable[[Exception], str], deadline_s: float
) -> None:
    """Talk to a server within a deadline; what that raises is reported in the words given.

    A thread does that and is abandoned at the deadline: neither the look-up of a name nor an
    answer that comes byte by byte has a time limit of its own.

    Raises UndeliveredError with those words, or at the deadline.
    """
    answers: list[str] = []

    def ask() -> None:
        try:
            to_server()
            answers.append("")
        except Exception as error:  # the edge of the thread
            answers.append(words(error))

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(deadline_s)
    if not answers:
        raise UndeliveredError(f"no answer within {deadline_s:g} s", hung=True)
    if answers[0]:
        raise UndeliveredError(one_line(answers[0]))


def fault_words(reason: object) -> str:
    """A fault of a connection in words that quote nothing, as addresses may hold secrets."""
    if isinstance(reason, ssl.SSLCertVerificationError):
        return f"its certificate: {reason.verify_message}"
    if isinstance(reason, OSError) and reason.strerror:
        return reason.strerror
    return type(reason).__name__


def filled(setting: str, text: str) -> str:
    """A value of `[alarms]` with its environment variables.

    Raises UndeliveredError if one is not set, or holds characters that no header may; its content
    is not quoted.
    """

    def content(match: re.Match[str]) -> str:
        name = match[1]
        value = os.environ.get(name, "")
        if not HEADER_VALUE.fullmatch(value):
            what = "holds characters that no header may have" if value else "is not set"
            raise UndeliveredError(f"environment variable {name} of alarms.{setting} {what}")
        return value

    return VARIABLE.sub(content, text)

"""Deliveries and what takes them: a command, mail over SMTP, a web hook by Standard Webhooks 1.0.

The specification: https://github.com/standard-webhooks/standard-webhooks, version 1.0.0.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import http.client
import json
import os
import re
import signal
import smtplib
import ssl
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from email.message import EmailMessage
from email.utils import formatdate
from functools import partial
from tempfile import TemporaryFile
from typing import Any, BinaryIO, Protocol
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from pipeline.config.settings import HEADER_VALUE, VARIABLE, Email, mail_server
from pipeline.errors import one_line
from pipeline.messages import as_sentence, plain

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


# Servers

SECRET_PREFIX = "whsec_"  # noqa: S105 - how the specification marks a secret
# Characters of a subject at most; the rest stands in the text.
LONGEST_SUBJECT = 150
SENSORS = ("pressure_zero", "flow_zero")
URGENCY = {
    "risen": -5,
    "confirmed": -5,
    "alarm": -4,
    "warning": -3,
    "common_cause": -2,
    "stale": -1,
    "removed": -1,
}

Row = Mapping[str, Any]
# A motor, and lines on it.
Paragraph = tuple[str, list[str]]


@dataclass(frozen=True, slots=True)
class Mail:
    """A mail server that takes a message for all addresses of `[alarms.email]`."""

    settings: Email  # `[alarms.email]` of the config
    deadline_s: float = DEADLINE_S
    name: str = EMAIL

    @property
    def label(self) -> str:
        """The server as the config states it."""
        return f"alarms.email ({self.settings.server})"

    def take(self, delivery: Delivery) -> None:
        """Send it; refused if the server refuses any of the addresses."""
        message = message_of(delivery, self.settings)
        password = fill_in("email.password", self.settings.password)
        talk(lambda: self._send(message, password), _mail_fault, self.deadline_s)

    def _send(self, message: EmailMessage, password: str) -> None:
        place = mail_server(self.settings.server)
        assert place is not None, "the config has refused it"
        encryption, host, port = place
        context = ssl.create_default_context()
        # Longer than the deadline, which decides: smtplib reports its own as a closed connection.
        timeout = 2 * self.deadline_s
        with (
            smtplib.SMTP_SSL(host, port, timeout=timeout, context=context)
            if encryption == "smtps"
            else smtplib.SMTP(host, port, timeout=timeout)
        ) as server:
            if not encryption:
                server.starttls(context=context)
            if self.settings.user:
                server.login(self.settings.user, password)
            if refused := server.send_message(message):
                raise smtplib.SMTPRecipientsRefused(refused)


def message_of(delivery: Delivery, settings: Email) -> EmailMessage:
    """Return the message of a delivery; if it is repeated, of the same `Message-ID`."""
    document = json.loads(delivery.content)
    write = _summary if document["type"] == SUMMARY else _changes
    subject, paragraphs = write(document["changes"])
    message = EmailMessage()
    message["Subject"] = one_line(f"{document['fleet']}: {subject}", LONGEST_SUBJECT)
    message["From"] = settings.sender
    message["To"] = ", ".join(settings.to)
    message["Date"] = formatdate()
    message["Message-ID"] = f"<{delivery.id}@motor-leakage>"
    message["Auto-Submitted"] = "auto-generated"
    pages = f"{settings.report_url.rstrip('/')}/motors"
    for motor, lines in paragraphs:
        if settings.report_url:
            lines.append(f"{pages}/{motor}.html")
    message.set_content("\n\n".join("\n  ".join(lines) for _, lines in paragraphs))
    return message


def _summary(motors: Sequence[Row]) -> tuple[str, list[Paragraph]]:
    """Return subject and paragraphs on the states of all motors."""
    counts = Counter(row["state"] for row in motors)
    subject = ", ".join(f"{n} {plain(state)}" for state, n in counts.items())
    paragraphs = []
    for row in motors:
        order = f"{as_sentence(row['headline'])} {row['advice']}"
        lines = [f"{row['motor_id']}: {plain(row['state'])}", order, as_sentence(row["sentence"])]
        paragraphs.append((row["motor_id"], lines))
    return f"week: {subject}", paragraphs


def _changes(changes: Sequence[Row]) -> tuple[str, list[Paragraph]]:
    """Return subject and paragraphs on changes of state, the most urgent motor first."""
    courses: dict[str, list[Row]] = {}
    for row in sorted(changes, key=_when):
        sensor = row["cause"] if row.get("cause") in SENSORS else ""
        courses.setdefault(plain(f"{row['motor_id']} {sensor}").strip(), []).append(row)
    last = {name: rows[-1]["to_state"] for name, rows in courses.items()}
    names = sorted(courses, key=lambda name: (URGENCY.get(last[name], 0), name))
    subject = "; ".join(f"{name} {plain(last[name])}" for name in names)
    return subject, [_paragraph(name, courses[name]) for name in names]


def _when(row: Row) -> str:
    """Return night of a row of `alarms`, or time of a row of `intraday`."""
    return str(row.get("night") or row["time"])


def _paragraph(name: str, course: Sequence[Row]) -> Paragraph:
    """Return the last state with its reason, which ends on what to do, and those before it."""
    last = course[-1]
    states = [f"{plain(row['to_state'])} since {_when(row)}" for row in reversed(course)]
    before = ", ".join([*states[1:], plain(course[0]["from_state"])])
    words = last.get("sentence") or last["reason"]
    sentences = as_sentence(words).replace(". ", ".\n").splitlines()
    figures = [f"Figures are of the night of {last['night']}."] if "night" in last else []
    headline = f"{name}: {states[0]}; before that {before}"
    return last["motor_id"], [headline, *sentences, *figures]


def _mail_fault(error: Exception) -> str:
    if isinstance(error, smtplib.SMTPRecipientsRefused):
        return f"refused for {', '.join(sorted(error.recipients))}"
    if isinstance(error, smtplib.SMTPResponseException):
        return f"SMTP {error.smtp_code}"
    return str(error) if isinstance(error, smtplib.SMTPException) else fault_words(error)


@dataclass(frozen=True, slots=True)
class WebHook:
    """An address that deliveries are posted to; any answer of 200 to 299 says that it took it."""

    # url, headers, secret: as `[alarms]` states them, with environment variables as ``${NAME}``.
    url: str = field(repr=False)
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)
    secret: str = ""
    deadline_s: float = DEADLINE_S
    name: str = "webhook"

    @property
    def label(self) -> str:
        """Scheme and host: a path or query may hold a token."""
        parts = urlsplit(self.url)
        return f"alarms.webhook_url ({parts.scheme}://{parts.netloc})"

    def take(self, delivery: Delivery) -> None:
        """Post it."""
        now = int(time.time())
        headers = {
            "User-Agent": "motor-leakage",
            **{name: fill_in("webhook_headers", text) for name, text in self.headers.items()},
            "Content-Type": "application/json",
            "webhook-id": delivery.id,
            "webhook-timestamp": str(now),
        }
        if self.secret:
            key = signing_key(fill_in("webhook_secret", self.secret))
            headers["webhook-signature"] = signature(key, delivery.id, now, delivery.content)
        request = Request(self.url, delivery.content, headers, method="POST")  # noqa: S310
        post = partial(build_opener(_Nowhere).open, request, timeout=2 * self.deadline_s)
        talk(lambda: post().close(), _web_fault, self.deadline_s)


def signature(key: bytes, delivery_id: str, timestamp: int, content: bytes) -> str:
    """Return HMAC-SHA256 over id, time and body, as receivers expect it.

    Examples
    --------
    The example of the specification's own libraries:

    >>> key = signing_key("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw")
    >>> signature(key, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    'v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE='
    """
    signed = f"{delivery_id}.{timestamp}.".encode() + content
    return "v1," + base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()


def signing_key(secret: str) -> bytes:
    """Return the key in a secret; raises UndeliveredError if it is no Base64."""
    text = secret.removeprefix(SECRET_PREFIX)
    try:
        key = base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    except (binascii.Error, ValueError):
        key = b""
    if not key:
        raise UndeliveredError("the secret of alarms.webhook_secret is no Base64")
    return key


class _Nowhere(HTTPRedirectHandler):
    """Follows no redirect: nobody but the address in the config gets headers and alarms."""

    def redirect_request(self, *_: object) -> None:
        """Return None: a redirect is an answer like others."""


def _web_fault(error: Exception) -> str:
    if isinstance(error, HTTPError):
        error.close()
        phrase = http.client.responses.get(error.code, "")
        followed = "; redirects are not followed" if error.code // 100 == 3 else ""
        return f"HTTP {error.code} {phrase}".rstrip() + followed
    reason = error.reason if isinstance(error, URLError) else error
    if isinstance(reason, http.client.HTTPException):
        return f"the answer is no HTTP ({type(reason).__name__})"
    return fault_words(reason)


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
    """Return a fault of a connection in words that quote nothing, as addresses may hold secrets."""
    if isinstance(reason, ssl.SSLCertVerificationError):
        return f"its certificate: {reason.verify_message}"
    if isinstance(reason, OSError) and reason.strerror:
        return reason.strerror
    return type(reason).__name__


def fill_in(setting: str, text: str) -> str:
    """Return a value of `[alarms]` with its environment variables.

    Raises UndeliveredError if any is not set, or holds characters that no header may; its content
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

"""Mail as a receiver: one message a delivery, over SMTP."""

from __future__ import annotations

import json
import smtplib
import ssl
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from email.message import EmailMessage
from email.utils import formatdate
from typing import Any

from pipeline.config.receivers import mail_server
from pipeline.config.watching import Email
from pipeline.errors import one_line
from pipeline.messages import plain, statement
from pipeline.telling.delivery import DEADLINE_S, Delivery, fault_words, filled, talk
from pipeline.telling.outbox import SUMMARY

# Name of the receiver in the outbox.
EMAIL = "email"
PORTS = {"starttls": 587, "tls": 465, "none": 25}
# Characters of a subject at most; the rest stands in the text.
LONGEST_SUBJECT = 150
RISING = ("stale", "common_cause", "warning", "alarm", "look_now")

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Mail:
    """A mail server that takes a message for all addresses of `[alarms.email]`."""

    settings: Email  # `[alarms.email]` of the config
    deadline_s: float = DEADLINE_S
    name: str = EMAIL

    @property
    def label(self) -> str:
        """Host and port of the server."""
        return "alarms.email ({}:{})".format(*self._place())

    def take(self, delivery: Delivery) -> None:
        """Send it; refused if the server refuses one of the addresses."""
        message = message_of(delivery, self.settings)
        password = filled("email.password", self.settings.password)
        talk(lambda: self._sent(message, password), _words, self.deadline_s)

    def _sent(self, message: EmailMessage, password: str) -> str:
        """Send; returns a fault or an empty text."""
        with self._connected() as server:
            if self.settings.user:
                server.login(self.settings.user, password)
            refused = server.send_message(message)
        return f"refused for {', '.join(sorted(refused))}" if refused else ""

    def _connected(self) -> smtplib.SMTP:
        host, port = self._place()
        context = ssl.create_default_context()
        if self.settings.security == "tls":
            return smtplib.SMTP_SSL(host, port, timeout=self.deadline_s, context=context)
        server = smtplib.SMTP(host, port, timeout=self.deadline_s)
        if self.settings.security == "starttls":
            try:
                server.starttls(context=context)
            except BaseException:
                server.close()
                raise
        return server

    def _place(self) -> tuple[str, int]:
        place = mail_server(self.settings.server)
        assert place is not None, "the config has refused it"
        host, port = place
        return host, port or PORTS[self.settings.security]


def message_of(delivery: Delivery, settings: Email) -> EmailMessage:
    """The message of a delivery; a repeated one has the same `Message-ID`."""
    document = json.loads(delivery.content)
    if document["type"] == SUMMARY:
        subject, lines = _summary(document["changes"])
    else:
        subject, lines = _changes(document["changes"])
    message = EmailMessage()
    message["Subject"] = one_line(f"{document['fleet']}: {subject}", LONGEST_SUBJECT)
    message["From"] = settings.sender
    message["To"] = ", ".join(settings.to)
    message["Date"] = formatdate()
    message["Message-ID"] = f"<{delivery.id}@motor-leakage>"
    message["Auto-Submitted"] = "auto-generated"
    message.set_content("\n".join(lines))
    return message


def _summary(motors: Sequence[Row]) -> tuple[str, list[str]]:
    """Subject and lines on the states of all motors."""
    counts = Counter(row["state"] for row in motors)
    subject = ", ".join(f"{n} {plain(state)}" for state, n in counts.items())
    lines = []
    for row in motors:
        said = statement(row["sentence"], row.get("advice", ""))
        lines += [f"{row['motor_id']}, {plain(row['state'])}", f"  {said}", ""]
    return f"week: {subject}", lines


def _changes(changes: Sequence[Row]) -> tuple[str, list[str]]:
    """Subject and lines on changes of state."""
    of_motors = _by_motor(changes)
    subject = "; ".join(f"{motor} {plain(rows[-1]['to_state'])}" for motor, rows in of_motors)
    return subject, [line for one in of_motors for line in _paragraph(*one)]


def _when(row: Row) -> str:
    """Night of a row of `alarms`, or time of one of `looks`."""
    return str(row.get("night") or row["time"])


def _by_motor(changes: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Rows of each motor by night, the motor that needs attention most first."""
    of_motor: dict[str, list[Row]] = {}
    for row in sorted(changes, key=lambda row: (_when(row), _urgency(row))):
        of_motor.setdefault(row["motor_id"], []).append(row)
    return sorted(of_motor.items(), key=lambda one: (-_urgency(one[1][-1]), one[0]))


def _urgency(row: Row) -> int:
    state = row["to_state"]
    return RISING.index(state) if state in RISING else -1


def _paragraph(motor: str, rows: Sequence[Row]) -> Iterator[str]:
    yield motor
    for row in rows:
        before, after = plain(row["from_state"]), plain(row["to_state"])
        yield f"  {_when(row)}, {before} to {after}: {row['reason']}"
    yield ""


def _words(error: Exception) -> str:
    if isinstance(error, smtplib.SMTPRecipientsRefused):
        return f"refused for {', '.join(sorted(error.recipients))}"
    if isinstance(error, smtplib.SMTPResponseException):
        return f"SMTP {error.smtp_code}"
    return str(error) if isinstance(error, smtplib.SMTPException) else fault_words(error)

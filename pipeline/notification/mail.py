"""Mail as a receiver: a message for each delivery, over SMTP."""

from __future__ import annotations

import json
import smtplib
import ssl
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from email.message import EmailMessage
from email.utils import formatdate
from typing import Any

from pipeline.config.alarms import Email, mail_server
from pipeline.errors import one_line
from pipeline.messages import as_sentence, plain
from pipeline.notification.delivery import (
    DEADLINE_S,
    EMAIL,
    SUMMARY,
    Delivery,
    fault_words,
    filled,
    talk,
)

PORTS = {"starttls": 587, "tls": 465, "none": 25}
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
        password = filled("email.password", self.settings.password)
        talk(lambda: self._send(message, password), _words, self.deadline_s)

    def _send(self, message: EmailMessage, password: str) -> None:
        with self._connected() as server:
            if self.settings.security == "starttls":
                server.starttls(context=ssl.create_default_context())
            if self.settings.user:
                server.login(self.settings.user, password)
            if refused := server.send_message(message):
                raise smtplib.SMTPRecipientsRefused(refused)

    def _connected(self) -> smtplib.SMTP:
        place = mail_server(self.settings.server)
        assert place is not None, "the config has refused it"
        host, port = place[0], place[1] or PORTS[self.settings.security]
        # Longer than the deadline, which decides: smtplib reports its own as a closed connection.
        timeout = 2 * self.deadline_s
        if self.settings.security == "tls":
            context = ssl.create_default_context()
            return smtplib.SMTP_SSL(host, port, timeout=timeout, context=context)
        return smtplib.SMTP(host, port, timeout=timeout)


def message_of(delivery: Delivery, settings: Email) -> EmailMessage:
    """The message of a delivery; if it is repeated, of the same `Message-ID`."""
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
    """Subject and paragraphs on the states of all motors."""
    counts = Counter(row["state"] for row in motors)
    subject = ", ".join(f"{n} {plain(state)}" for state, n in counts.items())
    paragraphs = []
    for row in motors:
        order = f"{as_sentence(row['headline'])} {row['advice']}"
        lines = [f"{row['motor_id']}: {plain(row['state'])}", order, as_sentence(row["sentence"])]
        paragraphs.append((row["motor_id"], lines))
    return f"week: {subject}", paragraphs


def _changes(changes: Sequence[Row]) -> tuple[str, list[Paragraph]]:
    """Subject and paragraphs on changes of state, the motor that needs attention most first."""
    courses: dict[str, list[Row]] = {}
    for row in sorted(changes, key=_when):
        sensor = row["cause"] if row.get("cause") in SENSORS else ""
        courses.setdefault(plain(f"{row['motor_id']} {sensor}").strip(), []).append(row)
    last = {name: rows[-1]["to_state"] for name, rows in courses.items()}
    names = sorted(courses, key=lambda name: (URGENCY.get(last[name], 0), name))
    subject = "; ".join(f"{name} {plain(last[name])}" for name in names)
    return subject, [_paragraph(name, courses[name]) for name in names]


def _when(row: Row) -> str:
    """Night of a row of `alarms`, or time of a row of `intraday`."""
    return str(row.get("night") or row["time"])


def _paragraph(name: str, course: Sequence[Row]) -> Paragraph:
    """The last state with its reason, which ends on what to do, and those before it."""
    last = course[-1]
    states = [f"{plain(row['to_state'])} since {_when(row)}" for row in reversed(course)]
    before = ", ".join([*states[1:], plain(course[0]["from_state"])])
    words = last.get("sentence") or last["reason"]
    sentences = as_sentence(words).replace(". ", ".\n").splitlines()
    figures = [f"Figures are of the night of {last['night']}."] if "night" in last else []
    headline = f"{name}: {states[0]}; before that {before}"
    return last["motor_id"], [headline, *sentences, *figures]


def _words(error: Exception) -> str:
    if isinstance(error, smtplib.SMTPRecipientsRefused):
        return f"refused for {', '.join(sorted(error.recipients))}"
    if isinstance(error, smtplib.SMTPResponseException):
        return f"SMTP {error.smtp_code}"
    return str(error) if isinstance(error, smtplib.SMTPException) else fault_words(error)

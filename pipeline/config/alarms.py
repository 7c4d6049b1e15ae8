"""`[alarms]`: rules for the states, and who is notified; no error quotes a secret."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from pipeline.config.section import Misfit, Positive, Section, Stage, left_out

# Ports of a mail server, where it states none: with STARTTLS, over TLS, and without encryption.
MAIL_PORTS = {"": 587, "smtps": 465, "smtp": 25}
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
# An environment variable in a value.
VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")
HEADER_NAME = re.compile(r"[A-Za-z0-9_-]+")
HEADER_VALUE = re.compile(r"[\x20-\x7e]+")
ADDRESS = re.compile(r"[\x21-\x7e]+")
# Headers that the program sets itself, and all that begin with `webhook-`.
OWN_HEADERS = ("connection", "content-length", "content-type", "host", "transfer-encoding")


def _web_address(url: str) -> str:
    try:
        parts = urlsplit(url)
        whole = bool(parts.hostname) and parts.port != 0
    except ValueError:
        whole = False
    if url and not (whole and ADDRESS.fullmatch(url) and parts.scheme in ("http", "https")):
        raise ValueError("expected http:// or https:// and a host, without blanks")
    if "@" in parts.netloc:
        raise ValueError("expected no name or password; webhook_headers is the place for them")
    return url


def _web_headers(headers: dict[str, str]) -> dict[str, str]:
    for name, value in headers.items():
        if not HEADER_NAME.fullmatch(name):
            raise ValueError("expected names of letters, digits and hyphens")
        if name.lower() in OWN_HEADERS or name.lower().startswith("webhook-"):
            raise ValueError(f"expected no {name}: the program sets it itself")
        if not HEADER_VALUE.fullmatch(value) or "$" in VARIABLE.sub("", value):
            raise ValueError(
                f"expected printable ASCII in {name}, and $ in ${{NAME}} alone, which stands for "
                "an environment variable"
            )
    return headers


def _variable(text: str) -> str:
    if text and not VARIABLE.fullmatch(text):
        raise ValueError("expected ${NAME}, with the secret in that environment variable")
    return text


WebAddress = Annotated[str, AfterValidator(_web_address)]
WebHeaders = Annotated[dict[str, str], AfterValidator(_web_headers)]
Secret = Annotated[str, AfterValidator(_variable)]
"""Name of the environment variable that holds a secret, as ``${NAME}``; empty: none."""


def is_mail_address(address: str) -> bool:
    """Return True if mail can go to an address."""
    from email.errors import MessageError
    from email.headerregistry import Address

    try:
        return bool(Address(addr_spec=address).domain)
    except (ValueError, IndexError, MessageError):
        return False


def mail_server(server: str) -> tuple[str, str, int] | None:
    """Return encryption (a key of `MAIL_PORTS`), host and port of a mail server, or None."""
    scheme, _, place = server.rpartition("://")
    try:
        parts = urlsplit(f"//{place}")
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    if not host or port == 0 or not ADDRESS.fullmatch(place) or set(place) & set("/@?#"):
        return None
    return (scheme, host, port or MAIL_PORTS[scheme]) if scheme in MAIL_PORTS else None


class Email(Section):
    """Mail of changes of state over SMTP, and of all states once a week; off without `to`."""

    shapes = Stage.NOTHING

    to: tuple[str, ...] = ()
    """Addresses that get the mail."""
    sender: str = ""
    """Address that it comes from; required with `to`."""
    server: str = ""
    """`host` or `host:port` of the mail server, which has to know STARTTLS; `smtps://host` is over
    TLS, `smtp://host` without encryption; required with `to`."""
    user: str = ""
    """Name to log in with; empty: no log-in."""
    password: Secret = ""
    """`${NAME}`: variable with the password."""
    weekly: Literal["", "mon", "tue", "wed", "thu", "fri", "sat", "sun"] = "mon"
    """Weekday on which all motors' states are sent, or empty."""
    report_url: WebAddress = ""
    """Address of the report, for links."""

    def summary_due(self, today: dt.date) -> dt.date | None:
        """Return date on which the latest weekly summary is due; None without any."""
        if not self.to or not self.weekly:
            return None
        return today - dt.timedelta(days=(today.weekday() - DAYS.index(self.weekly)) % 7)

    def misfits(self) -> Iterator[Misfit]:
        for key, address in [("to", address) for address in self.to] + [("sender", self.sender)]:
            if self.to and not is_mail_address(address):
                yield (key,), "expected an address such as shift@plant.example", address
        if self.to and mail_server(self.server) is None:
            yield self.at("server", "expected host or host:port, after smtps:// or smtp:// if so")
        if bool(self.user) != bool(self.password):
            yield (), "expected user and password together", None
        if self.user and self.server.startswith("smtp:"):
            yield self.at("server", "expected encryption with a password: no smtp://")


class Alarms(Section):
    """Rules for the states `warning` and `alarm`, and who is notified."""

    shapes = Stage.NOTHING

    alarm_percent: Annotated[Positive, Stage.TRENDS] = 30.0
    """Rise that is an alarm, with 97.5 % probability."""
    stale_after_nights: Annotated[int, Stage.TRENDS] = Field(7, ge=1)
    """Nights without data after which a motor is `stale`."""
    false_alarms_per_year: Annotated[Positive, Stage.TRENDS] = Field(0.04, le=12)
    """False alarms per motor and year."""
    command: tuple[str, ...] = ()
    """Program that gets new alarms as JSON on standard input."""
    webhook_url: WebAddress = ""
    """Address that the same is posted to, http or https."""
    webhook_headers: WebHeaders = Field({})
    """Headers of the post; `${NAME}`: a variable."""
    webhook_secret: Secret = ""
    """`${NAME}`: variable with the secret that signs posts (Standard Webhooks)."""
    email: Email = left_out()
    """Mail over SMTP."""

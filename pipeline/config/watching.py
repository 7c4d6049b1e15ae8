"""Settings of trends, alarms and those who are told, and of looks within the day."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from pipeline.config.faults import Misfit
from pipeline.config.receivers import Secret, WebAddress, WebHeaders, is_mail_address, mail_server
from pipeline.config.section import NonNegative, Positive, Section, Share, Stage, left_out

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


class Trend(Section):
    """The motor against its own past: baseline, slope and time to limit."""

    shapes = Stage.TRENDS

    baseline_nights: int = Field(8, ge=8)
    """Nights with blocks of a baseline period, after which the watch begins."""
    confidence: Share = Field(0.95, lt=1)
    """Coverage of the slope's interval."""
    horizon_years: Positive = 5.0
    """A limit that is reached later than this is `beyond_horizon`."""


class Email(Section):
    """Mail of changes of state over SMTP, and of all states once a week; off without `to`."""

    shapes = Stage.NOTHING

    to: tuple[str, ...] = ()
    """Addresses that get the mail."""
    sender: str = ""
    """Address that it comes from; required with `to`."""
    server: str = ""
    """`host` or `host:port` of the mail server; required with `to`."""
    security: Literal["starttls", "tls", "none"] = "starttls"
    """Encryption, with the certificate checked; ports 587, 465 and 25 where `server` states
    none."""
    user: str = ""
    """Name to log in with; empty: no log-in."""
    password: Secret = ""
    """`${NAME}`: environment variable with the password of `user`."""
    weekly: Literal["", "mon", "tue", "wed", "thu", "fri", "sat", "sun"] = "mon"
    """Day of the week whose first run also sends the states of all motors; empty: none."""

    def summary_due(self, today: dt.date) -> dt.date | None:
        """Date on which the latest weekly summary is due; None without any."""
        if not self.to or not self.weekly:
            return None
        return today - dt.timedelta(days=(today.weekday() - DAYS.index(self.weekly)) % 7)

    def misfits(self) -> Iterator[Misfit]:
        """Addresses that no mail can go to; a password without its user, or unencrypted."""
        for key, address in [("to", one) for one in self.to] + [("sender", self.sender)]:
            if self.to and not is_mail_address(address):
                yield (key,), "expected an address such as shift@plant.example", address
        if self.to and mail_server(self.server) is None:
            yield ("server",), "expected host or host:port", self.server
        if bool(self.user) != bool(self.password):
            yield (), "expected user and password together", None
        if self.user and self.security == "none":
            yield ("security",), "expected starttls or tls with a password", self.security


class Alarms(Section):
    """Rules for the states `warning` and `alarm`, and who is told."""

    shapes = Stage.NOTHING

    alarm_percent: Annotated[Positive, Stage.TRENDS] = 30.0
    """Rise over the baseline that is an alarm, once it is beyond it with 97.5 % probability; any
    change that is told is a warning."""
    stale_after_nights: Annotated[int, Stage.TRENDS] = Field(7, ge=1)
    """Nights without blocks after which a motor is `stale`."""
    false_alarms_per_year: Annotated[Positive, Stage.TRENDS] = Field(0.04, le=12)
    """False alarms per motor and year at which the watch tells a change."""
    command: tuple[str, ...] = ()
    """Program and arguments, run without a shell for each delivery; it gets the new rows of
    `alarms` as JSON on its standard input ([trends.md](trends.md#10-notifications))."""
    webhook_url: WebAddress = ""
    """The same is posted to this address, http or https; empty: none."""
    webhook_headers: WebHeaders = Field({})
    """Headers of the post; `${NAME}` in a value is the environment variable NAME."""
    webhook_secret: Secret = ""
    """`${NAME}`: environment variable with the secret in Base64, which signs posts as in Standard
    Webhooks; empty: no signature."""
    email: Email = left_out()
    """Mail over SMTP ([trends.md](trends.md#10-notifications))."""


class Look(Section):
    """Looks within the day; nothing here changes a figure of a night."""

    shapes = Stage.NOTHING

    warm_up_minutes: NonNegative = 20.0
    """Minutes after a start that are not judged, if the motor had stood for as long."""
    blind_after_minutes: Positive = 60.0
    """Minutes without anything to judge after which a motor is `blind`."""

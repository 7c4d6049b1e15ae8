"""All settings of a fleet file, in the order of the work; a motor may override `Settings`."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, Field

from leakage import OperatingConditions
from leakage.estimation.blocks import Windows as Blocks
from pipeline.config.section import (
    Misfit,
    NonNegative,
    Positive,
    Section,
    Stage,
    TimeZone,
    left_out,
)

RelativeFolder = Annotated[str, Field(min_length=1)]
# Length of a block of statistics: no moving average reaches beyond it [s].
BLOCK_S = 120.0
# Of a longer delay the pairing of inputs and drain flow is a guess [s].
MAXIMUM_DELAY_S = 60.0


class Nights(Section):
    """A night is [end hour, next end hour) in local time, labelled by the date on which it ends."""

    shapes = Stage.READING | Stage.BLOCKS

    time_zone: TimeZone = "UTC"
    """IANA time zone of the fleet, such as Europe/Oslo."""
    end_hour: int = Field(6, ge=0, le=23)
    """Local hour at which a night ends."""

    @property
    def zone(self) -> ZoneInfo:
        """The time zone itself."""
        return ZoneInfo(self.time_zone)


class Cleaning(Section):
    """Rules that refuse samples. The table `quality` counts each refusal."""

    shapes = Stage.BLOCKS

    warm_up_minutes: NonNegative = 0.0
    """Time refused after a start from a rest at least as long, while the oil in the case is not yet
    the oil at the sensor; 0: none."""
    refuse_transients: bool = False
    """Refuse changes of speed above 5 rpm/s, or of pressure above 50 bar/s."""


class TransportDelay(Section):
    """Time between the motor and the sensors of its drain line, equation (14)."""

    shapes = Stage.BLOCKS

    fixed_s: Annotated[NonNegative, Field(le=MAXIMUM_DELAY_S)] | None = None
    """The delay, where it is always the same; 0: none. Without it and a drain line the delay of all
    inputs is estimated from the motor's first nights."""
    line_volume_l: Positive | None = None
    """Volume of the drain line, which over the drain flow is the delay; π/4 · length · (inner
    diameter)²."""

    def misfits(self) -> Iterator[Misfit]:
        if self.fixed_s is not None and self.line_volume_l is not None:
            yield self.at("fixed_s", "expected fixed_s or the drain line, not both")

    @property
    def is_on(self) -> bool:
        """True if inputs are paired with the drain flow of another time."""
        return bool(self.fixed_s) or self.line_volume_l is not None

    @property
    def is_estimated(self) -> bool:
        """True if the motor's own nights decide."""
        return self.fixed_s is None and self.line_volume_l is None


class Smoothing(Section):
    """Moving average of the drain flow, and of its regressors with it (model.md, section 4)."""

    shapes = Stage.BLOCKS

    window_s: NonNegative = Field(0.0, lt=BLOCK_S)
    """Length of the centred average; 0: none."""


class Windows(Section):
    """How the blocks of a night are split into training and validation."""

    shapes = Stage.BLOCKS

    split: Literal["chronological", "interleaved"] = "chronological"
    """`chronological`: the first blocks train; `interleaved`: seven train, then three validate."""

    def blocks(self) -> Blocks:
        """Return the same as the estimation takes them."""
        return Blocks(BLOCK_S, split=self.split)


class SensorHealth(Section):
    """Halts that show the zero of the pressure and flow sensors; published in `nights`."""

    shapes = Stage.NIGHT

    without_pressure_at_halts: bool = False
    """The circuit is without pressure at halts; else the low side has to be logged for the flow."""


class Model(Section):
    """Choices of the physics that are not a property of the motor."""

    shapes = Stage.BLOCKS

    film_pressure: Literal["thesis", "slot"] = "thesis"
    """Barus viscosity at the pressure difference (`thesis`) or exact slot flow (`slot`)."""
    two_sided: bool | None = None
    """Paths leak from both sides; by default where the low pressure is known by a channel, be it a
    constant."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions at which a leakage is evaluated."""

    pressure_bar: float
    temperature_c: float
    speed_rpm: float
    # Charge above case pressure of a two-sided motor.
    charge_over_case_bar: float | None = None

    @property
    def operating(self) -> OperatingConditions:
        """The same as the model takes them."""
        return OperatingConditions.from_bar(
            self.pressure_bar, self.temperature_c, self.speed_rpm, self.charge_over_case_bar
        )


class ReferenceConditions(Section):
    """Conditions at which the reference leakage is evaluated."""

    shapes = Stage.FIGURES

    pressure_bar: Positive = 200.0
    """Pressure difference."""
    temperature_c: float = Field(50.0, gt=-60, lt=150)
    """Oil temperature."""
    speed_rpm: NonNegative = 30.0
    """Motor speed."""

    def conditions(self, charge_over_case_bar: float | None = None) -> Conditions:
        """Return these conditions; of a two-sided motor with a charge pressure, else None."""
        return Conditions(
            self.pressure_bar, self.temperature_c, self.speed_rpm, charge_over_case_bar
        )


class Trend(Section):
    """The motor against its own past."""

    shapes = Stage.TRENDS

    baseline_nights: int = Field(8, ge=8)
    """Nights of a baseline, after which the watch begins; more detect less change, later."""


# `[alarms]`: who is notified; no error quotes a secret

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

    alarm_percent: Annotated[float, Field(ge=1.0), Stage.TRENDS] = 30.0
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


class Folders(Section):
    """Folders; each is relative to the fleet file."""

    shapes = Stage.NOTHING

    logs: RelativeFolder = "../logs"
    """Root of the logs, a folder or a URL such as s3://bucket/logs."""
    output: RelativeFolder | None = None
    """Output folder; by default `out/` in the working directory."""
    copy_to: str = Field("", pattern=r"^$|^(s3|az|gs)://[^/\s]+(/\S*)?$")
    """URL that each run copies new and changed tables to, such as s3://bucket/fleet."""


class Execution(Section):
    """Execution of a run; nothing here changes a figure."""

    shapes = Stage.NOTHING

    workers: int = Field(2, ge=1, le=256)
    """Motors fitted at the same time."""
    backend: str = Field("loky", pattern=r"^(loky|sequential|(tcp|tls)://[^/\s]+:[0-9]+)$")
    """Processes of this machine (`loky`), the run's own (`sequential`), or the address of a Dask
    scheduler, such as tcp://10.0.0.5:8786."""
    timeout_s: Positive = Field(600.0, le=604_800.0)
    """Longest time for a night of a motor; a log that does not open within a tenth of it fails."""

    @property
    def answer_s(self) -> float:
        """Longest time in which a log opens: a mount that hangs shows long before a night does."""
        return self.timeout_s / 10

    @property
    def is_cluster(self) -> bool:
        """True if tasks run on a Dask cluster."""
        return "://" in self.backend


class Metrics(Section):
    """Metrics of each run as a file for Prometheus."""

    shapes = Stage.NOTHING

    textfile: str = Field("", pattern=r"^$|\.prom$")
    """File for the node exporter's textfile collector; relative to the fleet file; empty: none."""


class Settings(Section):
    """All that a motor's file may override."""

    shapes = Stage.NOTHING

    nights: Nights = left_out()
    cleaning: Cleaning = left_out()
    transport_delay: TransportDelay = left_out()
    smoothing: Smoothing = left_out()
    windows: Windows = left_out()
    model: Model = left_out()
    reference: ReferenceConditions = left_out()
    sensor_health: SensorHealth = left_out()
    trend: Trend = left_out()
    alarms: Alarms = left_out()


class FleetFile(Settings):
    """`fleet.toml`."""

    name: str = Field(min_length=1)
    """The fleet's name, as reports show it."""
    formerly: str = ""
    """Name before, of a fleet that was renamed: its output is its own."""
    live: bool = True
    """Logs come every night: without a new log for `alarms.stale_after_nights` by this machine's
    clock the motors are `stale`. False for logs of a past time."""
    folders: Folders = left_out()
    execution: Execution = left_out()
    metrics: Metrics = left_out()
    defaults: dict[str, Any] = Field({})
    """Parts of a motor's file, for motors that do not state them; `{name_in_log}` is the motor's
    name in the log."""

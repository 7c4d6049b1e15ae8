"""Settings of the fleet file: what a night is, how samples are cleaned, how a model is fitted.

Every key has its unit in its name and its meaning in its description; ``docs/config.md`` is made
from these models. A motor's file may override any key of any section here.
"""

from __future__ import annotations

import datetime as dt
from functools import cache
from typing import Annotated, Any, Literal
from zoneinfo import ZoneInfo, available_timezones

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from pipeline.config.receivers import (
    require_address,
    require_header,
    require_mail_address,
    require_mail_server,
    require_variable,
)

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]
# The name of a bucket, and a folder in it.
URL_OR_NOTHING = r"^$|^(s3|az|gs)://[^/\s]+(/\S*)?$"
RelativeFolder = Annotated[str, Field(min_length=1)]


@cache  # to list all zones takes longer than to read a motor's file
def known_zone(name: str) -> str:
    """The name itself, if it is one of an IANA time zone."""
    if name not in available_timezones():
        raise ValueError("expected the name of an IANA time zone, such as Europe/Oslo")
    return name


class Section(BaseModel):
    """A table of a config file: unknown keys, infinities and NaN are errors, nothing is coerced."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Folders(Section):
    """Folders; each is relative to the fleet file."""

    motors: RelativeFolder = Field(
        "motors", description="Folder of the motors' files, one per motor"
    )
    motor_types: RelativeFolder = Field("motor_types", description="Folder of the motor types")
    oils: RelativeFolder = Field("oils", description="Folder of the oils")
    oil_circuits: RelativeFolder = Field(
        "oil_circuits", description="Folder of the oil circuits; it may be absent"
    )
    logs: RelativeFolder = Field(
        "../logs",
        description="Root of the logs, a folder or a URL such as s3://bucket/logs; the paths in "
        "`input_files` are relative to it",
    )
    output: RelativeFolder | None = Field(
        None,
        description="Output folder, which holds no logs; default: `out/` in the working directory",
    )
    object_store: str = Field(
        "",
        pattern=URL_OR_NOTHING,
        description="Where the output is published, such as s3://bucket/fleet (or az://, gs://); "
        "the output folder is then its working copy (`scale.md`); empty: the folder is all",
    )


class Nights(Section):
    """A night is [end hour, next end hour) in local time, labelled by the date on which it ends."""

    time_zone: str = Field("UTC", description="IANA time zone of the fleet, such as Europe/Oslo")
    end_hour: int = Field(6, ge=0, le=23, description="Local hour at which a night ends")

    @field_validator("time_zone")
    @classmethod
    def _known_zone(cls, name: str) -> str:
        return known_zone(name)

    @property
    def zone(self) -> ZoneInfo:
        """The time zone itself."""
        return ZoneInfo(self.time_zone)


class TimeBase(Section):
    """The one grid of time on which all channels of a motor's night are brought together."""

    rate_hz: Positive | None = Field(
        None, description="Samples a second; without it the rate of the fastest channel"
    )
    maximum_rate_hz: Positive = Field(10.0, description="Upper limit of the rate where not stated")


class Cleaning(Section):
    """Rules that refuse samples. The table `quality` counts each refusal."""

    standstill_rpm: NonNegative = Field(
        0.5, description="Below this |speed| the motor stands still"
    )
    guard_before_s: NonNegative = Field(
        10.0, description="Time refused before a standstill or a back-flow"
    )
    guard_after_s: NonNegative = Field(
        30.0, description="Time refused after a standstill or a back-flow"
    )
    hampel_window: int = Field(
        11, ge=3, description="Samples in the Hampel filter's centred window; odd"
    )
    hampel_threshold: Positive = Field(
        5.0, description="A spike is further from the local median than this many scaled MAD"
    )
    frozen_after_s: Positive = Field(
        60.0,
        description="A sensor is frozen after this time without a change beyond its resolution",
    )
    gap_sample_periods: Positive = Field(
        5.0, description="Longer silence than this many sample periods is a gap"
    )
    temperature_gap_s: Positive = Field(
        5.0, description="Longer silence than this is a gap in the oil temperature"
    )
    maximum_mean_s: Positive = Field(
        10.0,
        description="A channel logged as means of a longer period than this makes the night fail "
        "with `means_too_long`",
    )
    out_of_order: Literal["sort", "refuse"] = Field(
        "sort",
        description="Samples behind the log's own time: `sort` puts those back whose place is "
        "free, within five sample periods of others, and refuses the rest; `refuse`: all of them",
    )
    refuse_transients: bool = Field(False, description="Refuse fast changes of speed or pressure")
    transient_speed_rpm_per_s: Positive = Field(
        5.0, description="Speed changes faster than this are transients"
    )
    transient_pressure_bar_per_s: Positive = Field(
        50.0, description="Pressure changes faster than this are transients"
    )

    @field_validator("hampel_window")
    @classmethod
    def _odd(cls, samples: int) -> int:
        if samples % 2 == 0:
            raise ValueError("expected an odd number of samples")
        return samples


InputName = Literal["pressure_difference", "oil_temperature", "speed"]


class TransportDelay(Section):
    """Time between the motor and the sensors of its drain line, equation (14)."""

    mode: Literal["off", "fixed", "flow"] = Field(
        "off",
        description="`fixed`: always the same; `flow`: the line's volume over the drain flow. "
        "Either reports an estimate beside it; with `fixed` and 0 s it changes nothing else",
    )
    fixed_s: NonNegative = Field(0.0, description="`fixed`: the delay")
    line_length_m: Positive | None = Field(
        None, description="`flow`: length of the drain line from the motor to the sensor"
    )
    line_inner_diameter_mm: Positive | None = Field(
        None, description="`flow`: inner diameter of the drain line"
    )
    flow_average_s: NonNegative = Field(
        10.0, description="`flow`: averaging time of the drain flow that gives the delay"
    )
    maximum_s: Positive = Field(
        60.0, description="A sample with a longer delay is refused; longest delay estimated"
    )
    leading: tuple[InputName, ...] = Field(
        (),
        description="Inputs that the drain flow follows late: it is paired with them at t − τ "
        "(the thesis; a line that is not full)",
    )
    lagging: tuple[InputName, ...] = Field(
        (),
        description="Inputs measured in the drain line, at the flow sensor: the flow is paired "
        "with them at t + τ (oil temperature in a full line)",
    )

    @model_validator(mode="after")
    def _complete(self) -> TransportDelay:
        named = (*self.leading, *self.lagging)
        if len(set(named)) < len(named):
            raise ValueError("expected each input once among leading and lagging")
        if self.mode != "off" and not named:
            raise ValueError("expected an input in leading or in lagging")
        if self.mode == "flow" and None in (self.line_length_m, self.line_inner_diameter_mm):
            raise ValueError("expected line_length_m and line_inner_diameter_mm beside mode")
        if self.mode == "fixed" and self.fixed_s > self.maximum_s:
            raise ValueError("expected fixed_s no longer than maximum_s")
        return self


class Smoothing(Section):
    """Moving average of the drain flow, and of its regressors with it (model.md, section 4)."""

    window_s: NonNegative = Field(0.0, description="Length of the centred average; 0: none")
    apply_to: Literal["all", "leakage"] = Field(
        "all",
        description="`all`: the same filter on regressors and drain flow, which leaves the loss "
        "factors unbiased; `leakage`: on the drain flow alone, as the thesis does",
    )


class Windows(Section):
    """Blocks of a night, and how they are split into training and validation."""

    block_s: Positive = Field(120.0, description="Length of a block of statistics")
    maximum_blocks: int = Field(
        96, ge=4, description="At most this many blocks are stored a night; neighbours are merged"
    )
    split: Literal["chronological", "interleaved"] = Field(
        "chronological",
        description="`chronological`: the first blocks train, the last validate; `interleaved`: "
        "seven blocks train, three validate, in turn",
    )
    training_share: Share = Field(0.8, lt=1, description="Share of the kept samples that trains")
    guard_blocks: int = Field(
        1, ge=0, description="Blocks left out at each border between training and validation"
    )
    minimum_block_share: NonNegative = Field(
        0.0, le=1, description="A block that kept a smaller share of its samples is left out"
    )
    longest_gap_s: Positive | None = Field(
        None,
        description="Longer gaps between kept samples cut the night into stretches; without it "
        "the night is one",
    )
    minimum_stretch_minutes: NonNegative = Field(
        0.0, description="A stretch with fewer kept samples, as time, is left out"
    )
    minimum_pressure_spread_bar: NonNegative = Field(
        0.0,
        description="Spread of |pressure difference| over the training samples, 5th to 95th "
        "percentile, that a fit needs",
    )
    minimum_speed_spread_rpm: NonNegative = Field(0.0, description="The same of |speed|")
    minimum_temperature_spread_c: NonNegative = Field(
        0.0, description="The same of the oil temperature"
    )
    minimum_kept_share: Share = Field(
        0.6, description="Share of the running motor's samples that must be kept for a fit"
    )
    minimum_training_minutes: Positive = Field(
        5.0, description="Kept samples needed for training, as time"
    )


class Model(Section):
    """Choices of the physics that are not a property of the motor."""

    film_pressure: Literal["thesis", "slot"] = Field(
        "thesis",
        description="`thesis`: Barus viscosity at the pressure difference times the share; `slot`: "
        "exact laminar flow through a slot with Barus viscosity",
    )
    film_pressure_share: NonNegative = Field(
        1.0, le=1, description="Share of the pressure difference in the film; `thesis` only"
    )
    film_pressure_share_tolerance: NonNegative = Field(
        0.0, le=1, description="Stated tolerance of that share; 0: none stated"
    )
    two_sided: bool | None = Field(
        None,
        description="Every path leaks to the case from both sides: the high one at pressure "
        "difference + charge − case pressure, the low one at charge − case pressure; by default "
        "where the charge or low-port pressure is logged, or `charge_pressure_bar` is stated",
    )
    charge_pressure_bar: NonNegative = Field(
        0.0, description="Pressure of the low port, without a channel of it; 0: none stated"
    )
    case_pressure_bar: NonNegative = Field(
        0.0, description="Pressure of the case; `two_sided` without a channel of it"
    )
    charge_pressure_tolerance_bar: NonNegative = Field(
        0.0, description="Stated tolerance of charge − case pressure; 0: none stated"
    )

    roller_scale: Literal["by_information", "fixed"] = Field(
        "by_information",
        description="Scale of a motor's one known curve, that of the cam rollers: estimated where "
        "most of the first nights of a baseline tell it, since speed varies; `fixed`: as the motor "
        "type says, the thesis",
    )

    def is_two_sided(self, *, is_logged: bool = False) -> bool:
        """Two-sided as stated, else where the low side's pressure is stated or logged."""
        is_known = is_logged or self.charge_pressure_bar > 0.0
        return is_known if self.two_sided is None else self.two_sided


class Estimation(Section):
    """Bounded least squares from several starting points; names as in MATLAB's lsqnonlin."""

    starting_points: int = Field(
        10, ge=0, le=1000, description="Starting points a fit, the configured one first"
    )
    search_every_nights: int = Field(
        30,
        ge=0,
        description="The starts are made on every n-th night of the calendar, as an audit of the "
        "certificate, and where that finds the rank short; 1: on every night; 0: there "
        "alone, and by `fit`. Past nights keep what they have; refits search with `--with-starts`",
    )
    gradient_type: Literal["analytic", "2-point", "3-point"] = Field(
        "analytic", description="Method for the Jacobian"
    )
    step_tolerance: Positive = Field(1e-10, description="Stops at a relative step below this")
    function_tolerance: Positive = Field(
        1e-10, description="Stops at a relative change of the criterion below this"
    )
    maximum_iterations: int = Field(200, ge=1, description="Iterations a start may take")
    loss: Literal["squared", "huber"] = Field(
        "squared",
        description="`huber`: training samples with large errors count less, by weights found "
        "before their statistics are made",
    )
    bootstrap_resamples: int = Field(
        499, ge=0, le=100_000, description="Draws of the block bootstrap; 0: none"
    )
    sensitivity_samples: int = Field(
        1500, ge=100, description="Training samples that carry the stated tolerances; thinned"
    )
    seed: int = Field(1, ge=0, description="Seed of the run; a night's seed is derived from it")


class ReferenceConditions(Section):
    """Conditions at which the reference leakage is evaluated."""

    pressure_bar: Positive = Field(200.0, description="Pressure difference")
    temperature_c: float = Field(50.0, gt=-60, lt=150, description="Oil temperature")
    speed_rpm: NonNegative = Field(30.0, description="Motor speed")


class SensorHealth(Section):
    """Halts that show the zero of the pressure and flow sensors; published in `operation`."""

    settle_s: NonNegative = Field(
        45.0, description="Time after the motor has stopped that is left out"
    )
    minimum_s: Positive = Field(
        20.0, description="Credible samples, as time, that a halt needs after that"
    )
    depressurised_below_bar: Positive = Field(
        5.0, description="|pressure difference| all the while; a halt under load shows no zero"
    )


class Trend(Section):
    """The motor against its own past: baseline, slope, change and time to limit."""

    baseline_nights: int = Field(60, ge=15, description="Good nights of a frozen baseline")
    provisional_nights: int = Field(
        15, ge=15, description="Good nights after which a provisional baseline is used"
    )
    confidence: Share = Field(0.95, lt=1, description="Coverage of the slope's interval")
    horizon_years: Positive = Field(
        5.0, description="A limit that is reached later than this is `beyond_horizon`"
    )
    false_discovery_rate: Share = Field(
        0.1, lt=1, description="Slopes with a `q_value` below this are called trends"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Trend:
        if self.provisional_nights > self.baseline_nights:
            raise ValueError("expected provisional_nights no more than baseline_nights")
        return self


DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


class Email(Section):
    """Mail of changes of state over SMTP, and of all states once a week; off without `to`."""

    to: tuple[str, ...] = Field((), description="Addresses that get the mail")
    sender: str = Field("", description="Address that it comes from; required with `to`")
    server: str = Field(
        "", description="`host` or `host:port` of the mail server; required with `to`"
    )
    security: Literal["starttls", "tls", "none"] = Field(
        "starttls",
        description="Encryption, with the certificate checked; ports 587, 465 and 25 where "
        "`server` states none",
    )
    user: str = Field("", description="Name to log in with; empty: no log-in")
    password: str = Field(
        "", description="`${NAME}`: environment variable with the password of `user`"
    )
    weekly: Literal["", "mon", "tue", "wed", "thu", "fri", "sat", "sun"] = Field(
        "mon",
        description="Day of the week whose first run also sends the states of all motors; empty: "
        "none",
    )

    def summary_due(self, today: dt.date) -> dt.date | None:
        """Date on which the latest weekly summary is due; None without any."""
        if not self.to or not self.weekly:
            return None
        return today - dt.timedelta(days=(today.weekday() - DAYS.index(self.weekly)) % 7)

    @field_validator("password")
    @classmethod
    def _is_variable(cls, password: str) -> str:
        return require_variable(password)

    @model_validator(mode="after")
    def _complete(self) -> Email:
        for address in self.to:
            require_mail_address("to", address)
        if self.to:
            require_mail_address("sender", self.sender)
            require_mail_server(self.server)
        if bool(self.user) != bool(self.password):
            raise ValueError("expected user and password together")
        if self.user and self.security == "none":
            raise ValueError("expected security starttls or tls with a password")
        return self


class Alarms(Section):
    """Rules for the states `warning` and `alarm` of an indicator, and for their end."""

    warning_percent: Positive = Field(15.0, description="Rise over the baseline that is a warning")
    alarm_percent: Positive = Field(30.0, description="Rise over the baseline that is an alarm")
    on_nights: tuple[int, int] = Field(
        (3, 5), description="On after m of n nights in a row beyond a level, [m, n]"
    )
    deadband_percent: NonNegative = Field(
        5.0, description="Points below a level that an indicator must fall before it is off"
    )
    off_nights: int = Field(5, ge=1, description="Nights in a row below that, before it is off")
    stale_after_nights: int = Field(
        7, ge=1, description="Nights without a trusted figure after which a state is `stale`"
    )
    false_alarms_per_year: Positive = Field(
        0.1,
        description="False alarms per motor and year, over all its indicators together, for "
        "which the limits of the change test are calibrated",
    )
    command: tuple[str, ...] = Field(
        (),
        description="Program and arguments, run without a shell for each delivery; it gets the new "
        "rows of `alarms` as JSON on its standard input ([trends.md](trends.md#10-notifications))",
    )
    webhook_url: str = Field(
        "", description="The same is posted to this address, http or https; empty: none"
    )
    webhook_headers: dict[str, str] = Field(
        {},
        description="Headers of the post; `${NAME}` in a value is the environment variable NAME",
    )
    webhook_secret: str = Field(
        "",
        description="`${NAME}`: environment variable with the secret in Base64, which signs "
        "posts as in Standard Webhooks; empty: no signature",
    )
    email: Email = Field(
        Email(), description="Mail over SMTP ([trends.md](trends.md#10-notifications))"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Alarms:
        needed, of = self.on_nights
        if not 1 <= needed <= of:
            raise ValueError("expected on_nights as [m, n] with 1 <= m <= n")
        if self.warning_percent >= self.alarm_percent:
            raise ValueError("expected warning_percent below alarm_percent")
        if self.deadband_percent >= self.warning_percent:
            raise ValueError("expected deadband_percent below warning_percent")
        return self

    @field_validator("webhook_url")
    @classmethod
    def _is_address(cls, url: str) -> str:
        if url:
            require_address(url)
        return url

    @field_validator("webhook_headers")
    @classmethod
    def _are_headers(cls, headers: dict[str, str]) -> dict[str, str]:
        for name, value in headers.items():
            require_header(name, value)
        return headers

    @field_validator("webhook_secret")
    @classmethod
    def _is_variable(cls, secret: str) -> str:
        return require_variable(secret)


class Look(Section):
    """Looks within the day; nothing here changes a figure of a night."""

    warm_up_minutes: NonNegative = Field(
        20.0,
        description="Minutes after a start that are not judged, if the motor had stood for as long",
    )
    blind_after_minutes: Positive = Field(
        60.0, description="Minutes without anything to judge after which a motor is `blind`"
    )


class Execution(Section):
    """Execution of a run; nothing here changes a figure."""

    workers: int = Field(2, ge=1, le=256, description="Motors fitted at the same time")
    backend: Literal["loky", "sequential", "dask"] = Field(
        "loky",
        description="`loky`: worker processes, also with `workers` = 1; `sequential`: one after "
        "the other in the run's own process, without limits: a motor that hangs or crashes stops "
        "the run; `dask`: a Dask cluster (`scale.md`)",
    )
    nights_a_part: int = Field(
        14,
        ge=0,
        description="A motor with more new nights than this is done in chunks of so many, which "
        "workers do side by side, over a Dask scheduler or where a run has fewer motors than "
        "workers; 0: never",
    )
    scheduler: str = Field(
        "",
        pattern=r"^$|^(tcp|tls)://[^/\s]+:[0-9]+$",
        description="`dask`: address of the scheduler, such as tcp://10.0.0.5:8786; without it "
        "`workers` Dask workers of this machine",
    )
    tasks_in_flight: int = Field(
        256,
        ge=1,
        description="`dask`: most tasks at the scheduler at a time",
    )
    scheduler_wait_s: Positive = Field(
        30.0,
        description="`dask`: time to wait for the scheduler, and for its first worker",
    )
    timeout_s: float = Field(
        1800.0,
        gt=0.0,
        le=604_800.0,
        allow_inf_nan=False,
        description="Longest time for one night of a motor, or for the trends of a group of "
        "motors; then the worker is ended [s]",
    )
    answer_s: float = Field(
        60.0,
        gt=0.0,
        le=604_800.0,
        allow_inf_nan=False,
        description="A log that does not answer for this long when it is opened fails "
        "(`log_no_answer`), and a motor without an answer for this long is done after the others "
        "are published [s]",
    )
    memory_limit_mib: int = Field(
        4096,
        ge=512,
        le=1_048_576,
        description="Most memory that a worker may ask for, 400 of it for the program itself "
        "(RLIMIT_DATA; enforced on Linux) [MiB]",
    )
    minimum_free_mib: float = Field(
        100.0,
        ge=0,
        description="Free disk space that a run requires beyond its own tables [MiB]; 0: not "
        "checked",
    )
    prove_within_days: int = Field(
        30,
        ge=1,
        le=365,
        description="Days within which every published file is read and compared with its "
        "manifest, a share in each run [days]",
    )
    join_months_after: int = Field(
        14,
        ge=0,
        description="Nights after the end of a month until its files become one a table (all but "
        "`block_statistics`); a night that comes later parts them until the next run without one; "
        "0: never",
    )

    @property
    def hasty(self) -> Execution:
        """The same, for tasks of which others wait for the end."""
        return self.model_copy(update={"timeout_s": min(self.timeout_s, self.answer_s)})


class Retention(Section):
    """Newest nights whose rows `prune` keeps, by table; without a number all are kept."""

    predictions: int | None = Field(None, ge=1, description="Nights kept of `predictions`")
    starts: int | None = Field(None, ge=1, description="Nights kept of `starts`")
    residual_tests: int | None = Field(None, ge=1, description="Nights kept of `residual_tests`")
    sensitivities: int | None = Field(None, ge=1, description="Nights kept of `sensitivities`")


class Metrics(Section):
    """Metrics of each run as a file for Prometheus."""

    textfile: str = Field(
        "",
        pattern=r"^$|\.prom$",
        description="File below the folder of the node exporter's textfile collector, such as "
        "`/var/lib/prometheus/node-exporter/motor-leakage.prom`; relative to the fleet file; "
        "empty: none is written",
    )


class Settings(Section):
    """All that a motor's file may override."""

    nights: Nights = Field(default_factory=lambda: Nights())
    time_base: TimeBase = Field(default_factory=lambda: TimeBase())
    cleaning: Cleaning = Field(default_factory=lambda: Cleaning())
    transport_delay: TransportDelay = Field(default_factory=lambda: TransportDelay())
    smoothing: Smoothing = Field(default_factory=lambda: Smoothing())
    windows: Windows = Field(default_factory=lambda: Windows())
    model: Model = Field(default_factory=lambda: Model())
    estimation: Estimation = Field(default_factory=lambda: Estimation())
    reference: ReferenceConditions = Field(default_factory=lambda: ReferenceConditions())
    sensor_health: SensorHealth = Field(default_factory=lambda: SensorHealth())
    trend: Trend = Field(default_factory=lambda: Trend())
    alarms: Alarms = Field(default_factory=lambda: Alarms())
    look: Look = Field(default_factory=lambda: Look())

    @model_validator(mode="after")
    def _smoothing_fits_a_block(self) -> Settings:
        if self.smoothing.window_s >= self.windows.block_s:
            raise ValueError(
                f"got smoothing.window_s = {self.smoothing.window_s:g}; expected less than "
                f"windows.block_s = {self.windows.block_s:g}"
            )
        return self


class FleetFile(Settings):
    """`fleet.toml`."""

    name: str = Field(min_length=1, description="The fleet's name, as reports show it")
    folders: Folders = Field(default_factory=lambda: Folders())
    execution: Execution = Field(default_factory=lambda: Execution())
    retention: Retention = Field(default_factory=lambda: Retention())
    metrics: Metrics = Field(default_factory=lambda: Metrics())
    defaults: dict[str, Any] = Field(
        default_factory=dict,
        description="Any part of a motor's file, for motors that do not state it: tables are "
        "merged key by key, but a channel's that names a `source` or a `constant` stands alone. "
        "`{name_in_log}` in a text is the motor's name in the log",
    )

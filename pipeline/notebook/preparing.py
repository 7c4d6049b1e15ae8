"""Samples for `leakage.fit_frame`, cleaned, resampled and chosen as the nightly run does."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Iterable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import polars as pl

from leakage.estimation.error_sources import Tolerances
from leakage.frame.fit import fit_frame
from leakage.frame.result import FrameFit
from leakage.frame.samples import CHARGE, FLOW, FrameTable, Period
from leakage.physics.motor import Motor
from pipeline.clock import latest_us
from pipeline.config import Fleet, MotorFile, MotorSpec, Settings, load_fleet
from pipeline.config.nights import night, nights_between, nights_of
from pipeline.errors import UsageError
from pipeline.ingest import RawChannel
from pipeline.logs.files import reaches_us, slice_night
from pipeline.logs.motor_logs import LogShelf
from pipeline.night.fit_night import Insufficient, choose_parts, clean_channels
from pipeline.night.statistics import charge_over_case_bar
from pipeline.night.time_base import Quality, Samples
from pipeline.night.tolerances import tolerances
from pipeline.schema import QUALITY_REASONS, TIMESTAMP
from pipeline.units import canonical_unit

CHANNELS = {
    "pressure_difference": "pressure_bar",
    "oil_temperature": "oil_temperature_c",
    "speed": "speed_rpm",
    "leakage_flow": FLOW,
    "charge_pressure": CHARGE,
}
FRAME = {"time": TIMESTAMP} | dict.fromkeys(CHANNELS.values(), pl.Float64)
REFUSED = {
    "night": pl.Date,
    "channel": pl.String,
    "reason": pl.String,
    "meaning": pl.String,
    "n_samples": pl.Int64,
    "n_refused": pl.Int64,
}


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Samples that are good enough to fit.

    Attributes
    ----------
    frame
        Kept samples on one time base, as :func:`leakage.fit_frame` takes them.
    refused
        By night, channel and rule: samples that it looked at, and those that it refused.
    motor
        The motor with its oil and its primary flushing, as its files state it; None without files.
    tolerances
        Of its sensors, stated or assumed by their kind; None without files.
    settings
        What they were prepared with.
    """

    frame: pl.DataFrame
    refused: pl.DataFrame
    settings: Settings
    motor: Motor | None = None
    tolerances: Tolerances | None = None

    def fit(
        self,
        motor: Motor | None = None,
        *,
        flushing: float | Literal["none", "estimated"] | None = None,
        train: Period | Sequence[Period] | None = None,
        validate: Period | Sequence[Period] | None = None,
    ) -> FrameFit:
        """Fit a motor to the samples, with blocks, smoothing and loss as the settings state them.

        Parameters
        ----------
        motor
            None: the motor of the files.
        flushing, train, validate
            As of :func:`leakage.fit_frame`.

        Raises
        ------
        UsageError
            ``no_motor``: there is none of files, and none is given; ``no_samples``: all were
            refused.
        LeakageError
            As of :func:`leakage.fit_frame`.
        """
        motor = motor or self.motor
        if motor is None:
            raise UsageError("no_motor", "these samples come without a motor: say fit(motor)")
        if not self.frame.height:
            told = "; ".join(self.refused.filter(pl.col("reason") == "unusable")["meaning"])
            raise UsageError("no_samples", f"no sample of these nights can be used: {told}")
        return fit_frame(
            self.frame,
            motor,
            flushing=flushing,
            train=train,
            validate=validate,
            tolerances=self.tolerances,
            windows=self.settings.windows,
            smoothing_s=self.settings.smoothing.window_s,
            smoothing_of=self.settings.smoothing.apply_to,
            loss=self.settings.estimation.loss,
        )

    def __repr__(self) -> str:
        refused = self.refused.filter(pl.col("reason") == "any")["n_refused"].sum()
        return f"<Prepared: {self.frame.height} samples, {refused} readings refused>"


def prepare(
    frame: Any, *, settings: Settings | None = None, columns: Mapping[str, str] | None = None
) -> Prepared:
    """Clean and resample a raw frame as the nightly run does a log.

    Parameters
    ----------
    frame
        As of :func:`leakage.fit_frame`; times may fall or repeat, values be absent or wrong.
    settings
        As of a fleet's config; None: the defaults.
    columns
        Names of the columns in the frame, where they differ.

    Returns
    -------
    Prepared

    Raises
    ------
    ShapeError
        If a column is missing, or in another unit by its name.
    UsageError
        ``no_samples``: the frame has no rows.
    """
    table = FrameTable(frame, columns or {})
    time_us, _ = table.times()
    if not len(time_us):
        raise UsageError("no_samples", "the frame has no rows")
    names = dict(CHANNELS)
    if not table.has(CHARGE):
        del names["charge_pressure"]
    settings = settings or Settings()
    model = settings.model.model_copy(update={"two_sided": "charge_pressure" in names})
    settings = settings.model_copy(update={"model": model})
    channels = {}
    for channel, name in names.items():
        value = table.numbers(name)
        channels[channel] = RawChannel(time_us, value, np.isnan(value), 0)
    file = MotorFile.model_validate(
        {
            "motor_id": "frame",
            "motor_type": "frame",
            "oil": "frame",
            "logs": {"format": "parquet", "files": ("frame",)},
            "channels": {
                channel: {"source": name, "unit": canonical_unit(channel)}
                for channel, name in names.items()
            },
        }
    )
    parts = []
    for label in sorted(nights_of(time_us, settings.nights)):
        here = night(label, settings.nights)
        inside = (time_us >= here.start_us) & (time_us < here.end_us)
        of_night = {name: channel.rows(inside) for name, channel in channels.items()}
        parts.append(_cleaned(file, settings, label, of_night))
    return Prepared(*_joined(parts), settings)


def prepare_log(
    config: Fleet | Path | str,
    motor_id: str,
    since: dt.date | str,
    until: dt.date | str | None = None,
) -> Prepared:
    """Read the logs of a motor of a fleet, and clean them as the nightly run does.

    Parameters
    ----------
    config
        The fleet, or its file.
    motor_id
        The motor.
    since, until
        First and last night, as dates or such as "2026-01-02"; one night without the last.

    Returns
    -------
    Prepared
        With the motor, its oil as on the data sheet.

    Raises
    ------
    ConfigError
        If the config has a fault.
    UsageError
        ``unknown_motor``; ``unknown_night``: no log covers a night; ``oil_changed`` between them;
        ``period``: a night is no date.
    """
    spec = motor_of(config, motor_id)
    return prepare_nights(spec, nights_between(_date(since), _date(until or since)))


def motor_of(config: Fleet | Path | str, motor_id: str) -> MotorSpec:
    """A motor of a fleet; raises as `Fleet.motor`."""
    fleet = config if isinstance(config, Fleet) else load_fleet(Path(config))
    return fleet.motor(motor_id)


def prepare_nights(spec: MotorSpec, nights: Collection[dt.date]) -> Prepared:
    """Samples of some nights of a motor from its logs, in order of time."""
    logs = LogShelf(spec, {}, latest_us(), {})
    labels = sorted(logs.present() & set(nights))
    if not labels:
        told = f"{min(nights)} to {max(nights)}"
        raise UsageError("unknown_night", f"no log of {spec.motor_id} covers {told}")
    if len({spec.file.oil_on(label) for label in labels}) > 1:
        raise UsageError(
            "oil_changed", f"{spec.motor_id} has another oil in some of these nights: choose less"
        )
    prepared = _joined([_of_logs(spec, logs, label) for label in labels])
    motor = spec.motor(labels[-1], spec.file.flushing.mode)
    return Prepared(*prepared, spec.settings, motor, tolerances(spec, labels[-1]))


def _date(night: dt.date | str) -> dt.date:
    try:
        return night if isinstance(night, dt.date) else dt.date.fromisoformat(night)
    except ValueError as error:
        raise UsageError("period", f"{night!r} is no night: write 2026-01-02") from error


Part = tuple[pl.DataFrame, pl.DataFrame]


def _of_logs(spec: MotorSpec, logs: LogShelf, label: dt.date) -> Part:
    channels = raw_channels(spec, logs, label)
    if isinstance(channels, str):
        return _empty(), _refused(label, [], "log", channels)
    return _cleaned(spec.file, spec.settings, label, channels)


def raw_channels(
    spec: MotorSpec, logs: LogShelf, label: dt.date
) -> MutableMapping[str, RawChannel] | str:
    """Channels of a night as logged, or the fault of a log that cannot be read."""
    here = night(label, spec.settings.nights)
    names = logs.of_night(label)
    read = [logs.content(name) for name in (*logs.before_night(here), *names)]
    broken = [one for name in names if (one := logs.files[name]).status != "ok"]
    if broken:
        return broken[0].message or ""
    channels = slice_night([one for one in read if one is not None], here, reaches_us(spec))
    logs.let_go_until(label)
    return channels


def _cleaned(
    file: MotorFile, settings: Settings, label: dt.date, channels: MutableMapping[str, RawChannel]
) -> Part:
    """Kept samples of a night, and what was refused."""
    here = night(label, settings.nights)
    try:
        samples, quality = clean_channels(file, settings, here, channels)
        samples, outside = choose_parts(file, settings, here, samples)
    except Insufficient as outcome:
        return _empty(), _refused(label, [], "night", outcome.reason)
    return _frame(settings, samples), _refused(label, (*quality, *outside))


def _frame(settings: Settings, samples: Samples) -> pl.DataFrame:
    columns: dict[str, Any] = {
        "time": samples.time_us,
        "pressure_bar": samples.pressure_difference_bar,
        "oil_temperature_c": samples.oil_temperature_c,
        "speed_rpm": samples.speed_rpm,
        FLOW: samples.leakage_l_per_min,
    }
    if settings.model.two_sided:
        columns[CHARGE] = charge_over_case_bar(settings.model, samples)
    return pl.DataFrame(columns).with_columns(pl.col("time").cast(TIMESTAMP))


def _refused(
    label: dt.date, quality: Iterable[Quality], channel: str = "", why: str = ""
) -> pl.DataFrame:
    """Counts of each rule that refused anything, or the reason why there is nothing of a night."""
    rows = [
        (label, one.channel, one.reason, _meaning(one.reason), one.n_samples, one.n_refused)
        for one in quality
        if one.n_refused
    ]
    rows += [(label, channel, "unusable", why, 0, 0)] if why else []
    return pl.DataFrame(rows, schema=REFUSED, orient="row")


def _meaning(reason: str) -> str:
    return QUALITY_REASONS[reason].meaning if reason in QUALITY_REASONS else reason


def _empty() -> pl.DataFrame:
    return pl.DataFrame(schema={name: kind for name, kind in FRAME.items() if name != CHARGE})


def _joined(parts: list[Part]) -> Part:
    frames, refused = zip(*parts, strict=True)
    there = [one for one in frames if one.height] or [frames[0]]
    return pl.concat(there), pl.concat(refused)

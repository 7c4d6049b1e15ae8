"""For notebooks: published tables, and samples for `leakage.fit_frame`.

These are cleaned, resampled and chosen as the nightly run does.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Mapping, MutableMapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from leakage.estimation.sensitivities import Tolerances
from leakage.frame.fit import fit_frame
from leakage.frame.result import FrameFit
from leakage.frame.samples import CHARGE, FLOW, FrameTable
from leakage.physics.motor import Motor
from pipeline.clock import latest_us, utc
from pipeline.config import Fleet, MotorFile, MotorSpec, Settings, load_fleet
from pipeline.config.nights import night, nights_between, nights_of
from pipeline.errors import UsageError
from pipeline.ingest import RawChannel
from pipeline.logs.files import reaches_us, slice_night
from pipeline.logs.motor_logs import MotorLogs
from pipeline.night.fit import tolerances
from pipeline.night.fit_night import choose_parts, clean_channels
from pipeline.night.statistics import charge_over_case_bar
from pipeline.night.time_base import Insufficient, Samples
from pipeline.schema import QUALITY, TABLES, TIMESTAMP
from pipeline.store.tables import existing_tables, files_of
from pipeline.units import canonical_unit

CHANNELS = {
    "pressure_difference": "pressure_bar",
    "oil_temperature": "oil_temperature_c",
    "speed": "speed_rpm",
    "leakage_flow": FLOW,
    "charge_pressure": CHARGE,
}
REFUSED = {name: QUALITY.schema[name] for name in ("night", "channel", "reason")}
REFUSED |= {name: QUALITY.schema[name] for name in ("n_samples", "n_refused")}
# Kept samples of a night, rows of what was refused, and why there are none.
Part = tuple[pl.DataFrame, list[tuple[Any, ...]], str]


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Samples that are good enough to fit."""

    frame: pl.DataFrame  # kept samples on a common time base, as `leakage.fit_frame` takes them
    refused: pl.DataFrame  # by night, channel and rule, as in the table `quality`
    notes: tuple[str, ...]  # nights without samples, each with its reason
    settings: Settings
    # The motor with its oil and its primary flushing, and the tolerances of its sensors, as its
    # files state them; None without files.
    motor: Motor | None = None
    tolerances: Tolerances | None = None

    def fit(self, motor: Motor | None = None, **options: Any) -> FrameFit:
        """Fit a motor (None: that of the files) with blocks, smoothing and loss of the settings.

        Options are flushing, train and validate of `leakage.fit_frame`. Raises UsageError
        (``no_motor``, ``no_samples``), and as `leakage.fit_frame`.
        """
        motor = motor or self.motor
        if motor is None:
            raise UsageError("no_motor", "these samples come without a motor: say fit(motor)")
        if not self.frame.height:
            notes = "; ".join(self.notes)
            raise UsageError("no_samples", f"no sample of these nights can be used: {notes}")
        return fit_frame(
            self.frame,
            motor,
            tolerances=self.tolerances,
            windows=self.settings.windows.blocks(),
            smoothing_s=self.settings.smoothing.window_s,
            **options,
        )

    def __repr__(self) -> str:
        refused = self.refused.filter(pl.col("reason") == "any")["n_refused"].sum()
        return f"<Prepared: {self.frame.height} samples, {refused} readings refused>"


def prepare(
    frame: Any, *, settings: Settings | None = None, columns: Mapping[str, str] | None = None
) -> Prepared:
    """Clean and resample a raw frame as the nightly run does a log.

    The frame is as of `leakage.fit_frame`; times may fall or repeat, values be absent or wrong.
    `columns` are names in the frame, where they differ; `settings` as of a fleet's config.
    Raises ShapeError if a column is missing, or in another unit by its name; UsageError
    (``no_samples``) if the frame has no rows.
    """
    table = FrameTable(frame, columns or {})
    time_us, _ = table.times()
    if not len(time_us):
        raise UsageError("no_samples", "the frame has no rows")
    has_charge = table.has(CHARGE)
    names = {channel: name for channel, name in CHANNELS.items() if has_charge or name != CHARGE}
    settings = settings or Settings()
    model = settings.model.model_copy(update={"two_sided": has_charge})
    settings = settings.model_copy(update={"model": model})
    values = {channel: table.numbers(name) for channel, name in names.items()}
    channels = {
        channel: RawChannel(time_us, value, np.isnan(value), 0) for channel, value in values.items()
    }
    file = MotorFile.model_validate(
        {
            **dict.fromkeys(("motor_id", "motor_type", "oil"), "frame"),
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
        parts.append(_clean(file, settings, label, of_night))
    return _join(parts, settings)


def prepare_log(config: Fleet | Path | str, motor_id: str, nights: dt.date | str) -> Prepared:
    """Read the logs of a motor of a fleet, and clean them as the nightly run does.

    `nights` is a night, as a date or such as "2026-01-02", or "2026-01-02..2026-01-08". Raises
    ConfigError if the config has a fault; UsageError (``unknown_motor``, ``unknown_night``,
    ``oil_changed``, ``period``).
    """
    return _of_nights(_motor_of(config, motor_id), _labels(str(nights)))


def fit_periods(
    config: Fleet | Path | str, motor_id: str, train: str, validate: str | None = None
) -> tuple[FrameFit, Prepared]:
    """Fit a motor to some nights of its logs, A..B, and judge it on others.

    Raises as `prepare_log` and `leakage.fit_frame`.
    """
    spec = _motor_of(config, motor_id)
    chosen = [_labels(text) for text in (train, validate) if text]
    prepared = _of_nights(spec, {label for labels in chosen for label in labels})
    periods = []
    for labels in chosen:
        first, last = (night(labels[at], spec.settings.nights) for at in (0, -1))
        periods.append((utc(first.start_us), utc(last.end_us)))
    return prepared.fit(train=periods[0], validate=periods[1] if validate else None), prepared


def _labels(text: str) -> list[dt.date]:
    """Return the nights from A to B, both included, or A alone."""
    first, _, last = text.partition("..")
    try:
        ends = [dt.date.fromisoformat(day) for day in (first, last or first)]
    except ValueError as error:
        message = f"{error}: write nights as 2026-01-02 or 2026-01-02..2026-01-08"
        raise UsageError("period", message) from error
    if ends[0] > ends[1]:
        raise UsageError("period", f"{text!r} ends before it begins")
    return nights_between(*ends)


def _motor_of(config: Fleet | Path | str, motor_id: str) -> MotorSpec:
    fleet = config if isinstance(config, Fleet) else load_fleet(Path(config))
    return fleet.motor(motor_id)


def _of_nights(spec: MotorSpec, nights: Collection[dt.date]) -> Prepared:
    """Return samples of some nights of a motor from its logs, in order of time."""
    logs = MotorLogs(spec, {}, latest_us(), {})
    labels = sorted(logs.present() & set(nights))
    if not labels:
        span = f"{min(nights)} to {max(nights)}"
        raise UsageError("unknown_night", f"no log of {spec.motor_id} covers {span}")
    if len({spec.file.oil_on(label) for label in labels}) > 1:
        message = f"{spec.motor_id} has another oil in some of these nights: choose less"
        raise UsageError("oil_changed", message)
    prepared = _join([_of_logs(spec, logs, label) for label in labels], spec.settings)
    motor = spec.motor(labels[-1], spec.file.flushing.mode)
    return replace(prepared, motor=motor, tolerances=tolerances(spec, labels[-1]))


def _of_logs(spec: MotorSpec, logs: MotorLogs, label: dt.date) -> Part:
    here, names = night(label, spec.settings.nights), logs.of_night(label)
    read = [logs.content(name) for name in (*logs.before_night(here), *names)]
    for name in names:
        if logs.files[name].status != "ok":
            return pl.DataFrame(), [], f"night of {label}: log: {logs.files[name].message}"
    channels = slice_night([log for log in read if log is not None], here, reaches_us(spec))
    logs.let_go_until(label)
    return _clean(spec.file, spec.settings, label, channels)


def _clean(
    file: MotorFile, settings: Settings, label: dt.date, channels: MutableMapping[str, RawChannel]
) -> Part:
    """Return kept samples of a night, and counts of each rule that refused anything."""
    here = night(label, settings.nights)
    try:
        samples, quality = clean_channels(file, settings, here, channels)
        samples, outside = choose_parts(file, here, samples)
    except Insufficient as outcome:
        return pl.DataFrame(), [], f"night of {label}: {outcome.reason}"
    rows = [
        (label, rule.channel, rule.reason, rule.n_samples, rule.n_refused)
        for rule in (*quality, *outside)
        if rule.n_refused
    ]
    return _frame(settings, samples), rows, ""


def _frame(settings: Settings, samples: Samples) -> pl.DataFrame:
    columns: dict[str, Any] = {
        "time": samples.time_us,
        "pressure_bar": samples.pressure_difference_bar,
        "oil_temperature_c": samples.oil_temperature_c,
        "speed_rpm": samples.speed_rpm,
        FLOW: samples.leakage_l_per_min,
    }
    if settings.model.two_sided:
        columns[CHARGE] = charge_over_case_bar(samples)
    return pl.DataFrame(columns).with_columns(pl.col("time").cast(TIMESTAMP))


def _join(parts: list[Part], settings: Settings) -> Prepared:
    frames, refused, notes = zip(*parts, strict=True)
    rows = [row for of_night in refused for row in of_night]
    return Prepared(
        pl.concat([frame for frame in frames if frame.height] or [frames[0]]),
        pl.DataFrame(rows, schema=REFUSED, orient="row"),
        tuple(filter(None, notes)),
        settings,
    )


@dataclass(frozen=True, slots=True)
class Tables:
    """The published tables of an output folder."""

    output: Path

    def table(self, name: str) -> pl.LazyFrame:
        """Return a table by name; columns that an older file lacks are null.

        Raises UsageError (``unknown_table``) if there is none of this name.
        """
        known = {table.name: table for table in TABLES}
        if name not in known:
            raise UsageError("unknown_table", f"no table {name}; there are {', '.join(known)}")
        schema = known[name].schema
        paths = files_of(self.output, known[name])
        if not paths:
            return pl.LazyFrame(schema=schema)
        return pl.scan_parquet(
            paths,
            schema=schema,
            missing_columns="insert",
            extra_columns="ignore",
            hive_partitioning=False,
        )

    def fits(self) -> pl.LazyFrame:
        """Return the primary fit of each motor and night."""
        return self.table("fits").filter("is_primary").sort("motor_id", "night")

    def nights(self) -> pl.LazyFrame:
        """Return the nights of all motors."""
        return self.table("nights").sort("motor_id", "night")


def open_tables(output: Path | str) -> Tables:
    """Open the published tables of an output folder.

    Raises UsageError (``no_tables``) if there are none.
    """
    tables = Tables(Path(output))
    existing_tables(tables.output)
    return tables

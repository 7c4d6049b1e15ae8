"""`motor-leakage check`: the config, and a look at the logs, before a night depends on them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import SECOND_US, Times
from pipeline.clock import microseconds, now, utc
from pipeline.config import MotorSpec
from pipeline.config.channels import ChannelName
from pipeline.config.nights import night_of
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.dates import dated_otherwise, misdated_message, without_misdated
from pipeline.logs.files import change_of, failed, labels_of, spanned, stat_log
from pipeline.logs.finding import FolderLogs, logs_of
from pipeline.logs.processed import FileRecord
from pipeline.messages import counted
from pipeline.night.cleaning import ChannelRules, Rests, clean_channel
from pipeline.schema.fits import DECIDING_NIGHTS, OK, agreed_lag
from pipeline.setup.column_check import (
    Dated,
    changed_readings,
    column_changes,
    differing_units,
    suspect_units,
    unused_qualities,
)
from pipeline.setup.extremes import jumps, repeated_extremes
from pipeline.setup.forecast import NightForecast, forecasts
from pipeline.setup.operation import night_of_log, operation, swapped
from pipeline.setup.propose import LARGEST_LOG_BYTES
from pipeline.setup.sampling import sampling_note

# Objects of a motor that are opened: a check answers in seconds.
OPENED = 3
# A rule that refuses more of a channel's samples than this has no log of single faults before it.
MOST_REFUSED = 0.5
HOW_TO_MEND = {
    "duplicate_time": "do its stamps lack seconds, or fractions of them? Correct logs.time_format",
    "backward_time": "is its time written in another form, or zone? Correct logs.time_format",
    "out_of_range": "is its unit, or valid_range, another one?",
    "bad_quality": "are other codes good? Correct quality_good",
    "not_finite": "correct the column, or logs.missing_tokens",
}
# A line end in UTF-16 or UTF-32 is up to four bytes long.
LINE_END_BYTES = 4
PACKED = (".gz", ".zst")


@dataclass(frozen=True, slots=True)
class ChannelCheck:
    """A channel in one log."""

    channel: str
    unit: str  # as configured
    n_samples: int  # missing ones included
    rate_hz: float | None  # typical; None for fewer than two samples
    median: float | None  # of what was kept, in the unit of the tables; None where nothing was
    share_missing: float
    share_refused: float  # by any rule, missing ones included
    refused_by: Mapping[str, float]  # share by rule, of those that refused any


@dataclass(frozen=True, slots=True)
class MotorCheck:
    """A motor's logs from outside, and the channels of the newest."""

    motor_id: str
    motor_type: str
    log_format: str
    n_files: int
    n_nights: int  # that the files cover
    first: str | None  # label of the first night; None without a readable file
    last: str | None
    faults: tuple[str, ...]  # files that cannot be read, or are named but absent
    placeholders: tuple[str, ...]  # paths of the type, and oils, whose values are placeholders
    channels: tuple[ChannelCheck, ...]
    forecast: tuple[NightForecast, ...]  # nights as a run would have them, by whole logs all
    notes: tuple[str, ...]  # no faults, and yet worth a look


def check_motor(
    spec: MotorSpec, stays: Collection[dt.date] = (), *, is_full: bool = False
) -> MotorCheck:
    """Look at the ends of each of a motor's logs, and into the newest; nothing is written.

    Of logs in an object store, which have to be copied for it, the first and the last few by name.
    Where the newest night would not be fitted, the first and the middle one are looked into, too;
    with `is_full` all are, but for those that stay as published.

    Raises StoreError if an object store cannot be read.
    """
    logs = logs_of(spec)
    names = logs.names
    if spec.log_url and len(names) > OPENED:
        # The first, and the last, which are the newest where names hold a date.
        names = (names[0], *names[1 - OPENED :])
    looked_at = {name: _looked_at(name, logs, spec) for name in names}
    records = without_misdated(looked_at)
    nights = {label for record in records.values() for label in labels_of(record)}
    dated = sorted(
        (max(labels_of(record)), name)
        for name, record in records.items()
        if record.status == "ok" and record.nights
    )
    small = [(label, name) for label, name in dated if records[name].size <= LARGEST_LOG_BYTES]
    channels, unfit, worth = _look_into(spec, small, logs.path) if small else ((), [], [])
    stated = (*spec.motor_type.path, *(spec.oils[name] for name in spec.file.oils))
    broken, written = (
        [
            f"{record.error_code}: {record.message}"
            for record in records.values()
            if record.status == status
        ]
        for status in ("failed", "growing")
    )
    absent = [f"log_missing: {name}: named in the config and absent" for name in logs.absent]
    if not logs.names:
        absent.append(f"no_logs: no log: {'; '.join(logs.unmatched()) or 'logs.files names none'}")
    absent += [
        f"log_misdated: {name}: {misdated_message(records[name], days)}"
        for name, days in dated_otherwise(records).items()
    ]
    open_nights = sorted(nights.difference(stays))
    forecast = tuple(_forecast(spec, records, open_nights, is_full=is_full))
    notes = [*worth, *written, *_lag_notes(spec, forecast)]
    if len(names) != len(logs.names):
        notes.append(
            f"{len(names)} of {len(logs.names)} objects were opened, the first and the last by "
            f"name below {spec.log_url}: nights and channels are theirs"
        )
    faults = [*broken, *absent, *column_changes(spec, dated, logs.path), *unfit]
    if not faults:
        # Of a plant's first day there is nothing to mend.
        unfitted = notes if _is_first_night(spec, records) else faults
        unfitted += _no_night(forecast, n_nights=len(open_nights))
    return MotorCheck(
        motor_id=spec.motor_id,
        motor_type=spec.file.motor_type,
        log_format=spec.file.logs.format,
        n_files=len(logs.names),
        n_nights=len(nights),
        first=min(nights).isoformat() if nights else None,
        last=max(nights).isoformat() if nights else None,
        faults=tuple(faults),
        placeholders=tuple(entry.name for entry in stated if entry.source == "placeholder"),
        channels=channels,
        forecast=forecast,
        notes=(*notes, *_cut(spec, records, logs), *logs.unmatched()),
    )


def _looked_at(name: str, logs: FolderLogs, spec: MotorSpec) -> FileRecord:
    try:
        path = logs.path(name)
    except LogError as error:  # replaced or removed since it was listed
        return failed(FileRecord(name, 0, 0, None), error)
    record = stat_log(name, path)
    if record.status == "failed":
        return record
    spanned_record, why = spanned(record, path, spec), change_of(record, path)
    return spanned_record if why is None else failed(spanned_record, why)


def _forecast(
    spec: MotorSpec,
    records: Mapping[str, FileRecord],
    nights: Sequence[dt.date],
    *,
    is_full: bool,
) -> Iterator[NightForecast]:
    """Forecast the newest night; where it is not fitted, the first and middle one; or all."""
    if is_full:
        yield from forecasts(spec, nights)
        return
    sizes = {
        label: sum(record.size for record in records.values() if label in labels_of(record))
        for label in nights
    }
    small = [label for label in nights if sizes[label] <= LARGEST_LOG_BYTES]
    # The newest, then the first and the middle one.
    for label in dict.fromkeys(small[at] for at in (-1, 0, len(small) // 2) if small):
        (forecast,) = forecasts(spec, [label], records)
        yield forecast
        if forecast.status == OK:
            return


def _lag_notes(spec: MotorSpec, forecast: Sequence[NightForecast]) -> Iterator[str]:
    """Yield how the drain flow is paired with its inputs, and what the nights read say of it."""
    delay_s = spec.drain_delay_s
    if delay_s:
        yield f"drain flow paired with inputs {delay_s:.1f} s before, as the first nights agree"
    first = [asdict(night) for night in forecast if night.status == OK][:DECIDING_NIGHTS]
    lag = agreed_lag(first)
    if delay_s is None and lag is not None and spec.settings.transport_delay.is_estimated:
        which = f"in the night {first[0]['night']}" if len(first) == 1 else "in the first nights"
        yield (
            f"the drain flow lags pressure and speed by {lag[0]:.1f} s {which}, which explains "
            f"{lag[1]:.0f} % more of it: a run pairs all nights so if {DECIDING_NIGHTS} agree"
        )


def _is_first_night(spec: MotorSpec, records: Mapping[str, FileRecord]) -> bool:
    """True where the motor has no night that is over: all its logs are still being written."""
    current = night_of(microseconds(now()), spec.settings.nights)
    return all(
        record.status == "growing" or min(labels_of(record), default=current) >= current
        for record in records.values()
    )


def _no_night(forecast: Sequence[NightForecast], n_nights: int) -> Iterator[str]:
    """The fault of a motor of which no night would be fitted."""
    if forecast and all(night.status != OK for night in forecast):
        reasons = dict.fromkeys(f"{night.status}: {night.reason}" for night in forecast)
        looked = "none" if len(forecast) == n_nights else f"none of {len(forecast)} looked into"
        why = "; ".join(list(reasons)[:2])
        yield f"no_night: of {counted(n_nights, 'night')} {looked} would be fitted ({why})"


def _cut(spec: MotorSpec, records: Mapping[str, FileRecord], logs: FolderLogs) -> Iterator[str]:
    """Text logs that end within a line."""
    if spec.file.logs.format != "csv":
        return
    for name, record in records.items():
        if record.status != "ok" or name.endswith(PACKED):
            continue
        with logs.path(name).open("rb") as stream:
            stream.seek(max(record.size - LINE_END_BYTES, 0))
            if not set(stream.read()) & set(b"\r\n"):
                yield f"{name}: the last line has no end: the log is cut, or being written"


# Channels


def _look_into(
    spec: MotorSpec, dated: Dated, path_of: Callable[[str], Path]
) -> tuple[tuple[ChannelCheck, ...], Sequence[str], Sequence[str]]:
    """Look into the newest log.

    Returned are its configured channels; faults, of a log that looks sound from outside and cannot
    be read, and of units; and notes, on what a night gives and on samples that do not look as
    configured.
    """
    label, newest = dated[-1]
    try:
        log = read_log(path_of(newest), spec.file.logs, spec.file.channels)
    except LogError as error:
        return (), [f"{error.code}: {error.message}"], []
    speed = log.channels["speed"]
    clean = clean_channel(speed, _rules(spec, "speed"))
    rests = Rests.of(clean, spec.settings.cleaning.standstill_rpm)
    checks = tuple(
        _channel_check(spec, name, log.channels[name], rests) for name in spec.file.channels
    )
    samples = night_of_log(spec, label, log)
    if samples and (changed := changed_readings(spec, dated, path_of, samples)):
        # What else is odd follows from it.
        return checks, [changed], []
    differing = differing_units(path_of(newest), spec.file)
    notes = [f"no sample of the night {label} is kept"]
    if samples:
        notes = [operation(spec, samples), *swapped(samples)]
    looks = (
        sampling_note(name, channel, log.channels[name])
        for name, channel in spec.file.channels.items()
        if channel.constant is None
    )
    faults = [
        *differing,
        *suspect_units(spec, label, log.channels),
        *repeated_extremes(spec, log.channels),
    ]
    # What is refused mostly follows from the rest.
    faults = faults or [*_refused(checks, log.channels["speed"].time_us)]
    unused = unused_qualities(path_of(newest), spec.file)
    leaps = jumps(log.channels["oil_temperature"])
    return checks, faults, [*notes, *filter(None, looks), *leaps, *unused]


def _refused(channels: Sequence[ChannelCheck], time_us: Times) -> Iterator[str]:
    """Yield faults of channels of which a rule refuses most samples."""
    for reason, how in HOW_TO_MEND.items():
        shares = {channel.channel: channel.refused_by.get(reason, 0.0) for channel in channels}
        if most := [name for name, share in shares.items() if share > MOST_REFUSED]:
            share = 100 * max(shares.values())
            if reason.endswith("_time"):
                how += f" (the first stamp is read as {utc(time_us[0]):%Y-%m-%d %H:%M:%S} UTC)"
            yield f"samples_refused: {share:.0f} % of {', '.join(most)} as {reason}: {how}"


def _rules(spec: MotorSpec, name: ChannelName) -> ChannelRules:
    channel = spec.file.channels[name]
    return ChannelRules.of(name, channel, spec.settings.cleaning, spec.file.logs)


def _channel_check(
    spec: MotorSpec, name: ChannelName, raw: RawChannel, rests: Rests
) -> ChannelCheck:
    channel = spec.file.channels[name]
    clean = clean_channel(raw, _rules(spec, name), rests=rests)
    n = max(clean.n_samples, 1)
    values = clean.value[~clean.refused]
    return ChannelCheck(
        channel=name,
        unit=channel.unit,
        n_samples=clean.n_samples,
        rate_hz=SECOND_US / clean.period_us if clean.period_us else None,
        median=float(np.median(values)) if len(values) else None,
        share_missing=clean.counts["missing"] / n,
        share_refused=clean.counts["any"] / n,
        refused_by={
            reason: count / n
            for reason, count in clean.counts.items()
            if count and reason not in ("any", "missing")
        },
    )

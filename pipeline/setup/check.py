"""`motor-leakage check`: the config, and a look at the logs, before a night depends on them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Any

from pipeline.clock import latest_us, microseconds, now
from pipeline.config import MotorSpec
from pipeline.config.nights import DAY, night, night_of
from pipeline.errors import LogError
from pipeline.ingest import RawChannel
from pipeline.logs.files import (
    change_of,
    dated_otherwise,
    dates_of_no_night,
    failed_record,
    labels_of,
    misdated_message,
    reaches_us,
    slice_night,
    stat_log,
    with_span,
    without_misdated,
)
from pipeline.logs.finding import FolderLogs, logs_of
from pipeline.logs.motor_logs import MotorLogs
from pipeline.logs.processed import FileRecord
from pipeline.messages import counted
from pipeline.night.column_change import (
    USUAL_NIGHTS,
    column_change,
    readings_of,
    refusal,
    usual_readings,
)
from pipeline.night.fit_night import clean_channels, fit_night
from pipeline.night.rows import explain_warm_up
from pipeline.night.sample_rows import strange_flow
from pipeline.night.time_base import Insufficient, Samples
from pipeline.schema import (
    DECIDING_NIGHTS,
    FAILED,
    LAG_COLUMNS,
    NO_NEW_DATA,
    OK,
    WITH_SAMPLES,
    agreed_lag,
)
from pipeline.setup.columns import (
    changed_readings,
    column_changes,
    differing_units,
    headers_of,
    suspect_units,
    unused_qualities,
)
from pipeline.setup.propose import LARGEST_LOG_BYTES
from pipeline.setup.samples import (
    ChannelCheck,
    channel_checks,
    cut_flow,
    ended_flow,
    misplaced,
    mostly_refused,
    operation,
    repeated_extremes,
    sampling_note,
    temperature_jumps,
    unread,
)
from pipeline.trends.decisions import Decision

# Objects of a motor that are opened: a check answers in seconds.
OPENED = 3
NO_LOG = "no log covers this night"
# A line end in UTF-16 or UTF-32 is up to four bytes long.
LINE_END_BYTES = 4
PACKED = (".gz", ".zst")


class Depth(Enum):
    """How far a check looks into a motor's logs."""

    ENDS = "ends"  # time stamps alone
    NEWEST = "newest"  # and the newest night, until any is fitted
    EVERY = "every"  # and every night


@dataclass(frozen=True, slots=True)
class NightForecast:
    """What a run would make of a night."""

    night: str
    status: str  # as in `nights`
    reason: str
    # As in `fits`: lag of its drain flow, and what it explains.
    drain_lag_s: float | None = None
    drain_lag_gain_percent: float | None = None


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
    spec: MotorSpec,
    stays: Collection[dt.date] = (),
    decisions: Sequence[Decision] = (),
    *,
    depth: Depth = Depth.NEWEST,
) -> MotorCheck:
    """Look at the ends of each of a motor's logs, and into some; nothing is written.

    Of logs in an object store, which have to be copied for it, the first and the last few by name.
    Where the newest night would not be fitted, the first and the middle are fitted, too; with
    `Depth.EVERY` all are, but for those that stay as published. `decisions` are the motor's.

    Raises StoreError if an object store cannot be read.
    """
    source = logs_of(spec)
    names = source.names
    if spec.log_url and len(names) > OPENED:
        # The first, and the last, which are the newest where names hold a date.
        names = (names[0], *names[1 - OPENED :])
    records = without_misdated({name: _by_its_ends(name, source, spec) for name in names})
    logs = MotorLogs(spec, {}, latest_us(), {}, records)
    nights = {label for record in records.values() for label in labels_of(record)}
    open_nights = sorted(nights.difference(stays))
    excluded, released = (
        {decision.night for decision in decisions if decision.kind == kind}
        for kind in ("excluded", "released")
    )
    looks: list[_NightLook] = []
    if depth is Depth.EVERY:
        looks = list(_every_look(spec, logs, stays, released))
    elif depth is Depth.NEWEST:
        looks = list(_few_looks(spec, logs, _small_nights(logs, open_nights)))
    forecast = tuple(
        NightForecast(str(look.label), look.status, look.reason, **look.lag) for look in looks
    )
    channels: tuple[ChannelCheck, ...] = ()
    unfit: Sequence[str] = ()
    worth: Sequence[str] = ()
    if depth is not Depth.ENDS:
        channels, unfit, worth = _look_into(spec, logs, looks, excluded | released)
    notes = [*worth, *_messages(logs.files, "growing"), *_lag_notes(spec, forecast)]
    if len(names) != len(source.names):
        notes.append(
            f"{len(names)} of {len(source.names)} objects were opened, the first and the last by "
            f"name below {spec.log_url}: nights and channels are theirs"
        )
    broken = {name for name in names if logs.files[name].status != records[name].status}
    read = {name: logs.files[name] for name in broken}
    lost = {key: words for look in reversed(looks) for key, words in look.lost.items()}
    faults = [*_file_faults(source, records), *_messages(read, "failed")]
    faults += [*lost.values(), *unfit]
    if not faults:
        # Of a plant's first day there is nothing to mend.
        unfitted = notes if _is_first_night(spec, records) else faults
        unfitted += _no_night(forecast, n_nights=len(open_nights))
    stated = (*spec.motor_type.path, *(spec.oils[name] for name in spec.file.oils))
    return MotorCheck(
        motor_id=spec.motor_id,
        motor_type=spec.file.motor_type,
        log_format=spec.file.logs.format,
        n_files=len(source.names),
        n_nights=len(nights),
        first=min(nights).isoformat() if nights else None,
        last=max(nights).isoformat() if nights else None,
        faults=tuple(faults),
        placeholders=tuple(entry.name for entry in stated if entry.source == "placeholder"),
        channels=channels,
        forecast=forecast,
        notes=(
            *notes,
            *_cut(spec, records, source),
            *source.unmatched(),
            *dates_of_no_night(spec, nights),
        ),
    )


def with_silent_nights(checks: Sequence[MotorCheck]) -> Iterator[MotorCheck]:
    """Yield checks with the nights of which a run says that a motor is silent and others are not.

    They are those up to the newest night of the fleet.
    """
    from pipeline.trends.checkpoint import blank_records
    from pipeline.trends.nights import NO_LOG as SILENT
    from pipeline.trends.nights import every_night

    read = [look for check in checks for look in check.forecast if look.status in WITH_SAMPLES]
    newest = max((dt.date.fromisoformat(look.night) for look in read), default=dt.date.min)
    for check in checks:
        looks = {dt.date.fromisoformat(look.night): look for look in check.forecast}
        known = blank_records(sorted(looks))
        known["known"] = True
        for label in every_night(known, newest)["night"].tolist():
            looks.setdefault(label, NightForecast(str(label), NO_NEW_DATA, SILENT))
        yield replace(check, forecast=tuple(looks[label] for label in sorted(looks)))


def _by_its_ends(name: str, source: FolderLogs, spec: MotorSpec) -> FileRecord:
    try:
        path = source.path(name)
    except LogError as error:  # replaced or removed since it was listed
        return failed_record(FileRecord(name, 0, 0, None), error)
    record = stat_log(name, path)
    if record.status == "failed":
        return record
    spanned_record, why = with_span(record, path, spec), change_of(record, path)
    return spanned_record if why is None else failed_record(spanned_record, why)


def _file_faults(source: FolderLogs, records: Mapping[str, FileRecord]) -> Iterator[str]:
    """Yield logs that cannot be read, are absent, or are of another date than they are named by."""
    yield from _messages(records, "failed")
    for name in source.absent:
        yield f"log_missing: {name}: named in the config and absent"
    if not source.names:
        yield f"no_logs: no log: {'; '.join(source.unmatched()) or 'logs.files names none'}"
    for name, days in dated_otherwise(records).items():
        yield f"log_misdated: {name}: {misdated_message(records[name], days)}"


def _messages(records: Mapping[str, FileRecord], status: str) -> list[str]:
    """Return what there is to say of the files of a status."""
    files = (record for record in records.values() if record.status == status)
    return [f"{record.error_code}: {record.message}" for record in files]


# Nights


@dataclass(frozen=True, slots=True)
class _NightLook:
    """A night by the rules of a run."""

    label: dt.date
    status: str
    reason: str
    row: Mapping[str, Any] = field(default_factory=dict)  # as of `nights`
    lag: Mapping[str, float | None] = field(default_factory=dict)  # as of `fits`
    samples: Samples | None = None  # that cleaning kept; None for none
    extremes: Mapping[str, str] = field(default_factory=dict)  # as `repeated_extremes`
    is_changed: bool = False  # whether it is refused for columns or units other than before
    cold: tuple[str, ...] = ()  # what its errors say of cold starts
    lost: Mapping[str, str] = field(default_factory=dict)  # as `unread` and `misplaced`


def _every_look(
    spec: MotorSpec, logs: MotorLogs, stays: Collection[dt.date], released: Collection[dt.date]
) -> Iterator[_NightLook]:
    """Yield all nights, in order of time; each is compared with those before it.

    Reading may show that a log covers other nights than its ends do.
    """
    looks: dict[dt.date, _NightLook] = {}
    while labels := sorted(logs.present() - logs.waiting() - looks.keys() - set(stays)):
        label = labels[0]
        since, _ = spec.file.alike(label)
        before = [day for day, look in looks.items() if day >= since and look.status == OK]
        look = _look_at_night(spec, logs, label)
        looks[label] = look if len(labels) == 1 else replace(look, samples=None)
        usual = usual_readings(looks[day].row for day in before[-USUAL_NIGHTS:])
        readings = readings_of(look.row) if label not in released else {}
        if not usual or not readings:
            continue
        if change := column_change(spec, usual, readings, is_fitted=look.status == OK):
            days, why = [label], refusal(change.words)
            if change.is_of_others:
                days = [day for day in before if day not in released]
                why = refusal(change.words, label)
            for day in days:
                looks[day] = replace(looks[day], status=FAILED, reason=why, is_changed=True)
    certain = {label for label, look in looks.items() if look.status != FAILED}
    for label in logs.holes(certain) - looks.keys() - set(stays):
        looks[label] = _NightLook(label, NO_NEW_DATA, NO_LOG)
    yield from (looks[label] for label in sorted(looks))


def _small_nights(logs: MotorLogs, labels: Iterable[dt.date]) -> list[dt.date]:
    """Return the newest, first and middle of the nights that are small."""
    small = _readable(logs, labels)
    return list(dict.fromkeys(small[at] for at in (-1, 0, len(small) // 2) if small))


def _readable(logs: MotorLogs, labels: Iterable[dt.date]) -> list[dt.date]:
    """Return nights whose logs are small enough to look into, in order of time."""
    sizes = {label: sum(logs.files[name].size for name in logs.of_night(label)) for label in labels}
    return sorted(label for label in sizes if sizes[label] <= LARGEST_LOG_BYTES)


def _few_looks(spec: MotorSpec, logs: MotorLogs, labels: Sequence[dt.date]) -> Iterator[_NightLook]:
    """Look into nights until any of them is fitted."""
    for label in labels:
        look = _look_at_night(spec, logs, label)
        yield look
        if look.status == OK:
            return


def _look_at_night(spec: MotorSpec, logs: MotorLogs, label: dt.date) -> _NightLook:
    channels = _channels_of(spec, logs, label)
    files = (logs.files[name] for name in logs.of_night(label))
    if broken := [record for record in files if record.status != "ok"]:
        return _NightLook(label, FAILED, broken[0].message or "")
    if not channels:
        return _NightLook(label, NO_NEW_DATA, NO_LOG)
    lost = {
        key: f"cells_unread: {name}: {words}"
        for name in logs.of_night(label)
        if (log := logs.content(name)) is not None
        for key, words in unread(log).items()
    } | misplaced(channels)
    extremes, fitted = repeated_extremes(spec, channels), list[Samples]()
    outcome = fit_night(spec, night(label, spec.settings.nights), channels, fitted.append)
    logs.let_go_until(label - DAY)
    mode = outcome.rows["fits"][0].get("flushing_mode")
    points = outcome.rows.get("predictions", [])
    predictions = [point for point in points if point["flushing_mode"] == mode]
    return _NightLook(
        label,
        outcome.status,
        outcome.reason or "",
        outcome.rows["nights"][0],
        {name: outcome.rows["fits"][0].get(name) for name in LAG_COLUMNS},
        next((samples for samples in fitted if len(samples.index)), None),
        extremes,
        cold=tuple(explain_warm_up(predictions)),
        lost=lost,
    )


def _channels_of(spec: MotorSpec, logs: MotorLogs, label: dt.date) -> dict[str, RawChannel]:
    """Return raw channels of a night; empty where no log covers it."""
    here = night(label, spec.settings.nights)
    contents = [logs.content(name) for name in (*logs.before_night(here), *logs.of_night(label))]
    read = [content for content in contents if content is not None]
    channels = slice_night(read, here, reaches_us(spec))
    is_covered = any((channel.time_us >= here.start_us).any() for channel in channels.values())
    return channels if is_covered else {}


def _samples_of(spec: MotorSpec, logs: MotorLogs, label: dt.date) -> Samples | None:
    """Return the samples of a night that cleaning keeps; None for none."""
    if channels := _channels_of(spec, logs, label):
        here = night(label, spec.settings.nights)
        with suppress(Insufficient):
            samples, _ = clean_channels(spec.file, spec.settings, here, channels)
            return samples if len(samples.index) else None
    return None


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
    """Return True where the motor has no night that is over: all logs are still being written."""
    current = night_of(microseconds(now()), spec.settings.nights)
    return all(
        record.status == "growing" or min(labels_of(record), default=current) >= current
        for record in records.values()
    )


def _no_night(forecast: Sequence[NightForecast], n_nights: int) -> Iterator[str]:
    """Yield the fault of a motor of which no night would be fitted."""
    read = [night for night in forecast if night.status != NO_NEW_DATA] or forecast
    if forecast and all(night.status != OK for night in forecast):
        reasons = dict.fromkeys(f"{night.status}: {night.reason}" for night in read)
        looked = "none" if len(read) >= n_nights else f"none of {len(read)} looked into"
        why = "; ".join(list(reasons)[:2])
        yield f"no_night: of {counted(n_nights, 'night')} {looked} would be fitted ({why})"


def _cut(spec: MotorSpec, records: Mapping[str, FileRecord], logs: FolderLogs) -> Iterator[str]:
    """Yield text logs that end within a line."""
    if spec.file.logs.format != "csv":
        return
    for name, record in records.items():
        if record.status != "ok" or name.endswith(PACKED):
            continue
        with logs.path(name).open("rb") as stream:
            stream.seek(max(record.size - LINE_END_BYTES, 0))
            if not set(stream.read()) & set(b"\r\n"):
                yield f"{name}: the last line has no end: the log is cut, or being written"


# The newest log


def _look_into(
    spec: MotorSpec, logs: MotorLogs, looks: Sequence[_NightLook], decided: Collection[dt.date]
) -> tuple[tuple[ChannelCheck, ...], Sequence[str], Sequence[str]]:
    """Look into the newest log that is small.

    Returned are its configured channels; faults, of logs that look sound from outside and cannot be
    read, and of columns and units; and notes, on what a night gives and on samples that do not look
    as configured.
    """
    dated, header = logs.in_time(), headers_of(spec, logs.path)
    changes = list(column_changes(spec, dated, header))
    small = [place for place in dated if logs.files[place[1]].size <= LARGEST_LOG_BYTES]
    if not small:
        return (), changes, []
    label, newest = small[-1]
    log = logs.content(newest)
    if log is None:  # which is a fault of its own
        return (), changes, []
    checks = channel_checks(spec, log.channels)
    look = next((look for look in looks if look.label == label), None)
    samples = None if look is None else look.samples
    faults = [*_changed_nights(spec, logs, looks, decided)]
    if faults:
        # What else is odd follows from it.
        return checks, [*changes, *faults], []
    notes = [operation(spec, label, samples), *strange_flow(samples)] if samples else []
    notes += [f"in the night {label}, {words}" for words in look.cold] if look else []
    if look and not samples and look.status != OK:
        notes = [f"no sample of the night {label} is kept"]
    for name, channel in spec.file.channels.items():
        if channel.constant is None and not (look and name in look.lost):
            notes += sampling_note(name, channel, log.channels[name])
    faults = [
        *changes,
        *differing_units(spec.file, header(newest)),
        *suspect_units(spec, label, log.channels),
        *cut_flow(spec, log.channels),
        *_extremes(spec, logs, looks),
    ]
    notes += ended_flow(spec, log.channels)
    notes += temperature_jumps(log.channels["oil_temperature"])
    notes += unused_qualities(logs.path(newest), header(newest), spec.file)
    # What is refused mostly follows from the rest.
    return checks, faults or [*mostly_refused(checks)], notes


def _changed_nights(
    spec: MotorSpec, logs: MotorLogs, looks: Sequence[_NightLook], decided: Collection[dt.date]
) -> Iterator[str]:
    """Yield the nights of other columns or units than before, but for those that people decided."""
    changed = [look for look in looks if look.is_changed and look.label not in decided]
    newest = max(looks, key=lambda look: look.label, default=None)
    if changed:
        nights = f"{counted(len(changed), 'night')}, {changed[0].label} to {changed[-1].label}"
        yield f"columns_changed: {nights}, would be refused: {changed[0].reason}"
    elif newest and newest.samples and newest.label not in decided:
        labels, samples_of = _readable(logs, logs.present()), partial(_samples_of, spec, logs)
        if change := changed_readings(spec, labels, samples_of, newest.samples):
            label, why = change
            name = logs.of_night(label)[0]
            yield f"columns_changed: from the night {label} ({name}) on: {why}"


def _extremes(spec: MotorSpec, logs: MotorLogs, looks: Sequence[_NightLook]) -> Iterator[str]:
    """Yield extreme values that are no readings, each with the first night that has it."""
    by_night = {look.label: look.extremes for look in looks}
    for label in _small_nights(logs, logs.present()):
        if label not in by_night and (channels := _channels_of(spec, logs, label)):
            by_night[label] = repeated_extremes(spec, channels)
    first = dict[str, str]()
    for label, extremes in sorted(by_night.items()):
        for extreme, words in extremes.items():
            first.setdefault(extreme, f"extreme_repeated: {extreme} {words} (night {label})")
    yield from first.values()

"""Channels of a motor in one log: rate, shares missing or refused, units, look of the sampling.

Samples that a clock writes lie evenly; those sent on change, or left by a historian's compression,
leave silences: which of the two it was makes no difference to the config. A running total rises.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import SECOND_US, Array
from pipeline.config import Channel, MotorSpec
from pipeline.config.channels import COUNTED, ChannelName
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.files import labels_of
from pipeline.logs.processed import FileRecord
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.setup.check_units import suspect_units, units_told
from pipeline.setup.column_changes import changed_readings
from pipeline.setup.observe import LARGEST_LOG_BYTES
from pipeline.setup.promise import night_of_log, promise, swapped

# Samples of the head of a log that are looked at, and fewest that tell anything.
HEAD, FEWEST = 20_000, 30
# Larger figures are no readings, and their squares no numbers.
LARGEST = 1e100
# A step is a silence beyond so many of the shortest tenth of steps; a log is irregular where
# silences are so frequent, and take up so much of the time.
SILENCE_STEPS, SILENT_STEPS_SHARE, SILENT_TIME_SHARE = 3.5, 0.02, 0.2
# A running total may be reset or roll over so often; below, it rises all the time.
FALLS_SHARE, FEWEST_RISES = 0.005, 20


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


def check_channels(
    spec: MotorSpec, records: Mapping[str, FileRecord], path_of: Callable[[str], Path]
) -> tuple[tuple[ChannelCheck, ...], tuple[str, ...], tuple[str, ...]]:
    """Look into the newest log of a motor that can be read and is not too large.

    Returned are its configured channels, none where there is no such log; faults, of a log that
    looks sound from outside and cannot be read, and of units; and notes, on what a night gives and
    on samples that do not look as configured.
    """
    readable = [
        name
        for name, record in records.items()
        if record.status == "ok" and record.nights and record.size <= LARGEST_LOG_BYTES
    ]
    if not readable:
        return (), (), ()
    newest = max(readable, key=lambda name: (max(labels_of(records[name])), name))
    try:
        log = read_log(path_of(newest), spec.file.logs, spec.file.channels)
    except LogError as error:
        return (), (f"{error.code}: {error.message}",), ()
    label = max(labels_of(records[newest]))
    found = tuple(_looked_at(spec, name, log.channels[name]) for name in spec.file.channels)
    kept = night_of_log(spec, label, log)
    readings = {name: records[name] for name in readable}
    if kept and (changed := changed_readings(spec, readings, path_of, kept)):
        # What else is odd follows from it.
        return found, (changed,), ()
    told = units_told(path_of(newest), spec.file)
    suspects = suspect_units(spec, label, log.channels)
    faults = [
        fault
        for name in spec.file.channels
        for fault in (told.get(name), suspects.get(name))
        if fault
    ]
    notes = [f"no sample of the night {label} is kept"]
    if kept:
        notes = [promise(spec, label, kept), *swapped(kept)]
    looks = (
        sampling_note(name, channel, log.channels[name])
        for name, channel in spec.file.channels.items()
        if channel.constant is None
    )
    return found, tuple(faults), (*notes, *filter(None, looks))


def _looked_at(spec: MotorSpec, name: ChannelName, raw: RawChannel) -> ChannelCheck:
    channel = spec.file.channels[name]
    clean = clean_channel(
        raw, ChannelRules.of(name, channel, spec.settings.cleaning, spec.file.logs)
    )
    n = max(clean.n_samples, 1)
    kept = clean.value[~clean.refused]
    return ChannelCheck(
        channel=name,
        unit=channel.unit,
        n_samples=clean.n_samples,
        rate_hz=SECOND_US / clean.period_us if clean.period_us else None,
        median=float(np.median(kept)) if len(kept) else None,
        share_missing=clean.counts["missing"] / n,
        share_refused=clean.counts["any"] / n,
        refused_by={
            reason: count / n
            for reason, count in clean.counts.items()
            if count and reason not in ("any", "missing")
        },
    )


def sampling_note(name: str, channel: Channel, raw: RawChannel) -> str:
    """Where a channel's samples do not look as it is configured, and what to set; else empty."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    value, steps = raw.value[rows][first], np.diff(time_us) / 1e6
    if value.size < FEWEST or not np.ptp(value):
        return ""
    if name == COUNTED and _rises(value) != (channel.counts == "cumulative"):
        if channel.counts == "cumulative":
            return f"{name}: configured as a running total, and falls again and again"
        keys = 'counts = "cumulative", unit = "count" and volume_per_count_cm3'
        return f"{name}: looks like a running total: then {keys}"
    # Silences are frequent and take up much of the time: a clock did not write these samples.
    silent = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    in_silence = steps[silent].sum() / steps.sum()
    is_irregular = silent.mean() >= SILENT_STEPS_SHARE and in_silence >= SILENT_TIME_SHARE
    if not is_irregular or channel.sampling == "on_change" or channel.counts is not None:
        return ""
    # Without the longest hundredth.
    reach = float(np.quantile(steps, 0.99, method="higher"))
    return (
        f"{name}: looks sent on change, compressed, or lost in part: then sampling = "
        f'"on_change" and longest_silence_s; silences here reach {reach:.3g} s'
    )


def _rises(value: Array) -> bool:
    """True if values only rise, resets and roll-overs apart."""
    changes = np.diff(value)
    falls = changes < 0
    if int(np.sum(changes > 0)) < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    return bool(np.all(-changes[falls] > 0.3 * np.ptp(value)))

"""Channels of a motor in one log: rate, sampling by its look, shares missing or refused, units.

Samples that a clock writes lie evenly; those sent on change, or left by a historian's compression,
leave silences: which of the two it was makes no difference to the config. A running total rises.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.arrays import SECOND_US, Array
from pipeline.config import Channel, MotorSpec
from pipeline.config.channels import COUNTED
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.setup.check_units import suspect_units, units_told
from pipeline.setup.column_changes import changed_readings
from pipeline.setup.observe import LARGEST_LOG_BYTES
from pipeline.setup.promise import promise, swapped

# Samples of the head of a log that are looked at, and fewest that tell anything.
HEAD, FEWEST = 20_000, 30
# Larger figures are no readings, and their squares no numbers.
LARGEST = 1e100
# A step is a silence beyond so many of the shortest tenth of steps; a log is irregular where
# silences are so frequent, and take up so much of the time.
SILENCE_STEPS, SILENT_STEPS_SHARE, SILENT_TIME_SHARE = 3.5, 0.02, 0.2
# A running total may be reset or roll over so often; below, it rises all the time.
FALLS_SHARE, FEWEST_RISES = 0.005, 20
# Means of shorter periods cost no accuracy.
SHORTEST_MEAN_S = 4.0
# How far the period of means may be from the one stated, and how often a sample sent on change may
# repeat the one before, as where some are sent after a longest silence.
PERIOD_TOLERANCE, REPEATED_SHARE = 0.2, 0.1


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
    configured: str  # its sampling, in words
    looks: str  # its sampling by its looks, in words; empty where nothing can be told
    remarks: tuple[str, ...]  # where its sampling does not look as configured
    unit_faults: tuple[str, ...]  # where its unit is not the header's, or its size is unusual


def check_channels(
    spec: MotorSpec, records: Mapping[str, FileRecord], path_of: Callable[[str], Path]
) -> tuple[tuple[ChannelCheck, ...], tuple[str, ...], tuple[str, ...]]:
    """Look into the newest log of a motor that can be read and is not too large.

    Returned are its configured channels, none where there is no such log, and faults: of a log that
    looks sound from outside and cannot be read, and of units; and notes on what a night gives.
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
    nights = labels_of(records[newest])
    suspects = suspect_units(spec, max(nights), log.channels)
    told = units_told(path_of(newest), spec.file)
    found = tuple(
        _looked_at(spec, name, log.channels[name], (told.get(name), suspects.get(name)))
        for name in spec.file.channels
    )
    faults = [fault for one in found for fault in one.unit_faults]
    readings = {name: records[name] for name in readable}
    if changed := changed_readings(spec, readings, path_of, log.channels):
        # What else is odd follows from it.
        return found, (changed,), ()
    notes = (promise(spec, max(nights), log.channels, len(nights)), *swapped(spec, log.channels))
    return found, tuple(faults), notes


def _looked_at(
    spec: MotorSpec, name: str, raw: RawChannel, unit_faults: tuple[str | None, ...]
) -> ChannelCheck:
    channel = {str(key): one for key, one in spec.file.channels.items()}[name]
    look = look_of(raw, is_flow=name == COUNTED)
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
        configured=configured(channel),
        looks=words(look),
        remarks=tuple(filter(None, [remark(channel, look)])),
        unit_faults=tuple(filter(None, unit_faults)),
    )


# The look of a channel's sampling


@dataclass(frozen=True, slots=True)
class Sampling:
    """The look of a channel."""

    kind: Literal["periodic", "irregular", "cumulative", "unknown"]
    period_s: float | None = None  # typical distance of two samples; None for fewer than two
    longest_silence_s: float | None = None  # but for the longest hundredth
    share_repeated: float = 0.0  # of the samples, those that repeat the one before


def look_of(raw: RawChannel, *, is_flow: bool = False) -> Sampling:
    """Tell the sampling of a channel from the head of its log; only a flow can be a total."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    value, steps = raw.value[rows][first], np.diff(time_us) / 1e6
    period = float(np.median(steps)) if steps.size else None
    if value.size < FEWEST or not np.ptp(value):
        return Sampling("unknown", period)
    # Silences are frequent and take up much of the time: a clock did not write these samples.
    silent = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    in_silence = steps[silent].sum() / steps.sum()
    is_irregular = silent.mean() >= SILENT_STEPS_SHARE and in_silence >= SILENT_TIME_SHARE
    return Sampling(
        "cumulative" if is_flow and _rises(value) else "irregular" if is_irregular else "periodic",
        period,
        float(np.quantile(steps, 0.99, method="higher")),
        float(np.mean(np.diff(value) == 0)),
    )


def _rises(value: Array) -> bool:
    """True if values only rise, resets and roll-overs apart."""
    changes = np.diff(value)
    falls = changes < 0
    if int(np.sum(changes > 0)) < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    return bool(np.all(-changes[falls] > 0.3 * np.ptp(value)))


def words(look: Sampling) -> str:
    """The look in words; empty where nothing can be told."""
    if look.kind == "periodic" and (look.period_s or 0.0) >= SHORTEST_MEAN_S:
        return f"periodic, or means of {look.period_s:.3g} s"
    return {
        "periodic": "periodic",
        "irregular": "sent on change, compressed, or lost in part",
        "cumulative": "like a running total",
        "unknown": "",
    }[look.kind]


def configured(channel: Channel) -> str:
    """A channel's sampling as configured, in words."""
    if channel.counts is not None:
        total = channel.counts == "cumulative"
        return "a running total" if total else "counts since the sample before"
    if channel.sampling == "mean":
        return f"means of {channel.mean_of_s:g} s"
    return "periodic" if channel.sampling == "periodic" else "sent on change or compressed"


def remark(channel: Channel, look: Sampling) -> str:
    """The difference between a channel's look and its config, in words; empty for none."""
    if _agrees(channel, look):
        return ""
    if channel.counts == "cumulative":
        advice = "it falls again and again"
    elif look.kind == "cumulative":
        advice = 'then counts = "cumulative", unit = "count" and volume_per_count_cm3'
    elif look.kind == "periodic":
        advice = (
            f"a sample every {look.period_s:.3g} s, {100 * look.share_repeated:.0f} % of them as "
            'the one before; then sampling = "periodic"'
        )
    else:
        advice = (
            'then sampling = "on_change" and longest_silence_s; silences here reach '
            f"{look.longest_silence_s:.3g} s"
        )
    return f"configured as {configured(channel)}, looks {words(look)}: {advice}"


def _agrees(channel: Channel, look: Sampling) -> bool:
    if look.kind == "unknown":
        return True
    if channel.counts is not None or look.kind == "cumulative":
        return (look.kind == "cumulative") == (channel.counts == "cumulative")
    if channel.sampling == "on_change":
        return look.kind == "irregular" or look.share_repeated <= REPEATED_SHARE
    off = 0.0
    if channel.sampling == "mean":
        off = abs((look.period_s or 0.0) / (channel.mean_of_s or 1.0) - 1.0)
    return look.kind == "periodic" and off < PERIOD_TOLERANCE

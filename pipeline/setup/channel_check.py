"""Channels of a motor in one log: rate, sampling, shares that are missing or refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import SECOND_US
from pipeline.config import Channel, MotorSpec
from pipeline.config.channels import COUNTED
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import clean_channel
from pipeline.setup.check_units import suspect_units, units_told
from pipeline.setup.observe import LARGEST_LOG_BYTES
from pipeline.setup.promise import promise
from pipeline.setup.sampling import configured, look_of, remark, words
from pipeline.setup.swapped import swapped


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
        _looked_at(spec, name, channel, log.channels[name], (told.get(name), suspects.get(name)))
        for name, channel in spec.file.channels.items()
    )
    faults = [fault for one in found for fault in one.unit_faults]
    notes = (promise(spec, max(nights), log.channels, len(nights)), *swapped(spec, log.channels))
    return found, tuple(faults), notes


def _looked_at(
    spec: MotorSpec,
    name: str,
    channel: Channel,
    raw: RawChannel,
    unit_faults: tuple[str | None, ...],
) -> ChannelCheck:
    look = look_of(raw, is_flow=name == COUNTED)
    rules = ChannelRules.of(name, channel, spec.settings.cleaning, spec.file.logs)
    clean = clean_channel(raw, rules)
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

"""What a motor's channels look like in one log: rate, what is missing or refused, suspect units."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leakage import LeakageError, OperatingConditions, total_flow_l_per_min
from pipeline.arrays import SECOND_US
from pipeline.channel_rules import ChannelRules
from pipeline.clean import clean_channel
from pipeline.config import Channel, MotorSpec
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.ledger import FileRecord
from pipeline.logs import labels_of
from pipeline.units import QUANTITIES, UNITS, canonical_unit, from_canonical, to_canonical

# Larger logs are not read for a look: a check answers in seconds.
LARGEST_LOG_BYTES = 200 << 20
# Upper quartile of the magnitude that a motor at work shows, in the units of the tables.
Usual = Mapping[str, tuple[float, float]]
USUAL: Usual = {
    "pressure": (5.0, 450.0),
    "temperature": (5.0, 95.0),
    "speed": (0.5, 400.0),
}
# A drain flow this many times off the configured model's is of another unit sooner than worn.
UNUSUAL_FLOW = 8.0
# Pressures that say nothing of the load.
LOW_SIDE = ("low_port_pressure", "charge_pressure", "case_pressure")


@dataclass(frozen=True, slots=True)
class ChannelCheck:
    """A channel in one log.

    Attributes
    ----------
    channel, unit
        Name, and unit as configured.
    n_samples
        Samples, missing ones included.
    rate_hz
        Typical rate; None for fewer than two samples.
    median
        Median of what was kept, in the unit of the tables; None where nothing was.
    share_missing, share_refused
        Of the samples; refused by any rule, missing ones included.
    refused_by
        Share by rule, of those that refused any.
    suspicion
        What looks wrong, in words; empty where nothing does.
    """

    channel: str
    unit: str
    n_samples: int
    rate_hz: float | None
    median: float | None
    share_missing: float
    share_refused: float
    refused_by: Mapping[str, float]
    suspicion: str


def check_channels(
    spec: MotorSpec, records: Mapping[str, FileRecord], paths: Mapping[str, Path]
) -> tuple[tuple[ChannelCheck, ...], tuple[str, ...]]:
    """Look into the newest log of a motor that can be read and is not too large.

    Parameters
    ----------
    spec
        The motor.
    records, paths
        What is known of its logs, and where they lie, by name.

    Returns
    -------
    tuple of ChannelCheck, tuple of str
        One a configured channel, empty where there is no such log; and the fault, where the log
        looks sound from outside and cannot be read.
    """
    readable = [
        name
        for name, record in records.items()
        if record.status == "ok" and record.nights and record.size <= LARGEST_LOG_BYTES
    ]
    if not readable:
        return (), ()
    newest = max(readable, key=lambda name: (max(labels_of(records[name])), name))
    try:
        log = read_log(paths[newest], spec.file.log_source())
    except LogError as error:
        return (), (f"{error.code}: {error.message}",)
    usual = _usual(spec, max(labels_of(records[newest])), log.channels)
    found = tuple(
        replace(
            _looked_at(spec, name, channel, log.channels[name]),
            suspicion=""
            if channel.counts
            else _suspicion(name, channel.unit, log.channels[name], usual),
        )
        for name, channel in spec.file.channels.items()
    )
    return found, ()


def _looked_at(spec: MotorSpec, name: str, channel: Channel, raw: RawChannel) -> ChannelCheck:
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
        suspicion="",
    )


def _typical(raw: RawChannel) -> float | None:
    """Upper quartile of all numbers' magnitudes, those out of range too: they tell the unit."""
    numbers = np.abs(raw.value[np.isfinite(raw.value)])
    return float(np.percentile(numbers, 75)) if len(numbers) else None


def _usual(spec: MotorSpec, night: dt.date, channels: Mapping[str, RawChannel]) -> Usual:
    """Limits of what each quantity shows at work; for the flow from the configured model."""
    pressure = "pressure_difference" if "pressure_difference" in channels else "high_port_pressure"
    typical = [_typical(channels[name]) for name in (pressure, "oil_temperature", "speed")]
    known = [value for value in typical if value is not None]
    if len(known) < len(typical):
        return USUAL
    try:
        motor = spec.motor(night, spec.file.flushing.mode)
        flow = float(total_flow_l_per_min(motor, OperatingConditions.from_bar(*known))[0])
    except LeakageError:
        return USUAL
    return {**USUAL, "flow": (flow / UNUSUAL_FLOW, flow * UNUSUAL_FLOW)}


def _suspicion(name: str, unit: str, raw: RawChannel, usual: Usual) -> str:
    """What looks wrong with a channel's magnitude, and which unit would mend it."""
    typical, limits = _typical(raw), usual.get(QUANTITIES[name])
    if typical is None or limits is None or name in LOW_SIDE or limits[0] <= typical <= limits[1]:
        return ""
    logged = float(from_canonical(name, typical, unit))
    fitting = [
        other
        for other in UNITS[QUANTITIES[name]]
        if limits[0] <= abs(float(to_canonical(name, logged, other))) <= limits[1]
    ]
    what = f"typically {typical:.3g} {canonical_unit(name)}, which is unusual"
    if not fitting:
        return what
    return f"{what}; it would be usual if the log's unit were {' or '.join(fitting[:2])}"

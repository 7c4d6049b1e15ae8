"""What `check` says of a log's samples: sampling, values that are no readings, what a night gives.

Samples that are sent on change, or left by a historian's compression, leave silences; `init` writes
the keys of such a channel.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.arrays import SECOND_US, Array, Mask, Times
from pipeline.clock import utc
from pipeline.config import Channel, MotorSpec
from pipeline.config.channels import COUNTED, TOTAL
from pipeline.ingest import RawChannel, RawLog
from pipeline.ingest.cells import may_be_number
from pipeline.messages import counted
from pipeline.night.cleaning import (
    STANDSTILL_RPM,
    ChannelRules,
    CleanChannel,
    Rests,
    clean_channel,
)
from pipeline.night.fit_night import MINIMUM_TRAINING_MINUTES
from pipeline.night.masks import near
from pipeline.night.time_base import GUARD_AFTER_US, GUARD_BEFORE_US, Samples
from pipeline.night.time_order import order_of
from pipeline.units import FALLBACK_VALID_RANGE

# Samples of the head of a log that are looked at, and fewest that tell anything.
HEAD, FEWEST = 20_000, 30
# Larger figures are no readings, and their squares no numbers.
LARGEST = 1e100
# A step is a silence beyond so many of the shortest tenth of steps; a log is irregular where
# silences are so frequent, and take up so much of the time.
SILENCE_STEPS, SILENT_STEPS_SHARE, SILENT_TIME_SHARE = 3.5, 0.02, 0.2
# Silences that are proposed [s]: the first that covers this share of the time.
SILENCES_S, COVERED_TIME_SHARE = (10, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200), 0.99
# Of values that are sent when they changed by a step, the smallest changes are near the typical.
STEP_SHARE = 0.5
# A running total may be reset or roll over so often; below, it rises all the time.
FALLS_SHARE, FEWEST_RISES = 0.005, 20
# An extreme value is none of a measurement where it comes in so many stretches of the log, and
# lies so many times the spread of the others beyond them.
FEWEST_STRETCHES, BEYOND_SPREADS, SPREAD = 3, 1.5, (0.02, 0.98)
# Oil does not change by so much between neighbouring samples that are so near; where the samples
# around them do not differ as much it is a single spike, which is refused.
JUMP_C, NEIGHBOURS_S, FEWEST_JUMPS = 5.0, 10.0, 3
# Nor does it change by so much in so large a share of its samples.
RESTLESS_C, RESTLESS_SHARE = 2.0, 0.02
# A rule that refuses more of a channel's samples than this has no log of single faults before it;
# of a small flow, noise alone is below 0 for a part of the time.
MOST_REFUSED, MOST_OUT_OF_RANGE = 0.5, 0.1
# A clock that is set back an hour in a short log is an event, and no form of the log.
MOST_MISPLACED = {"duplicate_time": 0.1, "backward_time": 0.4}
# What cannot be read is rarely lost at random: it is the largest readings, a direction, the hours
# after a change of the logger.
MOST_UNREAD = 0.01
# A meter's end, or a limit of the config: of more readings than this beyond it the leakage suffers.
# A reading is an end where it comes so many times more often than the next, of so many others.
MOST_CUT, TIMES_MORE, FEWEST_LEVELS = 0.03, 4.0, 10
DAY_US, LONGEST_STEP_US = 86_400 * SECOND_US, 60 * SECOND_US
HOW_TO_MEND = {
    "duplicate_time": "do its stamps lack seconds, or fractions of them, are they of another "
    "column than logs.time should have, or are its rows of several motors? Correct "
    "logs.time_format, logs.time or logs.motor_rows",
    "backward_time": "is its time written in another form, or zone, or do several logs cover it? "
    "Correct logs.time_format, or have a log a night written in order",
    "out_of_range": "is its unit, or valid_range, another, or a negative number written as one "
    "without a sign?",
    "bad_quality": "are other codes good? Correct quality_good",
    "not_finite": "correct the column, or logs.missing_tokens",
}
# Simulated nights of benchmarks/results/coverage.md, loads of 15 to 90 s: the range of each input,
# 5th to 95th percentile. Of those of 30 minutes and more 92 to 100 % estimated every path.
RANGES = {"pressure": (260.0, "bar"), "speed": (96.0, "rpm"), "oil temperature": (12.0, "°C")}


# What cannot be read


def unread(log: RawLog) -> dict[str, str]:
    """Return what of a log is left out, if it is more than a trace: by channel, or "rows"."""
    words = {}
    for name, raw in log.channels.items():
        marked = 0 if raw.bad_quality is None else np.count_nonzero(raw.bad_quality & raw.missing)
        is_number = may_be_number(raw.example or "")
        if is_number and raw.unparsed - marked > MOST_UNREAD * len(raw.missing):
            words[name] = (
                f"{counted(raw.unparsed, 'cell')} of {name} without a number{raw.such_as}: set "
                "decimal, thousands or missing_tokens of [logs], or have them written as numbers"
            )
    for raw in log.channels.values():
        # The step over midnight, a day short.
        steps = np.diff(raw.time_us) + DAY_US
        if len(falls := np.flatnonzero((steps > 0) & (steps <= LONGEST_STEP_US))):
            words["date"] = (
                f"its stamps fall back by a day behind {utc(raw.time_us[falls[0]]):%Y-%m-%d %H:%M} "
                "UTC: have the date of each row written, not that of the log's begin"
            )
    # A row alone may be that which is being written.
    if log.left_out > max(MOST_UNREAD * (log.rows + log.left_out), 1):
        words["rows"] = f"rows are left out, which an analysis lacks: {'; '.join(log.notes)}"
    return words


# What the rules of cleaning refuse


@dataclass(frozen=True, slots=True)
class ChannelCheck:
    """A channel in a log."""

    channel: str
    unit: str  # as configured
    n_samples: int  # missing ones included
    rate_hz: float | None  # typical; None for fewer than two samples
    median: float | None  # of what was kept, in the unit of the tables; None where nothing was
    share_missing: float
    share_refused: float  # by any rule, missing ones included
    refused_by: Mapping[str, float]  # share by rule, of those that refused any


def channel_checks(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> tuple[ChannelCheck, ...]:
    """Return the configured channels of a log."""
    rules = {
        name: ChannelRules.of(name, channel, spec.file.logs)
        for name, channel in spec.file.channels.items()
    }
    speed = clean_channel(channels["speed"], rules["speed"])
    rests = Rests.of(speed)
    return tuple(
        _channel_check(name, channel.unit, clean_channel(channels[name], rules[name], rests=rests))
        for name, channel in spec.file.channels.items()
    )


def _channel_check(name: str, unit: str, clean: CleanChannel) -> ChannelCheck:
    n = max(clean.n_samples, 1)
    values = clean.value[~clean.refused]
    return ChannelCheck(
        channel=name,
        unit=unit,
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


def mostly_refused(channels: Sequence[ChannelCheck]) -> Iterator[str]:
    """Yield faults of channels of which a rule refuses many samples."""
    for reason in ("out_of_range", "bad_quality", "not_finite"):
        shares = {channel.channel: channel.refused_by.get(reason, 0.0) for channel in channels}
        limits = dict.fromkeys(shares, MOST_REFUSED)
        if reason == "out_of_range":
            limits = {**dict.fromkeys(shares, MOST_OUT_OF_RANGE), COUNTED: MOST_REFUSED}
        if most := {name: share for name, share in shares.items() if share > limits[name]}:
            yield _refused(max(most.values()), list(most), reason)


def misplaced(channels: Mapping[str, RawChannel]) -> dict[str, str]:
    """Return faults of a night many of whose stamps go back, or are another reading's, too."""
    shares = {reason: dict[str, float]() for reason in MOST_MISPLACED}
    for name, raw in channels.items():
        rows = np.flatnonzero(~raw.missing)
        time_us, value = raw.time_us[rows], raw.value[rows]
        order, n = order_of(time_us), max(len(rows), 1)
        if len(order.repeated):
            first = np.arange(n)[order.rows][
                np.searchsorted(order.time_us, time_us[order.repeated])
            ]
            differs = value[first] != value[order.repeated]
            shares["duplicate_time"][name] = np.count_nonzero(differs) / n
        shares["backward_time"][name] = len(order.backward) / n
    faults = dict[str, str]()
    for reason, by_name in shares.items():
        if most := [name for name, share in by_name.items() if share > MOST_MISPLACED[reason]]:
            time_us = channels[most[0]].time_us
            is_turned = reason == "backward_time" and np.mean(np.diff(time_us) < 0) > 0.5
            how = "its rows are newest first: have them written oldest first" if is_turned else ""
            read = f" (the first stamp is read as {utc(time_us[0]):%Y-%m-%d %H:%M:%S} UTC)"
            faults[reason] = _refused(max(by_name.values()), most, reason, how) + read
    return faults


def _refused(share: float, names: Sequence[str], reason: str, how: str = "") -> str:
    how = how or HOW_TO_MEND[reason]
    return f"samples_refused: {100 * share:.0f} % of {', '.join(names)} as {reason}: {how}"


# Sampling


def silence_keys(raw: RawChannel, every_us: Times) -> dict[str, Any]:
    """Return the keys of a channel that is sent on change or compressed; empty for any other.

    Silences in which no channel has a row, of stamps `every_us` in order, are the logger's own.
    """
    time_us, value = _head(raw)
    if value.size < FEWEST or not np.ptp(value):
        return {}
    begins = np.searchsorted(every_us, time_us[:-1], "right")
    is_alone = np.searchsorted(every_us, time_us[1:]) == begins
    steps = np.diff(time_us) / 1e6
    is_short = steps <= SILENCE_STEPS * np.quantile(steps, 0.1)
    steps = steps[~is_alone | is_short]
    if not _is_irregular(steps):
        return {}
    ordered = np.sort(steps)
    needed_s = ordered[np.searchsorted(np.cumsum(ordered), COVERED_TIME_SHARE * ordered.sum())]
    silence_s = next((seconds for seconds in SILENCES_S if seconds >= needed_s), SILENCES_S[-1])
    changes = np.abs(np.diff(value))
    smallest, typical = np.quantile(changes[changes > 0], (0.05, 0.5))
    held = {"between": "hold"} if smallest > STEP_SHARE * typical else {}
    return {"sampling": "on_change", "longest_silence_s": float(silence_s), **held}


def sampling_note(name: str, channel: Channel, raw: RawChannel) -> Iterator[str]:
    """Yield where a channel's samples do not look as configured, and what to set."""
    time_us, value = _head(raw)
    if value.size < FEWEST or not np.ptp(value):
        return
    steps = np.diff(time_us) / 1e6
    if name == COUNTED and _rises(value) != (channel.unit == TOTAL):
        if channel.unit == TOTAL:
            yield f"{name}: configured as a running total, and falls again and again"
        else:
            keys = f'unit = "{TOTAL}" and volume_per_count_cm3'
            yield f"{name}: looks like a running total: then {keys}"
    elif _is_irregular(steps) and not channel.is_on_change and not channel.is_counted:
        # Without the longest hundredth.
        reach = float(np.quantile(steps, 0.99, method="higher"))
        yield (
            f"{name}: looks sent on change, compressed, or lost in part: then sampling = "
            f'"on_change" and longest_silence_s; silences here reach {reach:.3g} s'
        )


def _head(raw: RawChannel) -> tuple[Times, Array]:
    """Return stamps and values of the first readings."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    return time_us, raw.value[rows][first]


def _is_irregular(steps: Array) -> bool:
    """Return True if silences are frequent and long: no clock wrote these samples."""
    if not len(steps):
        return False
    silent = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    is_frequent = float(silent.mean()) >= SILENT_STEPS_SHARE
    return is_frequent and float(steps[silent].sum() / steps.sum()) >= SILENT_TIME_SHARE


def _rises(value: Array) -> bool:
    """Return True if values only rise, resets and roll-overs apart."""
    changes = np.diff(value)
    falls = changes < 0
    if int(np.sum(changes > 0)) < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    return bool(np.all(-changes[falls] > 0.3 * np.ptp(value)))


# Values that are no readings, and readings that are missing


def cut_flow(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> Iterator[str]:
    """Yield the fault of a drain flow whose largest readings are refused while the motor works.

    What is left is too small: samples are left out by the very figure that is estimated.
    """
    channel, value = spec.file.channels[COUNTED], _flow_at_work(spec, channels)
    _, high = channel.valid_range or FALLBACK_VALID_RANGE[COUNTED]
    if channel.sensor_maximum is not None:
        high = min(high, channel.sensor_maximum - channel.resolution)
    if (n_cut := np.count_nonzero(value > high)) > MOST_CUT * len(value):
        yield (
            f"samples_refused: {100 * n_cut / len(value):.0f} % of {COUNTED} at work lie beyond "
            f"{high:g} l/min: the leakage comes out too small; correct valid_range or "
            "sensor_maximum, or the meter is too small"
        )


def ended_flow(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> Iterator[str]:
    """Yield the ends of a drain flow at which its readings stand, as no flow does."""
    value = _flow_at_work(spec, channels)
    levels, counts = np.unique(value, return_counts=True)
    if len(levels) <= FEWEST_LEVELS:
        return
    # Whatever is without load reads 0, too: with a low cut-off nothing lies just above it.
    is_apart = levels[1] - levels[0] > TIMES_MORE * np.min(np.diff(levels))
    for end, beside, how in ((-1, -2, "highest"), (0, 1, "lowest")):
        is_end = counts[end] > max(MOST_CUT * len(value), TIMES_MORE * counts[beside])
        if is_end and (is_apart or how == "highest"):
            yield (
                f"{COUNTED}: {100 * counts[end] / len(value):.0f} % of its samples at work read "
                f"{levels[end]:g} l/min, its {how} reading: what lies beyond the meter's end is "
                "missing, and the leakage wrong by that"
            )


def _flow_at_work(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> Array:
    """Return readings of the drain flow away from halts; none of a counter."""
    raw = channels[COUNTED]
    is_read = np.isfinite(raw.value) & ~_near_halts(channels["speed"], raw.time_us)
    return raw.value[is_read & (not spec.file.channels[COUNTED].is_counted)]


def temperature_jumps(log: RawChannel) -> Iterator[str]:
    """Yield that the oil's temperature jumps between neighbours."""
    low, high = FALLBACK_VALID_RANGE["oil_temperature"]
    is_bad = False if log.bad_quality is None else log.bad_quality
    rows = np.flatnonzero((log.value >= low) & (log.value <= high) & np.logical_not(is_bad))
    time_us, value = log.time_us[rows], log.value[rows]
    is_near = np.abs(np.diff(time_us)) <= NEIGHBOURS_S * SECOND_US
    steps = np.where(is_near, np.abs(np.diff(value)), 0.0)
    is_jump, least = steps >= JUMP_C, JUMP_C
    is_jump[1:-1] &= np.abs(value[3:] - value[:-3]) >= JUMP_C
    if np.count_nonzero(is_jump) < FEWEST_JUMPS:
        is_jump, least = steps > RESTLESS_C, RESTLESS_C
        usual = max(RESTLESS_SHARE * np.count_nonzero(is_near), FEWEST_JUMPS)
        if np.count_nonzero(is_jump) <= usual:
            return
    first = np.flatnonzero(is_jump)[0]
    yield (
        f"oil_temperature jumps {np.count_nonzero(is_jump)} times by {least:g} °C and more between "
        f"neighbours, such as {value[first]:g} to {value[first + 1]:g} at "
        f"{utc(time_us[first]):%Y-%m-%d %H:%M:%S} UTC, which no oil does: are columns swapped, "
        "is the sensor loose, or a column of quality not used?"
    )


def repeated_extremes(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> dict[str, str]:
    """Return highest and lowest values that are no readings, and the keys that refuse them.

    They are by channel and value.
    """
    extremes = dict[str, str]()
    for name, channel in spec.file.channels.items():
        if channel.constant is not None or channel.is_counted:
            continue
        # A halt drives oil backwards through the meter, which then reads its maximum.
        at_work = ~_near_halts(channels["speed"], channels[name].time_us)
        value = _credible(name, channel, channels[name].value[at_work])
        for extreme, nearest in _sentinels(value):
            low, high = channel.valid_range or FALLBACK_VALID_RANGE[name]
            limit = float(f"{(extreme + nearest) / 2:.3g}")
            low, high = (low, limit) if extreme > nearest else (limit, high)
            extremes[f"{name}: {extreme:g}"] = (
                f"stands {np.sum(value == extreme)} times, and no other value is beyond "
                f"{nearest:.4g}: if it is no reading, valid_range = [{low:g}, {high:g}] refuses it"
            )
    return extremes


def _near_halts(speed: RawChannel, time_us: Times) -> Mask:
    halts = np.sort(speed.time_us[np.abs(speed.value) < STANDSTILL_RPM])
    return near(halts, time_us, GUARD_BEFORE_US, GUARD_AFTER_US)


def _credible(name: str, channel: Channel, value: Array) -> Array:
    low, high = channel.valid_range or FALLBACK_VALID_RANGE[name]
    readings = value[np.isfinite(value) & (value >= low) & (value <= high)]
    if channel.sensor_maximum is not None:
        readings = readings[readings < channel.sensor_maximum - channel.resolution]
    # Whatever stands still or is without load reads 0.
    return readings if name == "oil_temperature" else readings[readings != 0.0]


def _sentinels(value: Array) -> Iterator[tuple[float, float]]:
    """Yield extreme values, each with the nearest of the others."""
    for end in (np.max, np.min) if len(value) else ():
        mark = float(end(value))
        others = value[value != mark]
        places = np.flatnonzero(value == mark)
        n_stretches = 1 + int(np.count_nonzero(np.diff(places) > 1))
        if n_stretches < FEWEST_STRETCHES or 2 * len(others) < len(value):
            continue
        beside = float(end(others))
        low, high = np.quantile(others, SPREAD)
        if abs(mark - beside) > BEYOND_SPREADS * (high - low) > 0.0:
            yield mark, beside


# What a night gives


def operation(spec: MotorSpec, label: dt.date, samples: Samples) -> str:
    """Return running minutes of a night, its conditions, and what they are enough for, in words.

    Conditions are the 5th to 95th percentiles while the motor ran.
    """
    minutes = samples.n_turning * samples.period_us / SECOND_US / 60.0
    pressure, speed = np.abs(samples.pressure_difference_bar), np.abs(samples.speed_rpm)
    inputs = (pressure, speed, samples.oil_temperature_c)
    reached = []
    for (name, (full, unit)), values in zip(RANGES.items(), inputs, strict=True):
        low, high = np.percentile(values, (5, 95), method="nearest")
        share = min((high - low) / full, 1.0)
        reached.append(f"{name} {low:.3g} to {high:.3g} {unit} ({100 * share:.0f} %)")
    ran = (
        f"in the night {label} the motor ran {minutes:.3g} minutes, at {', '.join(reached)} of the "
        "range that identifies every path within 30 minutes"
    )
    needed = MINIMUM_TRAINING_MINUTES / spec.settings.windows.blocks().training_share
    if minutes < needed:
        return f"{ran}: too little for a fit, which needs {needed:.3g} minutes"
    return f"{ran}; first verdict on a change after {spec.settings.trend.baseline_nights} nights"

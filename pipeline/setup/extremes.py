"""Values that are no readings: extremes that stand again and again, and jumps of the oil's heat."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pipeline.arrays import SECOND_US, Array, Mask, Times
from pipeline.clock import utc
from pipeline.config import Channel, MotorSpec
from pipeline.ingest import RawChannel
from pipeline.night.masks import near
from pipeline.units import FALLBACK_VALID_RANGE

# An extreme value is none of a measurement where it comes in so many stretches of the log, and
# lies so many times the spread of the others beyond them.
FEWEST_STRETCHES, BEYOND_SPREADS, SPREAD = 3, 1.5, (0.02, 0.98)


# Oil does not change by so much between neighbouring samples that are so near; where the samples
# around them differ as much it is no single spike, which is refused.
JUMP_C, NEIGHBOURS_S, FEWEST_JUMPS = 10.0, 10.0, 3


def jumps(log: RawChannel) -> Iterator[str]:
    """Yield that the oil's temperature jumps between neighbours."""
    low, high = FALLBACK_VALID_RANGE["oil_temperature"]
    rows = np.flatnonzero((log.value >= low) & (log.value <= high))
    time_us, value = log.time_us[rows], log.value[rows]
    is_near = np.abs(np.diff(time_us)) <= NEIGHBOURS_S * SECOND_US
    is_jump = (np.abs(np.diff(value)) >= JUMP_C) & is_near
    is_jump[1:-1] &= np.abs(value[3:] - value[:-3]) >= JUMP_C
    places = np.flatnonzero(is_jump)
    if len(places) >= FEWEST_JUMPS:
        first = places[0]
        yield (
            f"oil_temperature jumps {len(places)} times by {JUMP_C:g} °C and more between "
            f"neighbours, such as {value[first]:g} to {value[first + 1]:g} at "
            f"{utc(time_us[first]):%Y-%m-%d %H:%M:%S} UTC, which no oil does: is the sensor loose, "
            "or a column of quality not used?"
        )


def repeated_extremes(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> Iterator[str]:
    """Yield channels whose highest or lowest value is no reading, with the key that refuses it."""
    for name, channel in spec.file.channels.items():
        if channel.constant is not None or channel.counts is not None:
            continue
        # A halt drives oil backwards through the meter, which then reads its maximum.
        at_work = ~_near_halts(spec, channels["speed"], channels[name].time_us)
        value = _credible(name, channel, channels[name].value[at_work])
        for extreme, nearest in _sentinels(value):
            low, high = channel.valid_range or FALLBACK_VALID_RANGE[name]
            limit = float(f"{(extreme + nearest) / 2:.3g}")
            low, high = (low, limit) if extreme > nearest else (limit, high)
            yield (
                f"extreme_repeated: {name}: {extreme:g} stands {np.sum(value == extreme)} times, "
                f"and no other value is beyond {nearest:.4g}: if it is no reading, "
                f"valid_range = [{low:g}, {high:g}] refuses it"
            )


def _near_halts(spec: MotorSpec, speed: RawChannel, time_us: Times) -> Mask:
    cleaning = spec.settings.cleaning
    halts = np.sort(speed.time_us[np.abs(speed.value) < cleaning.standstill_rpm])
    before, after = cleaning.guard_before_s * SECOND_US, cleaning.guard_after_s * SECOND_US
    return near(halts, time_us, before, after)


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

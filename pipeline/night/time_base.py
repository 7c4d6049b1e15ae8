"""One time base for all channels of a night, and the rules that need them all at once.

The grid is anchored at the night's start, so it does not depend on which files a night came in.
An on-change channel begins with its last sample before the night.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from math import ceil
from typing import Any

import numpy as np

from pipeline.arrays import SECOND_US, Mask, Times, Values
from pipeline.config import Cleaning, Settings, TimeBase
from pipeline.config.nights import Night
from pipeline.night.cleaning import CleanChannel
from pipeline.night.halts import Halts, settled_halts
from pipeline.night.masks import ROUNDING, near, steps_where, stretches, transient
from pipeline.night.resampling import on_grid
from pipeline.night.transport_delay import delay_inputs

NO_HALTS = Halts()
INPUTS = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
# Leakage follows its inputs within less than the period of this rate.
MAXIMUM_RATE_HZ = 10.0
# Faster changes are transients: in rpm/s, and in bar/s.
TRANSIENTS = {"speed": 5.0, "pressure_difference": 50.0}
# Pressures against which a two-sided motor leaks; a sample needs those that are logged.
LOW_PRESSURES = ("charge_pressure", "low_port_pressure", "case_pressure")
# The oil's own measurement: no sample needs it.
VISCOSITIES = ("kinematic_viscosity", "dynamic_viscosity")
# Arrays of `Samples`.
OF_SAMPLES = (
    *("index", "time_us", "pressure_difference_bar"),
    *("oil_temperature_c", "speed_rpm", "leakage_l_per_min"),
)


@dataclass(frozen=True, slots=True)
class Quality:
    """Numbers of samples that a rule looked at, refused, or kept although it applies."""

    channel: str
    reason: str
    n_samples: int
    n_refused: int
    n_noted: int = 0

    @classmethod
    def of(cls, channel: str, reason: str, refused: Mask) -> Quality:
        """Return the count of a mask."""
        return cls(channel, reason, len(refused), int(np.count_nonzero(refused)))


@dataclass(frozen=True, slots=True)
class Samples:
    """The kept samples of a night on its time base."""

    index: Times  # place of each kept sample on the grid, shape (n,), increasing
    time_us: Times  # UTC microseconds, shape (n,)
    # pressure_difference_bar, oil_temperature_c, speed_rpm, leakage_l_per_min: shape (n,); pressure
    # and speed with their sign.
    pressure_difference_bar: Values
    oil_temperature_c: Values
    speed_rpm: Values
    leakage_l_per_min: Values
    # Those of charge, low port and case that are logged, shape (n,) each.
    low_pressures_bar: Mapping[str, Values]
    period_us: int  # period of the grid
    # Samples of the grid in the logger's sessions in which the motor ran, away from standstill and
    # its guard times.
    n_running: int
    # Transport delay that the kept samples were paired with, their mean.
    delay_s: float = 0.0
    # n_logged, n_turning: samples of the grid with a credible speed, and those of them above
    # standstill.
    n_logged: int = 0
    n_turning: int = 0
    halts: Halts = NO_HALTS  # what the sensors said at depressurised, settled halts
    # Kinematic [mm²/s] or dynamic [mPa·s] viscosity if logged, nan where not known; (n,) each.
    viscosities: Mapping[str, Values] = field(default_factory=dict)

    def only(self, chosen: Mask) -> Samples:
        """These samples without those that are not chosen; the night stays as long as it was."""
        found: dict[str, Any] = {name: getattr(self, name)[chosen] for name in OF_SAMPLES}
        for name in ("low_pressures_bar", "viscosities"):
            found[name] = {of: value[chosen] for of, value in getattr(self, name).items()}
        return replace(self, **found)

    @property
    def kept_share(self) -> float:
        """Share of the running motor's samples that was kept."""
        return len(self.index) / self.n_running if self.n_running else 0.0


def grid_period_us(channels: Mapping[str, CleanChannel], settings: TimeBase) -> int:
    """Period of the time base [µs]: as stated, else of the fastest channel, within the limit.

    The measured rate is rounded (to whole hertz, or whole seconds below 1 Hz), so that a logger's
    jitter does not give each night a grid of its own. A channel that is sent on change has no rate
    of its own and counts only where all are; means are not taken apart.
    """
    if settings.rate_hz is not None:
        return round(SECOND_US / settings.rate_hz)
    timed = [channel for channel in channels.values() if channel.period_us]
    periodic = [channel for channel in timed if not channel.sampling.on_change] or timed
    fastest = min(channel.period_us for channel in periodic if channel.period_us)
    fastest = max(fastest, *(channel.sampling.mean_us for channel in channels.values()))
    if fastest > SECOND_US / 1.5:
        rounded = max(round(fastest / SECOND_US), 1) * SECOND_US
    else:
        rounded = round(SECOND_US / round(SECOND_US / fastest))
    return max(rounded, ceil(SECOND_US / MAXIMUM_RATE_HZ))


def bring_together(
    channels: Mapping[str, CleanChannel], night: Night, settings: Settings
) -> tuple[Samples, tuple[Quality, ...]]:
    """All channels on one time base, and the joint rules: gap, standstill, guard, transient."""
    measured = {name: channel for name, channel in channels.items() if name in VISCOSITIES}
    channels = {name: channel for name, channel in channels.items() if name not in VISCOSITIES}
    cleaning, delay = settings.cleaning, settings.transport_delay
    period = grid_period_us(channels, settings.time_base)
    last = max(int(channel.time_us[-1]) for channel in channels.values())
    start = night.start_us
    begin = max(-(-(_first_us(channels, start) - start) // period), 0)
    end = min(last - start, night.end_us - start - 1) // period
    grid = start + period * np.arange(begin, end + 1, dtype=np.int64)
    values: dict[str, Values] = {}
    present: dict[str, Mask] = {}
    found: list[Quality] = []
    for name, channel in channels.items():
        values[name], present[name], silent = on_grid(channel, grid, period)
        found.append(Quality.of(name, "gap", silent))
    if "high_port_pressure" in channels:
        high, low = "high_port_pressure", "low_port_pressure"
        values["pressure_difference"] = values[high] - values[low]
        present["pressure_difference"] = present[high] & present[low]
    low_pressures = [name for name in LOW_PRESSURES if name in channels]
    unpaired: dict[str, Mask] = {}
    delay_s = np.zeros(len(grid))
    if delay.is_on:
        values, present, late, delay_s = delay_inputs(values, present, period / SECOND_US, delay)
        unpaired["transport_delay"] = late
    incomplete = ~reduce(np.logical_and, (present[name] for name in (*INPUTS, *low_pressures)))
    together = Together(grid, period / SECOND_US, values, present, begin)
    masks = _halt_masks(channels, together, cleaning)
    judged = {reason: rule(together, cleaning) for reason, rule in JOINT_RULES.items()}
    masks |= {reason: mask for reason, mask in judged.items() if mask is not None} | unpaired
    masks["incomplete"] = incomplete
    refused = masks["any"] = reduce(np.logical_or, masks.values())
    found += [Quality.of("time_base", reason, mask) for reason, mask in masks.items()]
    # By their places, which takes a third of the time that a mask does.
    kept = np.flatnonzero(~refused)
    off = between_sessions(channels.values(), grid) & refused
    running = ~(off | masks["standstill"] | masks["guard"])
    if (warm_up := masks.get("warm_up")) is not None:
        running &= ~warm_up
    n_logged = int(np.count_nonzero(present["speed"]))
    n_turning = n_logged - int(np.count_nonzero(masks["standstill"]))
    del together
    pressure, temperature, speed, leakage = (values.pop(name)[kept] for name in INPUTS)
    return (
        Samples(
            index=begin + kept,
            time_us=grid[kept],
            pressure_difference_bar=pressure,
            oil_temperature_c=temperature,
            speed_rpm=speed,
            leakage_l_per_min=leakage,
            low_pressures_bar={name: values.pop(name)[kept] for name in low_pressures},
            period_us=period,
            n_running=int(np.count_nonzero(running)),
            delay_s=float(delay_s[kept].mean()) if len(kept) else 0.0,
            n_logged=n_logged,
            n_turning=n_turning,
            halts=settled_halts(
                masks["standstill"],
                grid,
                channels,
                settings.sensor_health,
                settings.model.case_pressure_bar,
            ),
            viscosities={
                name: on_grid(channel, grid, period)[0][kept] for name, channel in measured.items()
            },
        ),
        tuple(found),
    )


def between_sessions(channels: Collection[CleanChannel], grid_us: Times) -> Mask:
    """Return times at which the logger was off: no channel has a sample near.

    Near is what is no gap of the channel that has the shortest.
    """
    gaps_us = (channel.longest_gap_us for channel in channels if channel.longest_gap_us)
    longest_us = min(gaps_us, default=np.inf)
    off = np.ones(len(grid_us), dtype=np.bool_)
    for channel in channels:
        time = channel.time_us
        gaps = steps_where(lambda steps_us: steps_us > longest_us, time)
        begins = grid_us.searchsorted(time[np.append(gaps + 1, 0)])
        ends = grid_us.searchsorted(time[np.append(gaps, -1)], "right")
        for begin, end in zip(np.sort(begins).tolist(), np.sort(ends).tolist(), strict=True):
            off[begin:end] = False
    return off


def _first_us(channels: Mapping[str, CleanChannel], night_start_us: int) -> int:
    """Begin of a night's log: its first sample, or the night's start if all carry over."""
    if all(channel.n_carried for channel in channels.values()):
        return night_start_us
    return min(
        int(channel.time_us[channel.n_carried])
        for channel in channels.values()
        if len(channel.time_us) > channel.n_carried
    )


def _halt_masks(
    channels: Mapping[str, CleanChannel], together: Together, cleaning: Cleaning
) -> dict[str, Mask]:
    """Return standstills, and the guard times around them and around a sensor at its maximum."""
    grid = together.grid_us
    standstill = together.present["speed"] & ~_is_turning(together, cleaning)
    begins, ends = stretches(standstill)
    flow = channels["leakage_flow"]
    # A halt drives oil backwards through the sensor, which then reads its maximum.
    events = np.concatenate([grid[begins], grid[ends - 1], flow.time_us[flow.at_maximum]])
    events.sort()
    before, after = cleaning.guard_before_s * SECOND_US, cleaning.guard_after_s * SECOND_US
    return {"standstill": standstill, "guard": near(events, grid, before, after) & ~standstill}


@dataclass(frozen=True, slots=True)
class Together:
    """All channels on the time base, as the joint rules judge them."""

    grid_us: Times  # times, shape (n,)
    period_s: float  # their distance
    # values, present: of each channel, shape (n,); only `present` ones count.
    values: Mapping[str, Values]
    present: Mapping[str, Mask]
    n_before: int  # times between the night's start and the first


def _is_turning(together: Together, cleaning: Cleaning) -> Mask:
    """Return times at which the motor is known to turn."""
    slowest = (1.0 - ROUNDING) * cleaning.standstill_rpm
    turning: Mask = together.present["speed"] & (np.abs(together.values["speed"]) >= slowest)
    return turning


def _warm_up(together: Together, cleaning: Cleaning) -> Mask | None:
    """The time after a start from a rest, of the motor or of the log, that is at least as long."""
    length = round(60.0 * cleaning.warm_up_minutes / together.period_s)
    if not length:
        return None
    begins, ends = stretches(_is_turning(together, cleaning))
    rests = begins - np.concatenate([[-together.n_before], ends[:-1]])[: len(begins)]
    is_cold = rests >= length
    cold = np.zeros(len(together.grid_us), dtype=np.bool_)
    for begin in begins[is_cold].tolist():
        cold[begin : begin + length] = True
    return cold


def _transients(together: Together, cleaning: Cleaning) -> Mask | None:
    """Return fast changes of speed or pressure."""
    if not cleaning.refuse_transients:
        return None
    fast = np.zeros(len(together.grid_us), dtype=np.bool_)
    for name, limit in TRANSIENTS.items():
        fast |= transient(together.values[name], together.present[name], together.period_s, limit)
    return fast


# Rules for all channels together, by their reason in `quality`. Each gives a mask of the times
# that it refuses, or None where the settings have it off; `QUALITY_REASONS` has the words.
JOINT_RULES: dict[str, Callable[[Together, Cleaning], Mask | None]] = {
    "warm_up": _warm_up,
    "transient": _transients,
}

"""The common time base of all channels of a night, and the rules that need them all at once.

The grid is anchored at the night's start, so it does not depend on which files a night came in.
Slower channels are interpolated linearly, never across a gap or a refused sample; faster ones are
averaged over a cell of the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from pipeline.arrays import SECOND_US, Mask, Times, Values
from pipeline.config import Cleaning, SensorHealth, Settings
from pipeline.config.nights import Night
from pipeline.night.cleaning import STANDSTILL_RPM, CleanChannel
from pipeline.night.masks import ROUNDING, near, stretches, transient
from pipeline.night.on_grid import delay_inputs, on_grid

INPUTS = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
# Leakage follows its inputs within less than the period of this rate.
MAXIMUM_RATE_HZ = 10.0
# Time refused around a halt or back-flow: before it the motor slows down, after it the drain line
# fills again.
GUARD_BEFORE_US, GUARD_AFTER_US = 10 * SECOND_US, 30 * SECOND_US
# Faster changes are transients: in rpm/s, and in bar/s.
TRANSIENTS = {"speed": 5.0, "pressure_difference": 50.0}
# Pressures against which a two-sided motor leaks; a sample needs those that are logged.
LOW_PRESSURES = ("charge_pressure", "low_port_pressure", "case_pressure")
# The oil's own measurement: no sample needs it.
VISCOSITIES = ("kinematic_viscosity", "dynamic_viscosity")
# Channels of the low side, and of the case.
LOW_SIDE, CASE = ("low_port_pressure", "charge_pressure"), "case_pressure"
# Time left out after the motor has stopped, and credible samples that a halt needs after that.
SETTLE_US, MINIMUM_US = 45 * SECOND_US, 20 * SECOND_US
# |Pressure difference| of a halt that shows its zero; |low side over case| for the flow's.
DEPRESSURISED_BELOW_BAR = 5.0
# Arrays of `Samples`.
OF_SAMPLES = (
    *("index", "time_us", "pressure_difference_bar"),
    *("oil_temperature_c", "speed_rpm", "leakage_l_per_min"),
)


class Insufficient(Exception):  # noqa: N818 - an outcome on its way out, not an error
    """The night has too little to fit; carries the outcome, the reason and a failure's code."""

    def __init__(self, status: str, reason: str, *, code: str | None = None) -> None:
        super().__init__(status, reason)
        self.status = status
        self.reason = reason
        self.code = code


class Quality(NamedTuple):
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
class Zero:
    """Reading of a sensor while there is nothing to measure."""

    value: float  # median over the halts of each halt's median, in the channel's unit
    standard_error: float | None  # from the scatter between halts; None for fewer than three


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
    # Ends of the pressure difference [bar] while the speed says standstill; (0, 0) without one.
    bar_at_rest: tuple[float, float] = (0.0, 0.0)
    # Zeros of the pressure difference and of the drain flow by halts; None where none shows them.
    pressure_zero: Zero | None = None
    flow_zero: Zero | None = None
    # Kinematic [mm²/s] or dynamic [mPa·s] viscosity if logged, nan where not known; (n,) each.
    viscosities: Mapping[str, Values] = field(default_factory=dict)

    def only(self, chosen: Mask) -> Samples:
        """Return these samples without those not chosen; the night stays as long as it was."""
        samples: dict[str, Any] = {name: getattr(self, name)[chosen] for name in OF_SAMPLES}
        for name in ("low_pressures_bar", "viscosities"):
            samples[name] = {of: value[chosen] for of, value in getattr(self, name).items()}
        return replace(self, **samples)

    @property
    def kept_share(self) -> float:
        """Share of the running motor's samples that was kept."""
        return len(self.index) / self.n_running if self.n_running else 0.0


def grid_period_us(channels: Mapping[str, CleanChannel]) -> int:
    """Return the period of the time base [µs]: that of the fastest channel.

    The rate is rounded (to whole hertz, or seconds below 1 Hz): a logger's jitter gives no night a
    grid of its own. A channel that is sent on change counts only where all are; means are not taken
    apart.
    """
    timed = [channel for channel in channels.values() if channel.period_us]
    periodic = [channel for channel in timed if not channel.rules.on_change] or timed
    fastest = min(channel.period_us for channel in periodic if channel.period_us)
    fastest = max(fastest, *(channel.rules.mean_us for channel in channels.values()))
    if fastest > SECOND_US / 1.5:
        rounded = max(round(fastest / SECOND_US), 1) * SECOND_US
    else:
        rounded = round(SECOND_US / round(SECOND_US / fastest))
    return max(rounded, ceil(SECOND_US / MAXIMUM_RATE_HZ))


@dataclass(frozen=True, slots=True)
class Together:
    """All channels on the time base, as the joint rules judge them."""

    grid_us: Times  # times, shape (n,)
    period_s: float  # their distance
    # values, present: of each channel, shape (n,); only `present` ones count.
    values: dict[str, Values]
    present: dict[str, Mask]
    n_before: int  # times between the night's start and the first


def bring_together(
    channels: Mapping[str, CleanChannel], night: Night, settings: Settings
) -> tuple[Samples, tuple[Quality, ...]]:
    """Return all channels on the time base, and joint rules: gap, standstill, guard, transient."""
    of_oil = {name: channel for name, channel in channels.items() if name in VISCOSITIES}
    channels = {name: channel for name, channel in channels.items() if name not in VISCOSITIES}
    low_pressures = [name for name in LOW_PRESSURES if name in channels]
    period_us = grid_period_us(channels)
    together, counted = _on_one_grid(channels, night, period_us)
    grid_us, delay_s, unpaired = together.grid_us, np.zeros(len(together.grid_us)), {}
    if settings.transport_delay.is_on:
        values, present, unpaired["transport_delay"], delay_s = delay_inputs(
            together.values, together.present, together.period_s, settings.transport_delay
        )
        together = replace(together, values=values, present=present)
    values, present = together.values, together.present
    masks = _joint_masks(channels, together, settings.cleaning) | unpaired
    needed = (present[name] for name in (*INPUTS, *low_pressures))
    masks["incomplete"] = ~reduce(np.logical_and, needed)
    refused = masks["any"] = reduce(np.logical_or, masks.values())
    counted += [Quality.of("time_base", reason, mask) for reason, mask in masks.items()]
    rests = (masks[reason] for reason in ("standstill", "guard", "warm_up") if reason in masks)
    at_rest = reduce(np.logical_or, rests)
    n_off = between_sessions(channels.values(), grid_us[refused & ~at_rest])
    n_logged = np.count_nonzero(present["speed"])
    pressure_zero, flow_zero = zeros_of_halts(
        masks["standstill"], grid_us, channels, settings.sensor_health
    )
    # By their places, which takes a third of the time that a mask does.
    credible = np.flatnonzero(~refused)
    pressure, temperature, speed, leakage = (values[name][credible] for name in INPUTS)
    samples = Samples(
        index=together.n_before + credible,
        time_us=grid_us[credible],
        pressure_difference_bar=pressure,
        oil_temperature_c=temperature,
        speed_rpm=speed,
        leakage_l_per_min=leakage,
        low_pressures_bar={name: values[name][credible] for name in low_pressures},
        period_us=period_us,
        n_running=len(grid_us) - int(np.count_nonzero(at_rest)) - n_off,
        delay_s=float(delay_s[credible].mean()) if len(credible) else 0.0,
        n_logged=int(n_logged),
        n_turning=int(n_logged - np.count_nonzero(masks["standstill"])),
        bar_at_rest=_ends(np.abs(values["pressure_difference"][masks["standstill"]])),
        pressure_zero=pressure_zero,
        flow_zero=flow_zero,
        viscosities={
            name: on_grid(channel, grid_us, period_us).value[credible]
            for name, channel in of_oil.items()
        },
    )
    return samples, tuple(counted)


def _ends(values: Values) -> tuple[float, float]:
    """Return the tenth and the ninetieth percentile of values that are known; 0 without any."""
    known = values[np.isfinite(values)]
    low, high = np.quantile(known, (0.1, 0.9)).tolist() if len(known) else (0.0, 0.0)
    return low, high


def _on_one_grid(
    channels: Mapping[str, CleanChannel], night: Night, period_us: int
) -> tuple[Together, list[Quality]]:
    """Return channels on the times between the first sample and the last, and their gaps."""
    start_us = first_us = night.start_us
    # Where all carry over from the night before, it begins with the night.
    if not all(channel.n_carried for channel in channels.values()):
        own_us = (channel.time_us[channel.n_carried :] for channel in channels.values())
        first_us = min(int(times[0]) for times in own_us if len(times))
    last_us = max(int(channel.time_us[-1]) for channel in channels.values())
    begin = max(-(-(first_us - start_us) // period_us), 0)
    end = min(last_us - start_us, night.end_us - start_us - 1) // period_us
    grid_us = start_us + period_us * np.arange(begin, end + 1, dtype=np.int64)
    values: dict[str, Values] = {}
    present: dict[str, Mask] = {}
    silences: list[Quality] = []
    for name, channel in channels.items():
        values[name], present[name], silent = on_grid(channel, grid_us, period_us)
        silences.append(Quality.of(name, "gap", silent))
    if "high_port_pressure" in channels:
        high, low = "high_port_pressure", "low_port_pressure"
        values["pressure_difference"] = values[high] - values[low]
        present["pressure_difference"] = present[high] & present[low]
    return Together(grid_us, period_us / SECOND_US, values, present, begin), silences


def between_sessions(channels: Collection[CleanChannel], times_us: Times) -> int:
    """Return at how many of some times the logger was off: no channel has a sample near."""
    gaps_us = (channel.longest_gap_us for channel in channels if channel.longest_gap_us)
    longest_us = min(gaps_us, default=np.inf)
    off_us = times_us
    for samples_us in (channel.time_us for channel in channels):
        after = samples_us.searchsorted(off_us)
        before_us = samples_us[np.maximum(after - 1, 0)]
        after_us = samples_us[np.minimum(after, len(samples_us) - 1)]
        is_between = (
            (before_us < off_us) & (off_us < after_us) & (after_us - before_us <= longest_us)
        )
        off_us = off_us[~(is_between | (after_us == off_us))]
    return len(off_us)


def _joint_masks(
    channels: Mapping[str, CleanChannel], together: Together, cleaning: Cleaning
) -> dict[str, Mask]:
    """Return the times that each joint rule refuses, by its reason; of rules that are on."""
    grid_us = together.grid_us
    standstill = together.present["speed"] & ~_is_turning(together)
    begins, ends = stretches(standstill)
    flow = channels["leakage_flow"]
    # A halt drives oil backwards through the sensor, which then reads its maximum.
    events = [grid_us[begins], grid_us[ends - 1], flow.time_us[flow.at_maximum]]
    guard = near(np.sort(np.concatenate(events)), grid_us, GUARD_BEFORE_US, GUARD_AFTER_US)
    masks = {"standstill": standstill, "guard": guard & ~standstill}
    judged = {reason: rule(together, cleaning) for reason, rule in JOINT_RULES.items()}
    return masks | {reason: mask for reason, mask in judged.items() if mask is not None}


def _is_turning(together: Together) -> Mask:
    """Return times at which the motor is known to turn."""
    slowest = (1.0 - ROUNDING) * STANDSTILL_RPM
    turning: Mask = together.present["speed"] & (np.abs(together.values["speed"]) >= slowest)
    return turning


def _warm_up(together: Together, cleaning: Cleaning) -> Mask | None:
    """Return time after a start from a rest, of motor or log, that is at least as long."""
    length = round(60.0 * cleaning.warm_up_minutes / together.period_s)
    if not length:
        return None
    begins, ends = stretches(_is_turning(together))
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


def zeros_of_halts(
    standstill: Mask,
    grid_us: Times,
    channels: Mapping[str, CleanChannel],
    settings: SensorHealth,
) -> tuple[Zero | None, Zero | None]:
    """Return the zeros of the pressure difference and the drain flow; None where no halt shows it.

    Samples refused as frozen count: a sensor that has nothing to measure may well not move.
    """
    sides = {"pressure_difference": 1.0}
    if "high_port_pressure" in channels:
        sides = {"high_port_pressure": 1.0, "low_port_pressure": -1.0}
    pressures: list[float] = []
    flows: list[float] = []
    begins, ends = stretches(standstill)
    for first, last in zip(grid_us[begins].tolist(), grid_us[ends - 1].tolist(), strict=True):
        begin, end = first + SETTLE_US, last
        if end - begin < MINIMUM_US:
            continue
        flow = _readings(channels["leakage_flow"], begin, end)
        ports = [(sign, _readings(channels[name], begin, end)) for name, sign in sides.items()]
        if not len(flow) or not all(len(port) for _, port in ports):
            continue
        if any(np.ptp(port) > DEPRESSURISED_BELOW_BAR for _, port in ports):
            continue
        bar = sum(sign * float(np.median(port)) for sign, port in ports)
        if abs(bar) <= DEPRESSURISED_BELOW_BAR:
            pressures.append(bar)
            if _is_relieved(channels, (begin, end), settings):
                flows.append(float(np.median(flow)))
    return _zero(pressures), _zero(flows)


def _is_relieved(
    channels: Mapping[str, CleanChannel], halt: tuple[int, int], settings: SensorHealth
) -> bool:
    """Return True if the low side is known to be near case pressure, and the other port with it."""
    low = next((name for name in LOW_SIDE if name in channels), None)
    if settings.without_pressure_at_halts or low is None:
        return settings.without_pressure_at_halts
    port = _readings(channels[low], *halt)
    case = _readings(channels[CASE], *halt) if CASE in channels else np.zeros(1)
    if not len(port) or not len(case):
        return False
    return bool(abs(np.median(port) - np.median(case)) <= DEPRESSURISED_BELOW_BAR)


def _readings(channel: CleanChannel, begin_us: int, end_us: int) -> Values:
    """Return readings in a stretch, below the sensor's maximum; none where it is too short."""
    first, last = np.searchsorted(channel.time_us, [begin_us, end_us])
    value, saturated = channel.value[first:last], channel.at_maximum[first:last]
    readings: Values = value[np.isfinite(value) & ~saturated]
    enough = len(readings) * (end_us - begin_us) >= MINIMUM_US * len(value)
    return readings if enough else readings[:0]


def _zero(halts: Sequence[float]) -> Zero | None:
    """Return zero of some halts; None where there is none."""
    if not halts:
        return None
    error = None if len(halts) < 3 else float(np.std(halts, ddof=1) / np.sqrt(len(halts)))
    return Zero(float(np.median(halts)), error)

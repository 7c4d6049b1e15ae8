"""The common time base of all channels of a night, and the rules that need them all at once.

The grid is anchored at the night's start, so it does not depend on which files a night came in.
Slower channels are interpolated linearly, never across a gap or a refused sample; faster ones are
averaged over a cell of the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import SECOND_US, Mask, Times, Values
from pipeline.config import Cleaning, Settings, TimeBase
from pipeline.config.nights import Night
from pipeline.night.cleaning import CleanChannel
from pipeline.night.halts import Zero, zeros_of_halts
from pipeline.night.masks import ROUNDING, near, stretches, transient
from pipeline.night.transport_delay import delay_inputs

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
# A channel with more than this many samples a cell of the grid is averaged, not interpolated.
AVERAGE_ABOVE = 1.5
# Share of a cell's samples that must be kept for its average.
CELL_SHARE = 0.5
# Samples in equal steps are filled in without a search where stretches of them are this long.
EVEN_SAMPLES = 64
# A mean stands for this share of its period on either side; half, and some for jitter.
MEAN_REACH = 0.6


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
    # Zeros of the pressure difference and of the drain flow by halts; None where none shows them.
    pressure_zero: Zero | None = None
    flow_zero: Zero | None = None
    # Kinematic [mm²/s] or dynamic [mPa·s] viscosity if logged, nan where not known; (n,) each.
    viscosities: Mapping[str, Values] = field(default_factory=dict)

    def only(self, chosen: Mask) -> Samples:
        """These samples without those that are not chosen; the night stays as long as it was."""
        samples: dict[str, Any] = {name: getattr(self, name)[chosen] for name in OF_SAMPLES}
        for name in ("low_pressures_bar", "viscosities"):
            samples[name] = {of: value[chosen] for of, value in getattr(self, name).items()}
        return replace(self, **samples)

    @property
    def kept_share(self) -> float:
        """Share of the running motor's samples that was kept."""
        return len(self.index) / self.n_running if self.n_running else 0.0


def grid_period_us(channels: Mapping[str, CleanChannel], settings: TimeBase) -> int:
    """Return the period of the time base [µs]: as stated, else of the fastest channel.

    The rate is rounded (to whole hertz, or seconds below 1 Hz): a logger's jitter gives no night a
    grid of its own. A channel that is sent on change counts only where all are; means are not taken
    apart.
    """
    if settings.rate_hz is not None:
        return round(SECOND_US / settings.rate_hz)
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
    """All channels on the time base, and the joint rules: gap, standstill, guard, transient."""
    of_oil = {name: channel for name, channel in channels.items() if name in VISCOSITIES}
    channels = {name: channel for name, channel in channels.items() if name not in VISCOSITIES}
    low_pressures = [name for name in LOW_PRESSURES if name in channels]
    period_us = grid_period_us(channels, settings.time_base)
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
        pressure_zero=pressure_zero,
        flow_zero=flow_zero,
        viscosities={
            name: on_grid(channel, grid_us, period_us).value[credible]
            for name, channel in of_oil.items()
        },
    )
    return samples, tuple(counted)


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
    standstill = together.present["speed"] & ~_is_turning(together, cleaning)
    begins, ends = stretches(standstill)
    flow = channels["leakage_flow"]
    # A halt drives oil backwards through the sensor, which then reads its maximum.
    events = [grid_us[begins], grid_us[ends - 1], flow.time_us[flow.at_maximum]]
    before, after = cleaning.guard_before_s * SECOND_US, cleaning.guard_after_s * SECOND_US
    guard = near(np.sort(np.concatenate(events)), grid_us, before, after)
    masks = {"standstill": standstill, "guard": guard & ~standstill}
    judged = {reason: rule(together, cleaning) for reason, rule in JOINT_RULES.items()}
    return masks | {reason: mask for reason, mask in judged.items() if mask is not None}


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


class OnGrid(NamedTuple):
    """A channel on the time base: values, where it has any, and where it is silent; (n,) each."""

    value: Values
    present: Mask
    silent: Mask


def on_grid(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """Return a channel on an even grid."""
    n = len(grid_us)
    if not n or not len(channel.time_us):
        return OnGrid(np.full(n, np.nan), np.zeros(n, np.bool_), np.ones(n, np.bool_))
    if channel.rules.hold:
        return _held(channel, grid_us)
    if channel.rules.mean_us > 0:
        return _mean_of_its_period(channel, grid_us)
    on_change = channel.rules.on_change
    if channel.period_us and not on_change and channel.period_us * AVERAGE_ABOVE < period_us:
        return _averaged(channel, grid_us, period_us)
    return _interpolated(channel, grid_us, period_us)


# A refused value may be infinite.
@np.errstate(over="ignore", invalid="ignore")
def _interpolated(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    """Samples as they are at their own times, and lines between them; not beside a refused one."""
    time = channel.time_us
    # A zero has no sign here, at samples as between them.
    known = channel.value + 0.0
    known[channel.refused] = np.nan
    value = np.full(len(grid_us), np.nan)
    _fill_even(value, channel, known, int(grid_us[0]), period_us)
    others = np.flatnonzero(np.isnan(value))
    rows: NDArray[np.intp] | slice = slice(None)
    if len(others) < len(value) // EVEN_SAMPLES:
        # The samples around them will do, and not all are converted; one where there are none.
        after = time.searchsorted(grid_us[others])
        rows = np.unique(np.concatenate([[0], after - 1, after]).clip(0, len(time) - 1))
    value[others] = np.interp(grid_us[others], time[rows], known[rows], left=np.nan, right=np.nan)
    # Before the first sample, within gaps between two, and after the last it is silent.
    gaps = channel.gaps
    if channel.ends is not None:
        gaps = np.union1d(gaps, np.flatnonzero(channel.ends[:-1]))
    begins = [0, *grid_us.searchsorted([*time[gaps], time[-1]], "right").tolist()]
    ends = [*grid_us.searchsorted([time[0], *time[gaps + 1]]).tolist(), len(grid_us)]
    silent = np.zeros(len(grid_us), np.bool_)
    for begin, end in zip(begins, ends, strict=True):
        value[begin:end], silent[begin:end] = np.nan, True
    return OnGrid(value, np.isfinite(value), silent)


def _fill_even(
    value: Values, channel: CleanChannel, known: Values, grid_start_us: int, period_us: int
) -> None:
    """Fill in samples in equal steps: the same values as by a search, in a fraction of the time."""
    time, step_us = channel.time_us, int(channel.period_us or 0)
    apart = step_us // period_us
    edges = channel.steps.uneven
    if not apart or step_us % period_us or len(edges) > len(time) // EVEN_SAMPLES:
        return
    for before, last in zip([-1, *edges.tolist()], [*edges.tolist(), len(time) - 1], strict=True):
        place, beside = divmod(int(time[before + 1]) - grid_start_us, period_us)
        first = before + 1 + max(-(place // apart), 0)
        place += (first - before - 1) * apart
        n = min(last - first, (len(value) - 1 - place) // apart)
        if beside or n < 0:
            continue
        sample = known[first : first + n + 1]
        if apart > 1:
            lines = value[place : place + n * apart].reshape(n, apart)
            np.multiply(np.diff(sample)[:, None] / step_us, np.arange(apart) * period_us, out=lines)
            lines += sample[:-1, None]
        value[place : place + n * apart + 1 : apart] = sample


def _held(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """The last sample, while it is not older than the longest silence; none after a refused one."""
    last = np.searchsorted(channel.time_us, grid_us, side="right") - 1
    known, last = last >= 0, np.maximum(last, 0)
    silent = ~known | (grid_us - channel.time_us[last] > channel.longest_gap_us)
    if channel.ends is not None:
        silent |= channel.ends[last] & (channel.time_us[last] < grid_us)
    present = ~silent & ~channel.refused[last]
    return OnGrid(np.where(present, channel.value[last], np.nan), present, silent)


def _mean_of_its_period(channel: CleanChannel, grid_us: Times) -> OnGrid:
    """The mean in whose period a time lies: interpolated means would be averaged once more."""
    time = channel.time_us
    right = np.minimum(np.searchsorted(time, grid_us), len(time) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(grid_us - time[left] < time[right] - grid_us, left, right)
    reach = MEAN_REACH * channel.rules.mean_us
    silent = np.abs(grid_us - time[nearest]) > reach
    present = ~silent & ~channel.refused[nearest]
    return OnGrid(np.where(present, channel.value[nearest], np.nan), present, silent)


def _averaged(channel: CleanChannel, grid_us: Times, period_us: int) -> OnGrid:
    n = len(grid_us)
    cell = (channel.time_us - grid_us[0] + period_us // 2) // period_us
    within = (cell >= 0) & (cell < n)
    silent = np.bincount(cell[within], minlength=n) == 0
    chosen = within & ~channel.refused
    cell = cell[chosen]
    counts = np.bincount(cell, minlength=n)
    total = np.bincount(cell, weights=channel.value[chosen], minlength=n)
    assert channel.period_us is not None
    present = counts >= CELL_SHARE * period_us / channel.period_us
    result = np.full(n, np.nan)
    result[present] = total[present] / counts[present]
    return OnGrid(result, present, silent)

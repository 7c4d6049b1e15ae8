"""Signals as loggers record them, each kind by its definition, for tests that tell them apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

SECOND_US = 1_000_000
T0_US = 1_767_303_000_000_000


@dataclass(frozen=True)
class Signal:
    """A signal as it is, on a fine clock: time [s] from 0, and value, shape (n,)."""

    time_s: Array
    value: Array

    @property
    def step_s(self) -> float:
        return float(self.time_s[1] - self.time_s[0])


def wandering(
    rng: np.random.Generator,
    seconds: float,
    mean: float,
    sd: float,
    tau_s: float,
    step_s: float = 0.02,
) -> Signal:
    """An Ornstein-Uhlenbeck process: fluctuates about its mean and forgets within tau."""
    n = round(seconds / step_s)
    keep = np.exp(-step_s / tau_s)
    shocks = rng.standard_normal(n) * np.sqrt(1.0 - keep**2)
    shocks[0] = rng.standard_normal()
    value = lfilter([1.0], [1.0, -keep], shocks)
    return Signal(np.arange(n) * step_s, mean + sd * value)


def moving_load(
    rng: np.random.Generator, seconds: float, levels: tuple[float, float], hold_s: float
) -> Signal:
    """Levels drawn at random, each held for a random time, with a second from one to the next."""
    step_s = 0.02
    n = round(seconds / step_s)
    value = np.empty(n)
    at, level = 0, rng.uniform(*levels)
    while at < n:
        hold = max(round(rng.exponential(hold_s) / step_s), 50)
        following = rng.uniform(*levels)
        value[at : at + hold] = level
        ramp = value[at + hold : at + hold + 50]
        ramp[:] = np.linspace(level, following, 50)[: ramp.size]
        at, level = at + hold + 50, following
    return Signal(np.arange(n) * step_s, value)


def noisy(rng: np.random.Generator, signal: Signal, sd: float) -> Signal:
    """The signal with white noise of its sensor."""
    return Signal(signal.time_s, signal.value + sd * rng.standard_normal(signal.value.size))


def stamps(time_s: Array) -> NDArray[np.int64]:
    return T0_US + np.rint(time_s * SECOND_US).astype(np.int64)


def in_steps(value: Array, resolution: float) -> Array:
    return np.round(np.rint(value / resolution) * resolution, 9) if resolution else value


def sampled(signal: Signal, period_s: float, resolution: float = 0.0) -> Signal:
    """A reading every so often."""
    every = round(period_s / signal.step_s)
    return Signal(signal.time_s[::every], in_steps(signal.value[::every], resolution))


def averaged(signal: Signal, period_s: float, resolution: float = 0.0) -> Signal:
    """The mean of every period, stamped at its end."""
    every = round(period_s / signal.step_s)
    whole = signal.value.size // every * every
    value = signal.value[:whole].reshape(-1, every).mean(axis=1)
    return Signal(signal.time_s[every - 1 : whole : every], in_steps(value, resolution))


def sent_on_change(signal: Signal, scan_s: float, resolution: float, dead_band: float) -> Signal:
    """A sample when a scan finds a value further than the dead band from the one last sent."""
    scans = sampled(signal, scan_s, resolution)
    kept = [0]
    for i, value in enumerate(scans.value.tolist()):
        if abs(value - scans.value[kept[-1]]) > dead_band * (1.0 + 1e-9):
            kept.append(i)
    return Signal(scans.time_s[kept], scans.value[kept])


def swinging_door(signal: Signal, scan_s: float, resolution: float, deviation: float) -> Signal:
    """The scans that Bristol's swinging door (US patent 4,669,097) leaves.

    From the last stored point two doors, hinged a deviation above and below it, swing open as
    scans come; once they are no longer closed towards each other, the scan before is stored.
    """
    scans = sampled(signal, scan_s, resolution)
    time, value = scans.time_s, scans.value
    kept = [0]
    upper, lower = -np.inf, np.inf
    for i in range(1, time.size):
        since = time[i] - time[kept[-1]]
        upper = max(upper, (value[i] - value[kept[-1]] - deviation) / since)
        lower = min(lower, (value[i] - value[kept[-1]] + deviation) / since)
        if upper > lower:
            kept.append(i - 1)
            since = time[i] - time[i - 1]
            upper = (value[i] - value[i - 1] - deviation) / since
            lower = (value[i] - value[i - 1] + deviation) / since
    kept.append(time.size - 1)
    kept = sorted(set(kept))
    return Signal(time[kept], value[kept])


def counted(
    flow: Signal, period_s: float, volume_cm3: float, start: float = 0.0, rolls_over: float = 0.0
) -> Signal:
    """Running total of whole counts of a volume, of a flow in l/min; the meter counts one way."""
    total = (
        start + np.cumsum(np.maximum(flow.value, 0.0)) * flow.step_s * (1000.0 / 60.0) / volume_cm3
    )
    count = np.floor(total)
    every = round(period_s / flow.step_s)
    time, count = flow.time_s[every - 1 :: every], count[every - 1 :: every]
    return Signal(time, count % rolls_over if rolls_over else count)


def pulses(flow: Signal, period_s: float, volume_cm3: float) -> Signal:
    """Counts since the sample before."""
    total = counted(flow, period_s, volume_cm3)
    return Signal(total.time_s, np.diff(total.value, prepend=0.0))


def jittered(rng: np.random.Generator, signal: Signal, sd_s: float) -> Signal:
    """Samples that come a little early or late, still in order."""
    moved = signal.time_s + sd_s * rng.standard_normal(signal.time_s.size)
    return Signal(np.sort(moved), signal.value)


def with_losses(rng: np.random.Generator, signal: Signal, share: float) -> Signal:
    """Some samples are lost."""
    kept = rng.uniform(size=signal.time_s.size) >= share
    return Signal(signal.time_s[kept], signal.value[kept])


def with_spikes(rng: np.random.Generator, signal: Signal, share: float, height: float) -> Signal:
    """Some samples are far off."""
    hit = rng.uniform(size=signal.value.size) < share
    return Signal(signal.time_s, np.where(hit, signal.value + height, signal.value))

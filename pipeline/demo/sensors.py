"""Simulated sensors and logger: noise, coarse steps, faults, gaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pipeline.config.channels import ChannelName
from pipeline.demo.noise import FloatArray, correlated_noise

NOISE_TIME_CONSTANT_S: Final = 3.9  # φ = 0.95 at 5 samples a second
MICROSECONDS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Sensor:
    """One channel's sensor."""

    resolution: float  # smallest step, [unit of the channel]
    noise: float  # standard deviation of its white noise, [unit of the channel]
    spike: float  # typical height of a spike, [unit of the channel]
    error_value: float  # reading of a broken sensor, outside its range, [unit of the channel]
    maximum: float | None = None  # highest reading, [unit of the channel]


@dataclass(frozen=True, slots=True)
class FaultRates:
    """Rates of faults, in events per hour unless stated otherwise."""

    # spikes, values_out_of_range, not_finite: single samples, in each channel.
    spikes: float = 4.0
    values_out_of_range: float = 1.0
    not_finite: float = 0.0
    blank_stretches: float = 0.7  # some seconds without a value, in each channel
    # Twenty seconds to three minutes without anything, in all channels.
    missing_periods: float = 0.7
    # Stamps that repeat the one before, and as many that lie before it.
    disordered_stamps: float = 0.5


@dataclass(frozen=True, slots=True)
class Recording:
    """A night's log before it takes a format."""

    time_us: NDArray[np.int64]  # UTC stamp of each row in the file's order, shape (n,), [µs]
    # Each channel in its canonical unit, shape (n,); NaN: no value there.
    values: Mapping[ChannelName, FloatArray]
    # Where the channels have stamps of their own: their delay behind `time_us`, shape (n,), [µs].
    own_delay_us: Mapping[ChannelName, NDArray[np.int64]] = field(default_factory=dict)


def measure(signal: FloatArray, sensor: Sensor, rng: np.random.Generator) -> FloatArray:
    """Reading of a healthy sensor: the signal with white noise, in steps, up to its maximum."""
    noisy = signal + sensor.noise * rng.standard_normal(signal.size)
    highest = np.inf if sensor.maximum is None else sensor.maximum
    return in_steps(np.minimum(noisy, highest), sensor.resolution)


def in_steps(values: FloatArray, resolution: float) -> FloatArray:
    """Round to whole steps, as the shortest decimal numbers."""
    return np.round(np.rint(values / resolution) * resolution, 6) + 0.0  # no -0.0


def flow_noise_l_per_min(
    leakage_l_per_min: FloatArray, step_s: float, rng: np.random.Generator
) -> FloatArray:
    """Noise of the drain flow in l/min: correlated over some seconds, with white noise on top.

    Its standard deviation is 1.3 % of the leakage itself and 0.3 % of the mean leakage, correlated,
    and 0.5 % of the leakage, white.
    """
    correlated = correlated_noise(rng, leakage_l_per_min.size, step_s, NOISE_TIME_CONSTANT_S)
    white = rng.standard_normal(leakage_l_per_min.size)
    noise = (0.013 * correlated + 0.005 * white) * leakage_l_per_min
    return np.asarray(noise + 0.003 * leakage_l_per_min.mean() * correlated, dtype=np.float64)


def with_faults(
    values: FloatArray, sensor: Sensor, rates: FaultRates, hours: float, rng: np.random.Generator
) -> FloatArray:
    """A channel with spikes, values out of range, values that are not finite, and blanks (NaN)."""
    faulty = values.copy()
    spikes = _some(values.size, rates.spikes * hours, rng)
    signs = rng.choice([-1.0, 1.0], spikes.size)
    heights = sensor.spike * rng.uniform(0.6, 1.6, spikes.size) * signs
    faulty[spikes] = in_steps(values[spikes] + heights, sensor.resolution)
    faulty[_some(values.size, rates.values_out_of_range * hours, rng)] = sensor.error_value
    faulty[_some(values.size, rates.not_finite * hours, rng)] = np.inf
    faulty[_stretches(values.size, hours, rates.blank_stretches, (3.0, 20.0), rng)] = np.nan
    return faulty


def with_frozen(values: FloatArray, first: int, last: int) -> FloatArray:
    """A channel with a sensor that stays at the value of sample `first` until sample `last`."""
    frozen = values.copy()
    frozen[first:last] = values[first]
    return frozen


def with_log_faults(
    recording: Recording, rates: FaultRates, hours: float, rng: np.random.Generator
) -> Recording:
    """A recording without its missing periods, and with some stamps repeated or set back."""
    rows = recording.time_us.size
    absent = _stretches(rows, hours, rates.missing_periods, (20.0, 180.0), rng)
    absent[[0, -1]] = False
    kept = np.flatnonzero(~absent)
    time_us = recording.time_us[kept]
    delays = {name: delay[kept] for name, delay in recording.own_delay_us.items()}
    repeated = 1 + _some(kept.size - 2, rates.disordered_stamps * hours, rng)
    for stamps in (time_us, *delays.values()):
        stamps[repeated] = stamps[repeated - 1]
    set_back = 1 + _some(kept.size - 2, rates.disordered_stamps * hours, rng)
    time_us[set_back] = np.maximum(time_us[set_back] - 3 * MICROSECONDS // 2, time_us[0])
    return replace(
        recording,
        time_us=time_us,
        values={name: values[kept] for name, values in recording.values.items()},
        own_delay_us=delays,
    )


def _some(size: int, expected: float, rng: np.random.Generator) -> NDArray[np.intp]:
    """A random number of random samples."""
    return np.asarray(rng.integers(0, size, rng.poisson(expected)), dtype=np.intp)


def _stretches(
    size: int,
    hours: float,
    per_hour: float,
    seconds: tuple[float, float],
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Mask of random stretches of time; none is longer than a twentieth of the log."""
    inside = np.zeros(size, dtype=np.bool_)
    samples_per_s = size / (3600.0 * hours)
    for first in _some(size, per_hour * hours, rng):
        length = min(int(rng.uniform(*seconds) * samples_per_s), size // 20)
        inside[first : first + length] = True
    return inside

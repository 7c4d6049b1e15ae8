"""Errors of machines and sensors that simulated nights have beside short ones.

As in `pipeline.demo.noise`: functions along the first axis, which is time.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from pipeline.demo.noise import FloatArray, autoregression, phi_of

# Wander of sensors from night to night.
WANDER_PHI: Final = 0.6
WANDER_TEMPERATURE_C: Final = 0.3
WANDER_GAIN: Final = 0.003
WANDER_PRESSURE_BAR: Final = 0.3
# Errors of a drain flow over the flow as on a real record (`benchmarks/results/noise.md`): short
# ones and their φ at 1 Hz, and slow ones with the time over which they forget.
RECORDED_SHORT: Final = 0.013
RECORDED_PHI: Final = 0.4
RECORDED_SLOW: Final = 0.0145
RECORDED_SLOW_S: Final = 600.0


def heavy_tailed(
    generator: np.random.Generator, shape: tuple[int, ...], freedom: float = 4.0
) -> FloatArray:
    """White noise of unit variance with the tails of Student's t; `freedom` above 2."""
    drawn = generator.standard_t(freedom, shape)
    return np.asarray(drawn * np.sqrt((freedom - 2.0) / freedom), dtype=np.float64)


def as_recorded(generator: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Errors at 1 Hz of a drain flow over the flow, as on a real record; of the shape given."""
    short = autoregression(generator.standard_normal(shape), RECORDED_PHI)
    slow = autoregression(generator.standard_normal(shape), phi_of(1.0, RECORDED_SLOW_S))
    return RECORDED_SHORT * short + RECORDED_SLOW * slow


def random_walk(white: FloatArray, step_s: float, after_an_hour: float = 1.0) -> FloatArray:
    """Sum of white noise; `after_an_hour` is its standard deviation after 3600 s, in its unit."""
    walk = np.cumsum(white, axis=0) * (after_an_hour * np.sqrt(step_s / 3600.0))
    return np.asarray(walk, dtype=np.float64)


def warm_up(time_s: FloatArray, at_start: float, time_constant_s: float = 600.0) -> FloatArray:
    """Error that fades as a machine warms up, shape (n,), in the unit of `at_start`."""
    return np.asarray(at_start * np.exp(-time_s / time_constant_s), dtype=np.float64)


def dead_band(
    flow_l_per_min: FloatArray,
    pressure_difference_bar: FloatArray,
    width_l_per_min: float = 0.02,
    below_bar: float = 40.0,
) -> FloatArray:
    """Reading of a flow meter that loses `width_l_per_min` at low pressure and is never below 0.

    Examples
    --------
    >>> dead_band(np.array([0.01, 0.5, 0.5]), np.array([20.0, -39.0, 40.0])).tolist()
    [0.0, 0.48, 0.5]
    """
    lost = np.maximum(flow_l_per_min - width_l_per_min, 0.0)
    return np.where(np.abs(pressure_difference_bar) < below_bar, lost, flow_l_per_min)


def drifting_offset(time_s: FloatArray, drift: float = 0.3) -> FloatArray:
    """Offset that drifts evenly from −drift/2 to drift/2 in the time given, shape (n,)."""
    share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    return np.asarray(drift * (share - 0.5), dtype=np.float64)


def lagging(signal: FloatArray, step_s: float, time_constant_s: float) -> FloatArray:
    """First-order lag behind a signal, settled on its first value: heat behind its sensor."""
    phi = phi_of(step_s, time_constant_s)
    lagged, _ = lfilter([1.0 - phi], [1.0, -phi], signal, axis=0, zi=phi * signal[:1])
    return np.asarray(lagged, dtype=np.float64)


class NightWander(NamedTuple):
    """Errors that sensors keep for a night, shape (nights, ...) each."""

    # temperature_c, pressure_bar: added to the oil temperature and the pressure difference, [°C]
    # and [bar].
    temperature_c: FloatArray
    gain: FloatArray  # relative error of the drain flow, [-]
    pressure_bar: FloatArray


def night_wander(generator: np.random.Generator, shape: tuple[int, ...]) -> NightWander:
    """Wander from night to night: 0.3 °C and 0.3 % with φ = 0.6, 0.3 bar without memory."""

    def remembered() -> FloatArray:
        return autoregression(generator.standard_normal(shape), WANDER_PHI)

    return NightWander(
        temperature_c=WANDER_TEMPERATURE_C * remembered(),
        gain=WANDER_GAIN * remembered(),
        pressure_bar=WANDER_PRESSURE_BAR * generator.standard_normal(shape),
    )

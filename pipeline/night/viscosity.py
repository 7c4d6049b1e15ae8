"""The viscosity of a night's oil as measured: by a sensor in the log, or by analyses of the oil.

Every path's flow is proportional to 1/η, so a measured viscosity scales the columns of a block by
one factor. Blocks are stored with the data sheet's oil and scaled where they are used: an analysis
that is entered late needs no log.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leakage.physics.oil import Oil, density_kg_per_m3
from leakage.physics.walther import kinematic_viscosity_mm2_per_s
from pipeline.arrays import Array, Mask
from pipeline.config import MotorSpec
from pipeline.night.time_base import VISCOSITIES, Samples

# Columns of the statistics that no viscosity scales.
UNDRIVEN = ("one", "measured")
# Share of the kept samples that need a credible viscosity.
LEAST_SHARE = 0.1
# Standard deviation of the temperature below which no change with it is estimated [K].
LEAST_SPREAD_K = 1.0
# A sensor further from the data sheet, by this factor, does not measure this oil.
FURTHEST = 3.0


class SensorRatio(NamedTuple):
    """Logged viscosity over the data sheet's in a night: its median, and its change with heat."""

    log_median: float
    per_kelvin: float
    median_c: float

    def at(self, temperature_c: float) -> float:
        """Return the ratio at a temperature."""
        return math.exp(self.log_median + self.per_kelvin * (temperature_c - self.median_c))


def sensor_ratio(oil: Oil, samples: Samples) -> SensorRatio | str | None:
    """Return logged viscosity over the data sheet's at the logged temperature.

    None where no channel has it; a text says why a channel cannot tell it. The change with
    temperature is that of least squares, drawn to 0 where the night's temperatures hardly differ.
    """
    for name in VISCOSITIES:
        if name not in samples.viscosities:
            continue
        value, celsius = samples.viscosities[name], samples.oil_temperature_c
        known = np.isfinite(value)
        if known.mean() < LEAST_SHARE:
            return f"{name} is credible in only {100 * known.mean():.0f} % of the kept samples"
        value, celsius = value[known], celsius[known]
        if name == "dynamic_viscosity":
            value = 1000.0 * value / density_kg_per_m3(celsius, oil)
        sheet = kinematic_viscosity_mm2_per_s(celsius, oil.walther_a, oil.walther_b)
        log, middle = np.log(value / sheet), float(np.median(celsius))
        median = float(np.median(log))
        if abs(median) > math.log(FURTHEST):
            return (
                f"{name} is {math.exp(median):.3g} times that of {oil.name}: another unit, oil or "
                "place"
            )
        slope = np.cov(log, celsius, bias=True)[0, 1] / (np.var(celsius) + LEAST_SPREAD_K**2)
        return SensorRatio(median, float(slope), middle)
    return None


def viscosity_ratios(
    spec: MotorSpec, night: dt.date, temperature_c: Array, by_sensor: Array
) -> Array | None:
    """Measured viscosity over the data sheet's of a night's blocks, shape (b,); None: not measured.

    `temperature_c` is each block's mean; `by_sensor` is nan where no sensor measured.
    """
    curve = spec.measured_curve(night)
    if curve is None:
        return by_sensor if np.isfinite(by_sensor).any() else None
    oil = spec.oil_on(night).oil()
    sheet = kinematic_viscosity_mm2_per_s(temperature_c, oil.walther_a, oil.walther_b)
    by_analyses = kinematic_viscosity_mm2_per_s(temperature_c, *curve) / sheet
    return np.where(np.isfinite(by_sensor), by_sensor, by_analyses)


def mean_ratio(ratios: Array | None, n: Sequence[int]) -> float | None:
    """Return mean over the samples of a night's blocks; None where the data sheet holds."""
    return None if ratios is None else float(np.average(ratios, weights=np.array(n)))


def driven(columns: Sequence[str]) -> Mask:
    """Return columns of the statistics that are proportional to 1/η."""
    return np.array([name not in UNDRIVEN for name in columns], dtype=np.bool_)

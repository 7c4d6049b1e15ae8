"""From a night's kept samples to the statistics of the blocks of its good parts.

Every path's flow is proportional to 1/η, so a measured viscosity scales the columns of a block by
one factor. Blocks are stored with the data sheet's oil and scaled where they are used: an analysis
that is entered late needs no log.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.blocks import CompressedSamples, compress, split_into_blocks
from leakage.physics.oil import Oil, density_kg_per_m3, kinematic_viscosity_mm2_per_s
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.nights import Night
from pipeline.night.time_base import VISCOSITIES, Insufficient, Samples
from pipeline.schema.fits import INSUFFICIENT_DATA

# Share of the kept samples that need a credible viscosity.
LEAST_SHARE = 0.1
# Standard deviation of the temperature below which no change with it is estimated [K].
LEAST_SPREAD_K = 1.0
# A sensor further from the data sheet, by this factor, does not measure this oil.
FURTHEST = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NightStatistics(CompressedSamples):
    """A night's kept samples with their columns and the statistics of its blocks."""

    samples: Samples  # the kept samples
    conditions: OperatingConditions  # what drives their leakage, shape (n,)

    def with_viscosity(self, ratios: Array | None, columns: Sequence[str]) -> NightStatistics:
        """Return the samples with the oil as measured, by block; None: as on its data sheet."""
        if ratios is None:
            return self
        scale = np.repeat(driven(columns, ratios), [block.n for block in self.blocks], axis=0)
        z = self.z * scale
        unsmoothed = z if self.unsmoothed is self.z else self.unsmoothed * scale
        return replace(self, z=z, unsmoothed=unsmoothed)

    def parts_of(self, rows: NDArray[np.int64]) -> list[str]:
        """Return part of some of the kept samples."""
        ends = np.cumsum([block.n for block in self.blocks])
        return [self.blocks[at].part for at in np.searchsorted(ends, rows, side="right").tolist()]


def night_statistics(
    spec: MotorSpec, motor: Motor, night: Night, samples: Samples, *, is_merged: bool = True
) -> NightStatistics:
    """Return a night's regressors, smoothed if asked for, its blocks and their factors."""
    settings = spec.settings
    conditions = operating_conditions(spec, samples)
    unsmoothed = np.empty((len(samples.index), len(motor.columns)), order="F")
    regressors(motor, conditions, out=unsmoothed[:, :-1])
    unsmoothed[:, -1] = samples.leakage_l_per_min
    by_hand = spec.file.periods.within(night)
    windows = settings.windows.blocks()
    made = compress(
        unsmoothed,
        samples.index,
        samples.period_us,
        split_into_blocks(samples.time_us, night.start_us, windows, by_hand),
        maximum_blocks=windows.maximum_blocks if is_merged else len(samples.index),
        smoothing_s=settings.smoothing.window_s,
    )
    return NightStatistics(
        **{field.name: getattr(made, field.name) for field in fields(made)},
        samples=samples,
        conditions=conditions,
    )


def operating_conditions(spec: MotorSpec, samples: Samples) -> OperatingConditions:
    """Return conditions of the kept samples that drive the leakage, from one side or from both."""
    return OperatingConditions.from_bar(
        np.abs(samples.pressure_difference_bar),
        samples.oil_temperature_c,
        np.abs(samples.speed_rpm),
        charge_over_case_bar(samples) if spec.settings.model.two_sided else None,
    )


def charge_over_case_bar(samples: Samples) -> Array:
    """Return charge above case pressure by the channels that know it; 0 for those that do not."""
    known, none = samples.low_pressures_bar, np.zeros(len(samples.index))
    low = none
    if (low_port := known.get("low_port_pressure")) is not None:
        # Under back-drive the ports change sides.
        low = low_port + np.minimum(samples.pressure_difference_bar, 0.0)
    charge, case = known.get("charge_pressure", low), known.get("case_pressure", none)
    difference: Array = np.maximum(charge - case, 0.0)
    return difference


class SensorRatio(NamedTuple):
    """Logged viscosity over the data sheet's in a night: its median, and its change with heat."""

    log_median: float
    per_kelvin: float
    median_c: float

    def at(self, temperature_c: float) -> float:
        """Return the ratio at a temperature."""
        return math.exp(self.log_median + self.per_kelvin * (temperature_c - self.median_c))


def sensor_ratio(oil: Oil, samples: Samples) -> SensorRatio | None:
    """Return logged viscosity over the data sheet's; None where no channel has it.

    The change with temperature is that of least squares, drawn to 0 where temperatures hardly
    differ.
    """
    for name in VISCOSITIES:
        if name not in samples.viscosities:
            continue
        value, celsius = samples.viscosities[name], samples.oil_temperature_c
        known = np.isfinite(value)
        if known.mean() < LEAST_SHARE:
            share = f"{100 * known.mean():.0f} %"
            raise _without_viscosity(f"{name} is credible in only {share} of the kept samples")
        value, celsius = value[known], celsius[known]
        if name == "dynamic_viscosity":
            value = 1000.0 * value / density_kg_per_m3(celsius, oil)
        sheet = kinematic_viscosity_mm2_per_s(celsius, oil.walther_a, oil.walther_b)
        log, middle = np.log(value / sheet), float(np.median(celsius))
        median = float(np.median(log))
        if abs(median) > math.log(FURTHEST):
            factor = f"{math.exp(median):.3g} times that of {oil.name}"
            raise _without_viscosity(f"{name} is {factor}: another unit, oil or place")
        slope = np.cov(log, celsius, bias=True)[0, 1] / (np.var(celsius) + LEAST_SPREAD_K**2)
        return SensorRatio(median, float(slope), middle)
    return None


def _without_viscosity(why: str) -> Insufficient:
    how = "without this channel in the motor's file the data sheet holds"
    return Insufficient(INSUFFICIENT_DATA, f"{why}; {how}")


def driven(columns: Sequence[str], ratios: Array) -> Array:
    """Return factors on blocks' columns, shape (b, c), by measured viscosity over the sheet's."""
    is_driven = np.array([name not in ("one", "measured") for name in columns])
    return np.where(is_driven, 1.0 / ratios[:, None], 1.0)

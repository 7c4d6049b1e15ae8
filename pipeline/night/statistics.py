"""From a night's kept samples to the statistics of the blocks of its good parts.

Every path's flow is proportional to 1/η, so a measured viscosity scales the columns of a block by
a factor. Blocks are stored with the data sheet's oil and scaled where they are used: an analysis
that is entered late needs no log.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.block_fit import SampleBlocks
from leakage.estimation.blocks import (
    TRAINING,
    CompressedSamples,
    compress,
    merge,
    places_on_clock,
    split_into_blocks,
)
from leakage.estimation.identifiability import Excitation
from leakage.physics.oil import Oil, density_kg_per_m3, kinematic_viscosity_mm2_per_s
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.nights import Night
from pipeline.night.time_base import VISCOSITIES, Insufficient, Samples
from pipeline.schema import BLOCKS, INSUFFICIENT_DATA, Row, staged_table

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
        scale = np.repeat(
            viscosity_factors(columns, ratios), [block.n for block in self.blocks], axis=0
        )
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
    """Return a night's regressors, smoothed if asked for, its blocks and their factors.

    Raises ValidityError if the oil's viscosity is not known at a temperature.
    """
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

    Raises Insufficient where the channel cannot tell it.
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


def viscosity_factors(columns: Sequence[str], ratios: Array) -> Array:
    """Return factors on blocks' columns, shape (b, c), by measured viscosity over the sheet's."""
    is_driven = np.array([name not in ("one", "measured") for name in columns])
    return np.where(is_driven, 1.0 / ratios[:, None], 1.0)


CHANNELS = ("pressure_bar", "temperature_c", "speed_rpm")
# Columns of `blocks` that a fit needs.
BLOCK_COLUMNS = (
    "motor_id",
    "night",
    "block_start",
    "block_end",
    "part",
    "n",
    "factor_columns",
    "factor",
    "model_hash",
    "viscosity_ratio",
    "mean_charge_over_case_bar",
    *(f"{end}_{name}" for name in CHANNELS for end in ("mean", "minimum", "maximum")),
)


def block_frame(rows: Sequence[Row]) -> pl.DataFrame:
    """Return rows of `blocks` as they will be stored."""
    blocks = pl.from_arrow(staged_table(BLOCKS, rows))
    assert isinstance(blocks, pl.DataFrame)
    return blocks


@dataclass(frozen=True, slots=True)
class StoredBlocks:
    """Blocks in order of time."""

    rows: pl.DataFrame  # their `BLOCK_COLUMNS`
    factors: Array  # their triangular factors, shape (b, c, c)
    # Measured viscosity over the data sheet's, shape (b,); None where it is the data sheet's.
    viscosity_ratios: Array | None

    @classmethod
    def of(cls, spec: MotorSpec, rows: pl.DataFrame, columns: Sequence[str]) -> StoredBlocks | None:
        """Return blocks of a night's rows; None where any is of a model with other columns."""
        if rows["factor_columns"].to_list() != [list(columns)] * rows.height:
            return None
        size = len(columns)
        factors = np.zeros((rows.height, size, size))
        if rows.height:
            upper = rows["factor"].explode().to_numpy().reshape(rows.height, -1)
            factors[(slice(None), *np.triu_indices(size))] = upper
        ratios = None
        if rows.height:
            by_sensor = rows["viscosity_ratio"].cast(pl.Float64).to_numpy()
            celsius = rows["mean_temperature_c"].to_numpy()
            ratios = _viscosity_ratios(spec, rows["night"][0], celsius, by_sensor)
        if ratios is not None:
            factors = factors * viscosity_factors(columns, ratios)[:, None]
        return cls(rows, factors, ratios)

    def factor_of(self, part: str) -> Array:
        """Return factor of all blocks of the training or the validation samples, shape (c, c)."""
        return merge(self.factors[(self.rows["part"] == part).to_numpy()])

    def sample_blocks(self) -> SampleBlocks:
        """Return all that a fit needs of them."""
        begins, ends = (
            self.rows[name].to_physical().to_numpy() for name in ("block_start", "block_end")
        )
        return SampleBlocks(
            self.factors,
            *places_on_clock(begins, ends),
            (self.rows["part"] == TRAINING).to_numpy(),
            self.block_means(),
            Excitation(*map(self.span, CHANNELS)),
        )

    @property
    def viscosity_ratio(self) -> float | None:
        """Mean of the measured viscosity over the data sheet's; None where that holds."""
        ratios = self.viscosity_ratios
        return (
            None if ratios is None else float(np.average(ratios, weights=self.rows["n"].to_numpy()))
        )

    @property
    def charge_bar(self) -> float | None:
        """Mean charge above case pressure; None in a model of one side."""
        name = "mean_charge_over_case_bar"
        return None if self.rows[name].null_count() else self._mean(name)

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last [s]."""
        first, last = self.rows["block_start"].min(), self.rows["block_end"].max()
        assert isinstance(first, dt.datetime)
        assert isinstance(last, dt.datetime)
        return (last - first).total_seconds()

    def span(self, channel: str) -> tuple[float, float]:
        """Return lowest and highest reading of a channel."""
        low = self.rows[f"minimum_{channel}"].to_numpy().min()
        return float(low), float(self.rows[f"maximum_{channel}"].to_numpy().max())

    def block_means(self) -> Array:
        """Mean temperature [°C], pressure [bar] and speed [rpm] of each block, shape (b, 3)."""
        names = ("mean_temperature_c", "mean_pressure_bar", "mean_speed_rpm")
        return np.column_stack([self.rows[name].to_numpy() for name in names])

    def means(self) -> tuple[float, float, float]:
        """Mean pressure difference [bar], temperature [°C] and speed [rpm] of the samples."""
        pressure, temperature, speed = (self._mean(f"mean_{name}") for name in CHANNELS)
        return pressure, temperature, speed

    def _mean(self, name: str) -> float:
        """Return mean of a column over the samples."""
        weights = self.rows["n"].cast(pl.Float64)
        return float(np.average(self.rows[name].to_numpy(), weights=weights))


def _viscosity_ratios(
    spec: MotorSpec, night: dt.date, temperature_c: Array, by_sensor: Array
) -> Array | None:
    """Return measured viscosity over the data sheet's by block; None where nothing measured it."""
    curve = spec.measured_curve(night)
    if curve is None:
        return by_sensor if np.isfinite(by_sensor).any() else None
    oil = spec.oil_on(night).oil()
    sheet = kinematic_viscosity_mm2_per_s(temperature_c, oil.walther_a, oil.walther_b)
    by_analyses = kinematic_viscosity_mm2_per_s(temperature_c, *curve) / sheet
    return np.where(np.isfinite(by_sensor), by_sensor, by_analyses)

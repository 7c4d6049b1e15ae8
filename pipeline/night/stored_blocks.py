"""Blocks of samples of `blocks`, with the oil as measured."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from leakage.estimation.block_fit import SampleBlocks
from leakage.estimation.blocks import TRAINING, merge, places_on_clock
from leakage.estimation.identifiability import Excitation
from leakage.physics.oil import kinematic_viscosity_mm2_per_s
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.night.statistics import driven
from pipeline.schema import BLOCKS, staged_table

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
        return cls._scaled(spec, rows, factors, columns)

    @classmethod
    def of_newest_night(
        cls, spec: MotorSpec, rows: Sequence[dict[str, Any]], factors: Array
    ) -> StoredBlocks:
        """Return blocks that are about to be stored."""
        stored = pl.from_arrow(staged_table(BLOCKS, rows))
        assert isinstance(stored, pl.DataFrame)
        return cls._scaled(spec, stored, factors, rows[0]["factor_columns"])

    @classmethod
    def _scaled(
        cls, spec: MotorSpec, rows: pl.DataFrame, factors: Array, columns: Sequence[str]
    ) -> StoredBlocks:
        ratios = None
        if rows.height:
            by_sensor = rows["viscosity_ratio"].cast(pl.Float64).to_numpy()
            celsius = rows["mean_temperature_c"].to_numpy()
            ratios = _viscosity_ratios(spec, rows["night"][0], celsius, by_sensor)
        if ratios is not None:
            factors = factors * driven(columns, ratios)[:, None]
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

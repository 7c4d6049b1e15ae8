"""Blocks of samples as `block_statistics` holds them: tonight's, or those of nights before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.block_statistics import merge, with_free_known
from leakage.slow_errors import ShortBlocks, short_blocks
from pipeline.schema import BLOCK_STATISTICS

Array = NDArray[np.float64]

CHANNELS = ("pressure_bar", "temperature_c", "speed_rpm")
# Columns of `block_statistics` that a fit needs.
BLOCK_COLUMNS = (
    "motor_id",
    "night",
    "block_start",
    "block_end",
    "part",
    "n",
    "columns",
    "statistics",
    "model_hash",
    "short_means",
    *(f"{end}_{name}" for name in CHANNELS for end in ("mean", "minimum", "maximum")),
)


@dataclass(frozen=True, slots=True)
class StoredBlocks:
    """Blocks in order of time.

    Attributes
    ----------
    rows
        Their `BLOCK_COLUMNS`.
    factors
        Their triangular factors, shape (b, c, c).
    """

    rows: pl.DataFrame
    factors: Array

    @classmethod
    def of(cls, rows: pl.DataFrame, columns: Sequence[str]) -> StoredBlocks | None:
        """Blocks of rows; None where one is of a model with other columns."""
        names = "\0".join(columns)
        if not (rows["columns"].list.join("\0") == names).all():
            return None
        size = len(columns)
        factors = np.zeros((rows.height, size, size))
        if rows.height:
            upper = rows["statistics"].explode().to_numpy().reshape(rows.height, -1)
            factors[(slice(None), *np.triu_indices(size))] = upper
        return cls(rows, factors)

    @classmethod
    def of_tonight(cls, rows: Sequence[dict[str, Any]], factors: Array) -> StoredBlocks:
        """Blocks that are about to be stored."""
        schema = BLOCK_STATISTICS.schema
        wanted = {name: schema[name] for name in BLOCK_COLUMNS}
        return cls(pl.DataFrame(rows, schema=wanted), factors)

    def with_free_known(self, place: int, coefficient: float) -> StoredBlocks:
        """The blocks with the known flow as a path of its own, short means as well."""
        size = self.factors.shape[2] + 1
        shorts = []
        for values in self.rows["short_means"].to_list():
            # Place and number of samples come before the columns.
            part = np.reshape(values or (), (-1, size)).astype(np.float64)
            part = np.insert(part, 2 + place, part[:, -2] / coefficient, axis=1)
            part[:, -2] = 0.0
            shorts.append(part.ravel().tolist() or None)
        column = pl.Series("short_means", shorts, dtype=self.rows.schema["short_means"])
        moved = with_free_known(self.factors, place, coefficient)
        return StoredBlocks(self.rows.with_columns(column), moved)

    def part(self, part: str) -> StoredBlocks:
        """Blocks of the training or the validation samples."""
        chosen = self.rows["part"] == part
        return StoredBlocks(self.rows.filter(chosen), self.factors[chosen.to_numpy()])

    def factor_of(self, part: str) -> Array:
        """Factor of all blocks of a part, shape (c, c)."""
        return merge(self.part(part).factors)

    def short_blocks(self, block_s: float) -> ShortBlocks:
        """Short blocks that these were merged from; themselves where they were not.

        Parameters
        ----------
        block_s
            Length of a short block [s].
        """
        start_us = self.rows["block_start"].dt.timestamp("us").to_numpy()
        number = np.round((start_us - start_us[:1]) / (1e6 * block_s)).astype(np.int64)
        whole = short_blocks(self.factors, number)
        inside = self.rows["short_means"].to_list()
        if not any(inside):
            return whole
        size = self.factors.shape[2] + 1
        parts = []
        for place, values in enumerate(inside):
            if values:
                part = np.reshape(values, (-1, size)).astype(np.float64)
                part[:, 0] += number[place]
            else:
                means = np.delete(whole.means[place], -3)
                part = np.array([[number[place], whole.n[place], *means]])
            parts.append(part)
        table = np.concatenate(parts)
        return ShortBlocks(
            table[:, 1],
            np.insert(table[:, 2:], size - 3, 1.0, axis=1),
            table[:, 0].astype(np.int64),
            np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        )

    @property
    def n_samples(self) -> int:
        return int(self.rows["n"].sum())

    def span(self, channel: str) -> tuple[float, float]:
        """Lowest and highest reading of a channel."""
        low = self.rows[f"minimum_{channel}"].to_numpy().min()
        return float(low), float(self.rows[f"maximum_{channel}"].to_numpy().max())

    def block_means(self) -> Array:
        """Mean temperature [°C], pressure [bar] and speed [rpm] of each block, shape (b, 3)."""
        names = ("mean_temperature_c", "mean_pressure_bar", "mean_speed_rpm")
        means: Array = self.rows.select(names).to_numpy()
        return means

    def means(self) -> tuple[float, float, float]:
        """Mean pressure difference [bar], temperature [°C] and speed [rpm] of the samples."""
        weights = self.rows["n"].cast(pl.Float64).to_numpy()
        pressure, temperature, speed = (
            float(np.average(self.rows[f"mean_{name}"].to_numpy(), weights=weights))
            for name in CHANNELS
        )
        return pressure, temperature, speed

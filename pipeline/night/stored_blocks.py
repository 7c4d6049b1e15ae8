"""The published blocks of a motor's nights, as arrays."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.night.windows import TRAINING

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
    *(f"{end}_{name}" for name in CHANNELS for end in ("mean", "minimum", "maximum")),
)


def have_columns(blocks: pl.DataFrame, columns: Collection[str]) -> bool:
    """Whether all blocks are of a model with these columns."""
    names = "\0".join(columns)
    return bool((blocks["columns"].list.join("\0") == names).all())


def of_part(blocks: pl.DataFrame, part: str) -> pl.DataFrame:
    """Blocks of the training or the validation samples."""
    return blocks.filter(pl.col("part") == part)


def triangular_factors(blocks: pl.DataFrame, size: int) -> Array:
    """Triangular factors of blocks in their order, shape (b, size, size)."""
    factors = np.zeros((blocks.height, size, size))
    if blocks.height:
        upper = blocks["statistics"].explode().to_numpy().reshape(blocks.height, -1)
        factors[(slice(None), *np.triu_indices(size))] = upper
    return factors


def span(blocks: pl.DataFrame, channel: str) -> tuple[float, float]:
    """Lowest and highest reading of a channel."""
    low, high = blocks[f"minimum_{channel}"].to_numpy(), blocks[f"maximum_{channel}"].to_numpy()
    return float(low.min()), float(high.max())


def block_length_s(blocks: pl.DataFrame) -> float:
    """Median length of blocks [s]."""
    lengths = (blocks["block_end"] - blocks["block_start"]).dt.total_microseconds().to_numpy()
    return float(np.median(lengths)) / 1e6


def training_of(blocks: pl.DataFrame) -> pl.DataFrame:
    """Blocks of the training samples."""
    return of_part(blocks, TRAINING)

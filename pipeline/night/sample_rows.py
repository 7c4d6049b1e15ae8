"""Rows of a night's samples: what was refused, statistics by block, points for the plots."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage import Motor
from leakage.physics.motor import speed_beyond_curve
from pipeline.clock import utc
from pipeline.night.block_fit import BlockFit
from pipeline.night.operation_rows import coarse_histogram
from pipeline.night.statistics import NightStatistics
from pipeline.night.time_base import Quality
from pipeline.night.viscosity import SensorRatio
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C
from pipeline.thinning import keep_extremes

Array = NDArray[np.float64]
Row = dict[str, Any]
Columns = dict[str, Sequence[Any]]

# Points a night in the table of predictions: enough for a plot, not for an analysis.
PREDICTION_POINTS = 720


def quality_rows(motor_id: str, night: dt.date, found: Sequence[Quality]) -> list[Row]:
    """Rows of `quality`: every rule that was applied, those that refused nothing too."""
    return [
        {
            "motor_id": motor_id,
            "night": night,
            "channel": one.channel,
            "reason": one.reason,
            "n_samples": one.n_samples,
            "n_refused": one.n_refused,
            "n_noted": one.n_noted,
        }
        for one in found
    ]


def statistics_rows(
    motor_id: str,
    night: dt.date,
    motor: Motor,
    statistics: NightStatistics,
    viscosity: SensorRatio | None = None,
) -> list[Row]:
    """Rows of `block_statistics`, with the viscosity by the log over the data sheet's."""
    samples, blocks = statistics.samples, statistics.blocks
    first_rows = np.array([block.first_row for block in blocks])
    sizes = np.array([block.n for block in blocks])
    n_reversed = np.add.reduceat(samples.speed_rpm < 0, first_rows, dtype=np.int64)
    n_beyond = np.add.reduceat(
        speed_beyond_curve(motor, samples.speed_rpm), first_rows, dtype=np.int64
    )
    upper = np.triu_indices(statistics.factors.shape[-1])
    columns: Columns = {
        "block_start": [utc(block.start_us) for block in blocks],
        "block_end": [utc(block.end_us) for block in blocks],
        "part": [block.part for block in blocks],
        "n": sizes.tolist(),
        "statistics": statistics.factors[:, *upper].tolist(),
        "share_reversed": (n_reversed / sizes).tolist(),
        "n_beyond_curve": n_beyond.tolist(),
        "short_means": statistics.short_means,
    }
    for name, unit, values, edges in (
        ("pressure", "bar", np.abs(samples.pressure_difference_bar), PRESSURE_EDGES_BAR),
        ("temperature", "c", samples.oil_temperature_c, TEMPERATURE_EDGES_C),
        ("speed", "rpm", np.abs(samples.speed_rpm), SPEED_EDGES_RPM),
    ):
        columns |= _spread(name, unit, values, first_rows, edges)
    if viscosity is not None:
        columns["viscosity_ratio"] = [viscosity.at(one) for one in columns["mean_temperature_c"]]
    shared = {
        "motor_id": motor_id,
        "night": night,
        "columns": list(motor.columns),
        "model_hash": statistics.model_hash,
    }
    return _rows(columns, shared)


def _rows(columns: Columns, shared: Mapping[str, Any]) -> list[Row]:
    """Rows of columns, and of values that all rows share."""
    return [
        {**shared, **dict(zip(columns, values, strict=True))}
        for values in zip(*columns.values(), strict=True)
    ]


def _spread(
    name: str, unit: str, values: Array, first_rows: NDArray[np.int64], edges: tuple[float, ...]
) -> Columns:
    """Means, limits and coarse histograms of a channel by block."""
    blocks = np.split(values, first_rows[1:])
    return {
        f"mean_{name}_{unit}": [float(block.mean()) for block in blocks],
        f"minimum_{name}_{unit}": np.minimum.reduceat(values, first_rows).tolist(),
        f"maximum_{name}_{unit}": np.maximum.reduceat(values, first_rows).tolist(),
        f"{name}_histogram": [coarse_histogram(block, edges) for block in blocks],
    }


def prediction_rows(
    motor_id: str, night: dt.date, statistics: NightStatistics, modes: Sequence[BlockFit]
) -> list[Row]:
    """Rows of `predictions`: thinned kept samples, extremes among them, measured and predicted."""
    samples, z = statistics.samples, statistics.z
    pressure, speed = np.abs(samples.pressure_difference_bar), np.abs(samples.speed_rpm)
    # Not the error of the fit: its last bits would choose among samples that are alike.
    error = z[:, -1] - z[:, :-1] @ np.append(modes[0].stated.training.coefficients, 1.0)
    chosen = keep_extremes([z[:, -1], error, pressure, speed], PREDICTION_POINTS)
    z = z[chosen]
    columns: Columns = {
        "time": [utc(stamp) for stamp in samples.time_us[chosen].tolist()],
        "part": statistics.parts_of(chosen),
        "pressure_difference_bar": pressure[chosen].tolist(),
        "oil_temperature_c": samples.oil_temperature_c[chosen].tolist(),
        "speed_rpm": speed[chosen].tolist(),
        "measured_l_per_min": z[:, -1].tolist(),
    }
    rows: list[Row] = []
    for mode in modes:
        predicted = z[:, :-1] @ np.append(mode.stated.training.coefficients, 1.0)
        shared = {"motor_id": motor_id, "night": night, "flushing_mode": mode.name}
        rows += _rows(columns | {"predicted_l_per_min": predicted.tolist()}, shared)
    return rows

"""Rows of a night's samples: what was refused, statistics by block, points for the plots."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat
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
    speed = statistics.conditions.speed_rpm
    rows = [slice(block.first_row, block.end_row) for block in blocks]
    upper = np.triu_indices(statistics.factors.shape[-1])
    columns: Columns = {
        "block_start": [utc(block.start_us) for block in blocks],
        "block_end": [utc(block.end_us) for block in blocks],
        "part": [block.part for block in blocks],
        "n": [block.n for block in blocks],
        "statistics": statistics.factors[:, *upper].tolist(),
        "share_reversed": [
            np.count_nonzero(samples.speed_rpm[one] < 0) / block.n
            for one, block in zip(rows, blocks, strict=True)
        ],
    }
    pressure, temperature = samples.pressure_difference_bar, samples.oil_temperature_c
    for name, unit, parts, edges in (
        ("pressure", "bar", (np.abs(pressure[one]) for one in rows), PRESSURE_EDGES_BAR),
        ("temperature", "c", (temperature[one] for one in rows), TEMPERATURE_EDGES_C),
        ("speed", "rpm", (speed[one] for one in rows), SPEED_EDGES_RPM),
    ):
        columns |= _spread(name, unit, parts, edges)
    # Only where the slowest or the fastest sample is beyond the curve can others be.
    slowest, fastest = (
        speed_beyond_curve(motor, columns[f"{limit}_speed_rpm"]) for limit in ("minimum", "maximum")
    )
    columns["n_beyond_curve"] = [
        int(np.count_nonzero(speed_beyond_curve(motor, speed[one]))) if beyond else 0
        for one, beyond in zip(rows, slowest | fastest, strict=True)
    ]
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
    n = len(next(iter(columns.values())))
    every = {name: repeat(value, n) for name, value in shared.items()} | columns
    return [dict(zip(every, values, strict=True)) for values in zip(*every.values(), strict=True)]


def _spread(name: str, unit: str, parts: Iterable[Array], edges: tuple[float, ...]) -> Columns:
    """Means, limits and coarse histograms of a channel by block."""
    # Block by block: all figures of one while it is in the cache.
    figures = [
        (part.sum() / len(part), part.min(), part.max(), coarse_histogram(part, edges))
        for part in parts
    ]
    means, lowest, highest, histograms = zip(*figures, strict=True)
    return {
        f"mean_{name}_{unit}": [*map(float, means)],
        f"minimum_{name}_{unit}": [*map(float, lowest)],
        f"maximum_{name}_{unit}": [*map(float, highest)],
        f"{name}_histogram": histograms,
    }


def prediction_rows(
    motor_id: str,
    night: dt.date,
    statistics: NightStatistics,
    modes: Sequence[BlockFit],
    error: Array,
) -> list[Row]:
    """Rows of `predictions`: thinned kept samples, extremes among them, measured and predicted.

    `error` has the errors of the first mode.
    """
    samples, z = statistics.samples, statistics.z
    pressure, speed = np.abs(samples.pressure_difference_bar), statistics.conditions.speed_rpm
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

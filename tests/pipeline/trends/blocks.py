"""Blocks of poor nights of made-up motors, whose samples a test can see as well."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.estimation.block_statistics import factors
from pipeline.night.rows import upper_triangle
from pipeline.schema import BLOCK_STATISTICS, frame
from pipeline.trends.nights.from_tables import add_blocks
from pipeline.trends.nights.history import History
from tests.pipeline.trends.nights import Nights, night_of

Array = NDArray[np.float64]

BLOCK_S, PERIOD_S = 120.0, 1.0
SAMPLES = round(BLOCK_S / PERIOD_S)
# 24 minutes for training, and 6 for validation.
TRAINING, VALIDATION = 12, 3
NOISE = 0.02
# What `fits` says of a night with so few samples.
POOR: dict[str, Any] = {
    "n_training": TRAINING * SAMPLES,
    "sample_period_s": PERIOD_S,
    "n_interval_blocks": None,
    "coefficient_covariance_root": None,
    "interval_status": "24.0 minutes of training samples; an interval needs 30",
    "reference_verdict": "no_interval",
    "reference_reason": "24.0 minutes of training samples; an interval needs 30",
    "reference_leakage_l_per_min": None,
}
CHANNELS = ("pressure_bar", "temperature_c", "speed_rpm")


def conditions_of(place: int) -> Array:
    """Pressure, temperature and speed of the samples of a night, shape (3, n)."""
    generator = np.random.default_rng(1000 + place)
    n = (TRAINING + VALIDATION) * SAMPLES
    return np.array(
        [
            generator.uniform(10.0, 300.0, n),
            generator.uniform(41.0, 59.0, n),
            generator.uniform(4.0, 95.0, n),
        ]
    )


_COLUMNS: dict[tuple[int, str, str], Array] = {}


def samples_of(nights: Nights, place: int, theta: Array) -> Array:
    """Columns and measured flow of the samples of a night, shape (n, c)."""
    spec = nights.spec
    key = (place, spec.file.oil_on(night_of(place)), nights.mode)
    if key not in _COLUMNS:
        conditions = OperatingConditions.from_bar(*conditions_of(place))
        _COLUMNS[key] = regressors(spec.motor(night_of(place), nights.mode), conditions)
    z = _COLUMNS[key]
    noise = NOISE * np.random.default_rng(2000 + place).standard_normal(len(z))
    flow = z @ np.append(theta, 1.0) + noise
    return np.column_stack([z, flow])


def blocks_of(nights: Nights) -> pl.DataFrame:
    """Rows of `block_statistics` of a motor's poor nights."""
    truth = nights.truth()
    rows = [
        row
        for place in sorted(nights.changes)
        if place not in nights.absent
        for row in _blocks(nights, place, samples_of(nights, place, truth[place]))
    ]
    return frame(BLOCK_STATISTICS, rows).sort("block_start")


def with_blocks(found: History, blocks: pl.DataFrame) -> History:
    """A history whose nights without a fit know their blocks."""
    records = found.records.copy()
    add_blocks(found.spec, found.layout, records, blocks)
    return replace(found, records=records)


def _blocks(nights: Nights, place: int, z: Array) -> list[dict[str, Any]]:
    spec, label = nights.spec, night_of(place)
    n_blocks = TRAINING + VALIDATION
    upper = factors(z, np.arange(0, len(z) + 1, SAMPLES))
    seen = conditions_of(place).reshape(3, n_blocks, SAMPLES)
    start = dt.datetime.combine(label - dt.timedelta(days=1), dt.time(22), dt.UTC)
    columns = list(spec.motor(label, nights.mode).columns)
    rows = []
    for number in range(n_blocks):
        begin = start + number * dt.timedelta(seconds=BLOCK_S)
        row = {
            "run_id": "made",
            "motor_id": spec.motor_id,
            "night": label,
            "block_start": begin,
            "block_end": begin + dt.timedelta(seconds=BLOCK_S),
            "part": "training" if number < TRAINING else "validation",
            "n": SAMPLES,
            "columns": columns,
            "statistics": upper_triangle(upper[number]),
            "model_hash": f"hash-{spec.file.oil_on(label)}",
        }
        for channel, values in zip(CHANNELS, seen[:, number], strict=True):
            row[f"mean_{channel}"] = float(values.mean())
            row[f"minimum_{channel}"] = float(values.min())
            row[f"maximum_{channel}"] = float(values.max())
        rows.append(row)
    return rows

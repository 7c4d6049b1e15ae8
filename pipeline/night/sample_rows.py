"""Rows of a night's samples: how the motor was run, what was refused, blocks, points for plots."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat
from typing import Any

import numpy as np
import polars as pl
from scipy.special import ndtri

from leakage import Motor
from pipeline.arrays import Array, keep_extremes
from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.config.hashes import model_hash
from pipeline.config.nights import Night
from pipeline.ingest import RawChannel
from pipeline.night.fit import BlockFit
from pipeline.night.statistics import NightStatistics, SensorRatio, charge_over_case_bar
from pipeline.night.time_base import Quality, Samples
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C, Row

HOUR_US = 3_600_000_000
# Standard errors from the middle of a 95 % interval to its ends.
HALF = float(ndtri(0.975))
# Conditions that vary by less tell nothing: the 5th to 95th percentile beside the median, and [K].
VARIES, VARIES_K = 0.3, 4.0
# Ranks of a flow and of what drives it agree at least so far, with noise and dead time.
FOLLOWS = 0.2
FEWEST_RANKED, MOST_RANKED = 200, 20_000


def data_columns(night: Night, samples: Samples, counter: RawChannel | None) -> Row:
    """Return columns of `nights` that a night's samples fill, fitted or not."""
    row: Row = {"logged_hours": samples.n_logged * samples.period_us / HOUR_US}
    counted = hours_counted(counter)
    if counted is not None:
        row["running_hours"] = counted
    elif samples.n_logged:
        hours = (night.end_us - night.start_us) / HOUR_US
        row["running_hours"] = samples.n_turning / samples.n_logged * hours
    for name, unit, zero in (
        ("pressure_zero", "bar", samples.pressure_zero),
        ("flow_zero", "l_per_min", samples.flow_zero),
    ):
        if zero is not None:
            row[f"{name}_{unit}"] = zero.value
            if zero.standard_error is not None:
                row[f"{name}_lower"] = zero.value - HALF * zero.standard_error
                row[f"{name}_upper"] = zero.value + HALF * zero.standard_error
    if len(samples.index):
        row |= conditions(samples)
    return row


def hours_counted(counter: RawChannel | None) -> float | None:
    """Return hours that a counter of running hours went on in a night; None if it cannot tell."""
    if counter is None:
        return None
    reading = counter.value[np.argsort(counter.time_us, kind="stable")]
    reading = reading[np.isfinite(reading)]
    # A counter that goes back was exchanged or misread.
    if len(reading) < 2 or (np.diff(reading) < 0).any():
        return None
    return float(reading[-1] - reading[0])


def conditions(samples: Samples) -> Row:
    """Return span and means of kept samples; magnitudes of pressure and speed."""
    speed = samples.speed_rpm
    return {
        "first_sample": utc(samples.time_us[0]),
        "last_sample": utc(samples.time_us[-1]),
        "kept_percent": 100.0 * samples.kept_share,
        "reversed_percent": 100.0 * np.count_nonzero(speed < 0) / len(speed),
        "mean_pressure_bar": float(np.abs(samples.pressure_difference_bar).mean()),
        "mean_temperature_c": float(samples.oil_temperature_c.mean()),
        "mean_speed_rpm": float(np.abs(speed).mean()),
        "mean_drain_flow_l_per_min": float(samples.leakage_l_per_min.mean()),
        "drain_delay_s": samples.delay_s,
    }


def coarse_histograms(
    values: Array, edges: tuple[float, ...], rows: Sequence[slice]
) -> list[list[int]]:
    """Return samples of some rows in each bin; the end bins hold all beyond."""
    bins = np.searchsorted(edges[1:-1], values, side="right")
    return [np.bincount(bins[row], minlength=len(edges) - 1).tolist() for row in rows]


Columns = dict[str, Sequence[Any]]

# Points a night in the table of predictions: enough for a plot, not for an analysis.
PREDICTION_POINTS = 720


def quality_rows(motor_id: str, night: dt.date, qualities: Sequence[Quality]) -> list[Row]:
    """Return rows of `quality`: every rule that was applied, those that refused nothing too."""
    own = {"motor_id": motor_id, "night": night}
    return [own | rule._asdict() for rule in qualities]


def block_rows(
    spec: MotorSpec,
    night: dt.date,
    motor: Motor,
    statistics: NightStatistics,
    viscosity: SensorRatio | None = None,
) -> list[Row]:
    """Return rows of `blocks`, with the viscosity by the log over the data sheet's."""
    samples, blocks = statistics.samples, statistics.blocks
    speed = statistics.conditions.speed_rpm
    rows = [slice(block.first_row, block.end_row) for block in blocks]
    upper = np.triu_indices(statistics.factors.shape[-1])
    columns: Columns = {
        "block_start": [utc(block.start_us) for block in blocks],
        "block_end": [utc(block.end_us) for block in blocks],
        "part": [block.part for block in blocks],
        "n": [block.n for block in blocks],
        "factor": statistics.factors[:, *upper].tolist(),
        "reversed_percent": [
            100.0 * np.count_nonzero(samples.speed_rpm[row] < 0) / block.n
            for row, block in zip(rows, blocks, strict=True)
        ],
    }
    pressure, temperature = samples.pressure_difference_bar, samples.oil_temperature_c
    for name, unit, values, edges in (
        ("pressure", "bar", np.abs(pressure), PRESSURE_EDGES_BAR),
        ("temperature", "c", temperature, TEMPERATURE_EDGES_C),
        ("speed", "rpm", speed, SPEED_EDGES_RPM),
    ):
        columns |= _spread(name, unit, values, rows, edges)
    if spec.settings.model.two_sided:
        charge = charge_over_case_bar(samples)
        columns["mean_charge_over_case_bar"] = [float(charge[row].mean()) for row in rows]
    if viscosity is not None:
        columns["viscosity_ratio"] = [
            viscosity.at(column) for column in columns["mean_temperature_c"]
        ]
    shared = {
        "motor_id": spec.motor_id,
        "night": night,
        "factor_columns": list(motor.columns),
        "model_hash": model_hash(spec, motor, night),
    }
    return _rows(columns, shared)


def _rows(columns: Columns, shared: Mapping[str, Any]) -> list[Row]:
    """Return rows of columns, and of values that all rows share."""
    n = len(next(iter(columns.values())))
    every = {name: repeat(value, n) for name, value in shared.items()} | columns
    return [dict(zip(every, values, strict=True)) for values in zip(*every.values(), strict=True)]


def _spread(
    name: str, unit: str, values: Array, rows: Sequence[slice], edges: tuple[float, ...]
) -> Columns:
    """Return means, limits and coarse histograms of a channel by block."""
    parts = [values[row] for row in rows]
    return {
        f"mean_{name}_{unit}": [float(part.sum()) / len(part) for part in parts],
        f"minimum_{name}_{unit}": [float(part.min()) for part in parts],
        f"maximum_{name}_{unit}": [float(part.max()) for part in parts],
        f"{name}_histogram": coarse_histograms(values, edges, rows),
    }


def prediction_rows(
    motor_id: str,
    night: dt.date,
    statistics: NightStatistics,
    modes: Sequence[BlockFit],
) -> list[Row]:
    """Return rows of `predictions`: thinned samples, extremes among them, and the fits at them."""
    samples, z = statistics.samples, statistics.z
    error = statistics.error_of(modes[0].stated.training.coefficients)
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


def strange_flow(samples: Samples) -> Iterator[str]:
    """Yield that the drain flow of a night follows nothing that drives it."""
    pressure, temperature = np.abs(samples.pressure_difference_bar), samples.oil_temperature_c
    flow = samples.leakage_l_per_min
    if flow.size < FEWEST_RANKED or not np.ptp(flow) > 0:
        return
    widths = ((pressure, VARIES * np.median(pressure)), (temperature, VARIES_K))
    drives = [values for values, width in widths if np.ptp(np.percentile(values, (5, 95))) > width]
    # Hotter oil is thinner: the flow rises with either.
    if drives and all(_rank_correlation(drive, flow) < FOLLOWS for drive in drives):
        how = "follows neither pressure nor the oil's viscosity"
        yield f"the drain flow {how}: are columns swapped?"


def _rank_correlation(values: Array, others: Array) -> float:
    """Return Spearman's coefficient."""
    # Not SciPy's, which takes half a second to load before the first run of a fleet.
    thin = slice(None, None, max(len(values) // MOST_RANKED, 1))
    ranks = pl.corr(pl.Series(values[thin]), pl.Series(others[thin]), method="spearman")
    return float(pl.select(ranks).item())

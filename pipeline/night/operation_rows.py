"""The row of `operation`: how a motor was run in a night, and what its sensors said at halts."""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.config.nights import Night
from pipeline.ingest import RawChannel
from pipeline.night.time_base import Samples
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C

Array = NDArray[np.float64]
Row = dict[str, Any]

HOUR_US = 3_600_000_000
# Samples that are counted together.
NEIGHBOURS = 1 << 16


def operation_row(
    spec: MotorSpec, night: Night, samples: Samples, counter: RawChannel | None
) -> Row:
    """The row of a night with samples, fitted or not."""
    hours = (night.end_us - night.start_us) / HOUR_US
    share = samples.n_turning / samples.n_logged if samples.n_logged else None
    counted = hours_counted(counter)
    row: Row = {
        "motor_id": spec.motor_id,
        "night": night.date,
        "logged_hours": samples.n_logged * samples.period_us / HOUR_US,
        "kept_hours": len(samples.index) * samples.period_us / HOUR_US,
        "running_share": share,
        "oil": spec.file.oil_on(night.date),
        "n_halts": samples.halts.n,
    }
    if counted is not None:
        row |= {"running_hours": counted, "running_hours_source": "counter"}
    elif share is not None:
        row |= {"running_hours": share * hours, "running_hours_source": "share"}
    for name, unit, zero in (
        ("pressure_zero", "bar", samples.halts.pressure_bar),
        ("flow_zero", "l_per_min", samples.halts.flow_l_per_min),
    ):
        if zero is not None:
            row[f"{name}_{unit}"] = zero.value
            row[f"{name}_standard_error_{unit}"] = zero.standard_error
    if len(samples.index):
        row |= _conditions(samples)
    return row


def hours_counted(counter: RawChannel | None) -> float | None:
    """Hours that a counter of running hours went on in a night; None where it cannot tell."""
    if counter is None:
        return None
    reading = counter.value[np.argsort(counter.time_us, kind="stable")]
    reading = reading[np.isfinite(reading)]
    # A counter that goes back was exchanged or misread.
    if len(reading) < 2 or (np.diff(reading) < 0).any():
        return None
    return float(reading[-1] - reading[0])


def _conditions(samples: Samples) -> Row:
    pressure, speed = np.abs(samples.pressure_difference_bar), np.abs(samples.speed_rpm)
    temperature = samples.oil_temperature_c
    return {
        "mean_pressure_bar": float(pressure.mean()),
        "mean_temperature_c": float(temperature.mean()),
        "mean_speed_rpm": float(speed.mean()),
        "mean_flow_l_per_min": float(samples.leakage_l_per_min.mean()),
        "share_reversed": np.count_nonzero(samples.speed_rpm < 0) / len(speed),
        "pressure_histogram": coarse_histogram(pressure, PRESSURE_EDGES_BAR),
        "temperature_histogram": coarse_histogram(temperature, TEMPERATURE_EDGES_C),
        "speed_histogram": coarse_histogram(speed, SPEED_EDGES_RPM),
    }


def coarse_histogram(values: Array, edges: tuple[float, ...]) -> list[int]:
    """Samples in each bin; the end bins hold all beyond."""
    last = len(edges) - 1
    counts = [0] * last
    for begin in range(0, len(values), NEIGHBOURS):
        piece = values[begin : begin + NEIGHBOURS]
        # Only edges between its limits part it.
        split, full = (bisect_right(edges, one, 1, last) for one in (piece.min(), piece.max()))
        between = (int(np.count_nonzero(piece < edge)) for edge in edges[split:full])
        for place, (below, upto) in enumerate(pairwise((0, *between, len(piece))), split - 1):
            counts[place] += upto - below
    return counts

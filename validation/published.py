"""Machines of published tables: coefficients recovered from logs that their formulas make.

The formulas and the oil's viscosity are written out here, and nothing of the program is used to
make the logs: a law or a config that said something else would show.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from validation.fleet import fitted, new_fleet
from validation.tables import Row, Table

Array = NDArray[np.float64]

# Loss factor K of Q = K ΔP/η, m³: slip coefficient by displacement per radian, and nine gaps of
# π D c³/(12 L) each.
PUBLISHED_M3: Mapping[str, float] = {
    "axial_piston_unit_107": 4.26e-9 * 107e-6 / (2.0 * np.pi),
    "nine_pistons": 9.0 * np.pi * 25e-3 * 5e-6**3 / (12.0 * 15e-3),
}
L_PER_MIN = 60_000.0
METER_SHARE = 0.005  # white noise of the meter over the mean flow
GOAL_PERCENT = 1.0


def viscosity_pa_s(temperature_c: Array) -> Array:
    """Walther through 32 mm²/s at 40 °C and 5.4 mm²/s at 100 °C, times the density."""
    x = np.log10(np.asarray([40.0, 100.0]) + 273.15)
    y = np.log10(np.log10(np.asarray([32.0, 5.4]) + 0.7))
    slope = (y[1] - y[0]) / (x[1] - x[0])
    w = y[0] + slope * (np.log10(temperature_c + 273.15) - x[0])
    density = 870.0 / (1.0 + 7.0e-4 * (temperature_c - 15.0))
    return np.asarray((10.0**10.0**w - 0.7) * 1e-6 * density)


def log_of(loss_factor_m3: float, minutes: float, rng: np.random.Generator) -> pl.DataFrame:
    """Return log at 1 Hz over pressures, temperatures and speeds, with a meter of white noise."""
    t = np.arange(60.0 * minutes)
    pressure = 130.0 + 110.0 * np.sin(2.0 * np.pi * t / 97.0)
    temperature = 48.0 + 8.0 * np.sin(2.0 * np.pi * t / 1301.0)
    speed = 1000.0 + 500.0 * np.sin(2.0 * np.pi * t / 211.0)
    flow = L_PER_MIN * loss_factor_m3 * pressure * 1e5 / viscosity_pa_s(temperature)
    begin = dt.datetime(2024, 4, 1, 8, tzinfo=dt.UTC)
    return pl.DataFrame(
        {
            "time": [begin + dt.timedelta(seconds=s) for s in t],
            "pressure_bar": pressure,
            "temperature_c": temperature,
            "speed_rpm": speed,
            "leakage_l_per_min": flow + METER_SHARE * flow.mean() * rng.standard_normal(t.size),
        }
    )


def judge(work: Path, minutes: float = 60.0) -> list[Table]:
    """Fit the machines' logs by config alone, and compare with the tables."""
    fleet = new_fleet("machines", work)
    rng = np.random.default_rng(1)
    for name, loss_factor in PUBLISHED_M3.items():
        folder = work / "logs" / name
        folder.mkdir()
        log_of(loss_factor, minutes, rng).write_parquet(folder / "log.parquet")
    fits = {row["motor_id"]: row for row in fitted(fleet).fits().collect().to_dicts()}
    return [Table("machines", [_row(*known, fits[known[0]]) for known in PUBLISHED_M3.items()])]


def _row(name: str, published: float, fit: dict[str, Any]) -> Row:
    estimate = fit["coefficients"][0]
    error = 100.0 * (estimate / published - 1.0)
    return {
        "machine": name,
        "published K, m³": f"{published:.4g}",
        "found": f"{estimate:.4g}",
        "error": f"{error:+.3f} %",
        "within 1 %": "yes" if abs(error) <= GOAL_PERCENT else "no",
    }

"""A motor-night as a user would write it: pandas, and a search over the samples."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from benchmarks.simulated_nights import motor
from leakage import OperatingConditions, Parametrisation, regressors
from leakage.multi_start import starting_points


def user_motor_night(log: Path, starts: int, timed: int) -> float:
    """Seconds that a motor-night takes: reading, cleaning, and a search from some starts, scaled.

    Parameters
    ----------
    log
        A Parquet log of the demo.
    starts, timed
        Starting points of the search, and how many of them are timed.
    """
    begin = time.perf_counter()
    frame = pd.read_parquet(log)
    frame = frame.sort_values("timestamp").drop_duplicates("timestamp").set_index("timestamp")
    frame["oil_temperature"] = frame["oil_temperature"].interpolate("time")
    frame = frame[(frame["speed"].abs() > 0.5) & (frame["drain_flow"] < 16.0)].dropna()
    conditions = OperatingConditions.from_bar(
        frame["pressure_difference"].abs().clip(lower=0.0).to_numpy(),
        frame["oil_temperature"].to_numpy(),
        frame["speed"].abs().to_numpy(),
    )
    model = motor()
    parametrisation = Parametrisation.of(model)
    columns = regressors(model, conditions)
    target = frame["drain_flow"].to_numpy() - columns[:, -1]
    prepared = time.perf_counter() - begin

    def residual(free: np.ndarray) -> np.ndarray:
        error: np.ndarray = columns[:, :-1] @ parametrisation.coefficients(free)[0] - target
        return error

    points = starting_points(parametrisation.free, starts, np.random.default_rng(1))
    begin = time.perf_counter()
    for point in points[:timed]:
        least_squares(residual, point, bounds=parametrisation.bounds(), x_scale="jac")
    searched = time.perf_counter() - begin
    return prepared + searched * starts / timed

"""A motor-night as a user would write it: pandas, and a search over the samples."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from benchmarks.simulated_nights import motor
from leakage import OperatingConditions, regressors
from leakage.estimation.multi_start import Parametrisation, starting_points

PLAUSIBLE = {
    "pressure_difference": (-450.0, 450.0),
    "oil_temperature": (-20.0, 120.0),
    "speed": (-400.0, 400.0),
    "drain_flow": (0.0, 100.0),
}


def user_motor_night(log: Path, starts: int, timed: int) -> tuple[float, float]:
    """Seconds that a motor-night takes: reading, cleaning, and a search from some starts, scaled.

    Parameters
    ----------
    log
        A Parquet log of the demo.
    starts, timed
        Starting points of the search, and how many of them are timed.

    Returns
    -------
    plain, clever
        With the model evaluated in each trial of the search; and with what of it no trial changes
        worked out before, which takes the insight that the flow is linear in the loss factors.
    """
    begin = time.perf_counter()
    frame = pd.read_parquet(log)
    frame = frame.sort_values("timestamp").drop_duplicates("timestamp").set_index("timestamp")
    for name, (low, high) in PLAUSIBLE.items():
        frame[name] = frame[name].where(frame[name].between(low, high))
    frame["oil_temperature"] = frame["oil_temperature"].interpolate("time")
    frame = frame[(frame["speed"].abs() > 0.5) & (frame["drain_flow"] < 16.0)].dropna()
    conditions = OperatingConditions.from_bar(
        frame["pressure_difference"].abs().to_numpy(),
        frame["oil_temperature"].to_numpy(),
        frame["speed"].abs().to_numpy(),
    )
    model = motor()
    parametrisation = Parametrisation.of(model)
    columns = regressors(model, conditions)
    target = frame["drain_flow"].to_numpy() - columns[:, -1]
    prepared = time.perf_counter() - begin

    def clever(free: np.ndarray) -> np.ndarray:
        error: np.ndarray = columns[:, :-1] @ parametrisation.coefficients(free) - target
        return error

    def plain(free: np.ndarray) -> np.ndarray:
        evaluated = regressors(model, conditions)
        error: np.ndarray = evaluated[:, :-1] @ parametrisation.coefficients(free) - target
        return error

    points = starting_points(parametrisation.free, starts, np.random.default_rng(1))
    seconds = []
    for residual in (plain, clever):
        begin = time.perf_counter()
        for point in points[:timed]:
            least_squares(residual, point, bounds=parametrisation.bounds(), x_scale="jac")
        seconds.append(prepared + (time.perf_counter() - begin) * starts / timed)
    return seconds[0], seconds[1]

"""One night by `fit_frame`, by lmfit, and by statsmodels, each as a competent user writes it.

All get the same samples and the same motor: a simulated night, whose loss factors are known. lmfit
evaluates the model in each trial and keeps bounds; statsmodels regresses on the model's columns,
with errors robust against autocorrelation, and once more with errors of first order (GLSAR). Lines
are those of the function's body and of what it calls here; time is processor time, medians.

Coverage is how many of the 95 % intervals hold the true loss factor, over simulated nights of an
hour whose errors are correlated: over some seconds, and over minutes besides.
"""

from __future__ import annotations

import inspect
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import lmfit
import numpy as np
import polars as pl
import statsmodels.api as sm
from scipy.signal import lfilter

from benchmarks.results_file import Part, write_stored
from benchmarks.simulated_nights import duty, motor
from leakage import Motor, OperatingConditions, fit_frame, regressors, total_flow_l_per_min
from leakage.frame.samples import INPUTS
from pipeline.arrays import Array

HOURS, RATE_HZ, NIGHTS, REPEATS = 1.0, 2.0, 40, 5
NOISE_L_PER_MIN, SLOW_L_PER_MIN = 0.05, 0.02
FAST_S, SLOW_S = 2.0, 600.0

Intervals = dict[str, tuple[float, float]]


def by_fit_frame(frame: pl.DataFrame, of: Motor) -> Intervals:
    """Fit by this package."""
    found = fit_frame(frame, of)
    return {name: one for name, one in found.conf_int().items() if one is not None}


def by_lmfit(frame: pl.DataFrame, of: Motor) -> Intervals:
    """The model evaluated in each trial, bounds kept, intervals from the curvature."""
    conditions = OperatingConditions.from_bar(*(frame[name].to_numpy() for name in INPUTS))
    measured = frame["leakage_l_per_min"].to_numpy()
    parameters = lmfit.Parameters()
    for path in of.column_paths:
        start = path.configured_coefficient
        # K is some 1e-14 m³: the search needs numbers near one.
        parameters.add(path.coefficient_name, value=1.0, min=0.0, max=50.0, user_data=start)

    def residual(trial: lmfit.Parameters) -> Array:
        k = {
            path.name: trial[path.coefficient_name].value * path.configured_coefficient
            for path in of.column_paths
        }
        return measured - total_flow_l_per_min(of, conditions, k)

    found = lmfit.minimize(residual, parameters, method="least_squares")
    half = 1.96
    return {
        one.name: (
            (one.value - half * one.stderr) * one.user_data,
            (one.value + half * one.stderr) * one.user_data,
        )
        for one in found.params.values()
    }


def _regression(frame: pl.DataFrame, of: Motor) -> tuple[Array, Array, Array, list[str]]:
    """Measured flow, columns near one, their scale, and their names."""
    conditions = OperatingConditions.from_bar(*(frame[name].to_numpy() for name in INPUTS))
    columns = regressors(of, conditions)
    scale = np.array([path.configured_coefficient for path in of.column_paths])
    flow = frame["leakage_l_per_min"].to_numpy() - columns[:, -1]
    names = [path.coefficient_name for path in of.column_paths]
    return flow, columns[:, : len(scale)] * scale, scale, names


def by_ols(frame: pl.DataFrame, of: Motor) -> Intervals:
    """Least squares on the model's columns, errors robust against autocorrelation."""
    flow, columns, scale, names = _regression(frame, of)
    lags = round(60 * RATE_HZ)
    found = sm.OLS(flow, columns).fit(cov_type="HAC", cov_kwds={"maxlags": lags})
    return dict(zip(names, (found.conf_int() * scale[:, None]).tolist(), strict=True))


def by_glsar(frame: pl.DataFrame, of: Motor) -> Intervals:
    """Errors that follow the one before."""
    flow, columns, scale, names = _regression(frame, of)
    found = sm.GLSAR(flow, columns, rho=1).iterative_fit(maxiter=10)
    return dict(zip(names, (found.conf_int() * scale[:, None]).tolist(), strict=True))


WAYS: dict[str, Callable[[pl.DataFrame, Motor], Intervals]] = {
    "fit_frame": by_fit_frame,
    "lmfit": by_lmfit,
    "statsmodels OLS, HAC of a minute": by_ols,
    "statsmodels GLSAR": by_glsar,
}
TELLS = {
    "fit_frame": (
        "intervals that count slow errors; a verdict by coefficient, and why; fit on samples it "
        "was not fitted to; tests of the errors; the leakage at a condition, told or not; the "
        "structured misfit; effects of stated sensor tolerances"
    ),
    "lmfit": (
        "intervals for white errors; correlations of the estimates; profiles on demand "
        "(`conf_interval`); any other model and constraint by changing one function"
    ),
    "statsmodels OLS, HAC of a minute": (
        "intervals for errors that remember up to the lags chosen; R², Durbin–Watson, condition "
        "number, tests of normality; no bounds: a loss factor may come out negative"
    ),
    "statsmodels GLSAR": (
        "the same with the correlation of neighbours estimated; a gap in the samples goes unseen"
    ),
}


def main(options: Sequence[str] = ()) -> None:
    """Measure and write `benchmarks/results/notebook_rivals.md`."""
    makers = {"night": one_night, "coverage": coverage}
    title = "A motor's night by three packages"
    write_stored("notebook_rivals", title, __doc__ or "", makers, options)


def simulated(seed: int, slow: bool) -> pl.DataFrame:
    """An hour of a CB560 with correlated errors."""
    generator = np.random.default_rng(seed)
    seen = duty(HOURS, generator, RATE_HZ)
    n = len(seen.pressure_bar)
    flow = total_flow_l_per_min(motor(), seen.conditions)
    flow = flow + _lagging(generator, n, FAST_S, NOISE_L_PER_MIN)
    if slow:
        flow = flow + _lagging(generator, n, SLOW_S, SLOW_L_PER_MIN)
    inputs = dict(zip(INPUTS, seen.channels, strict=True))
    return pl.DataFrame({"time": seen.time_s} | inputs | {"leakage_l_per_min": flow})


def _lagging(generator: np.random.Generator, n: int, memory_s: float, size: float) -> Any:
    """Errors of first order of a size [l/min]."""
    rho = np.exp(-1.0 / (memory_s * RATE_HZ))
    white = size * np.sqrt(1.0 - rho**2) * generator.standard_normal(n)
    white[0] = size * generator.standard_normal()
    return lfilter([1.0], [1.0, -rho], white)


def one_night() -> Part:
    """Lines, time, and what each tells."""
    frame, of = simulated(1, slow=False), motor()
    rows = []
    for name, way in WAYS.items():
        found, taken = {}, []
        for _ in range(REPEATS + 1):
            begin = time.process_time()
            found = way(frame, of)
            taken.append(time.process_time() - begin)
        first = next(iter(found.values()))
        rows.append(
            [
                name,
                str(_lines(way)),
                f"{1000 * statistics.median(taken[1:]):.0f} ms",
                f"[{first[0]:.3g}, {first[1]:.3g}]",
                TELLS[name],
            ]
        )
    return Part(
        "One night",
        f"{frame.height} samples of an hour, three loss factors, truth of the first "
        f"{of.column_paths[0].configured_coefficient:.3g} m³.",
        " | lines | processor time | 95 % interval of the first K [m³] | what it tells",
        rows,
    )


def _lines(way: Callable[[pl.DataFrame, Motor], Intervals]) -> int:
    """Lines of a way, without its first and its docstring, with those of what it calls here."""
    text = inspect.getsource(way)
    text += inspect.getsource(_regression) if "_regression(" in text else ""
    told = [one for one in text.splitlines() if one.strip() and '"""' not in one]
    return sum(not one.startswith("def ") for one in told)


def coverage() -> Part:
    """Share of intervals that hold the truth, and their width."""
    of = motor()
    truth = {path.coefficient_name: path.configured_coefficient for path in of.column_paths}
    rows = []
    for name, way in WAYS.items():
        row = [name]
        for slow in (False, True):
            held, width = [], []
            for seed in range(NIGHTS):
                for parameter, (low, high) in way(simulated(seed, slow), of).items():
                    if parameter in truth:
                        held.append(low <= truth[parameter] <= high)
                        width.append((high - low) / 2 / truth[parameter])
            row += [f"{100 * np.mean(held):.0f} %", f"± {100 * np.median(width):.1f} %"]
        rows.append(row)
    return Part(
        "Coverage",
        f"{NIGHTS} simulated nights each; errors of {NOISE_L_PER_MIN} l/min that remember "
        f"{FAST_S:g} s, and beside them {SLOW_L_PER_MIN} l/min that remember {SLOW_S / 60:g} min.",
        " | held, seconds | median half-width | held, minutes | median half-width",
        rows,
    )

"""Plots of a fit to a frame, on Matplotlib axes that are given or made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from leakage.errors import LeakageError
from leakage.estimation.block_statistics import criterion, merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from leakage.estimation.sample_blocks import SECOND_US, TRAINING, VALIDATION
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import path_flows_l_per_min, regressors
from leakage.physics.paths import Constant

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from leakage.frame.result import FrameFit, Part

Array = NDArray[np.float64]
# Points of a curve over time: more are not seen.
MOST_POINTS = 5000
CURVE_POINTS = 60
# Periods without a sample that end a line.
GAP = 5
# Reach of a profile on either side of the estimate, over its interval's half-width.
REACH = 2.0


def plot(found: FrameFit, ax: Axes | None = None) -> Axes:
    """Measured and predicted flow over time, with the parts."""
    axes = ax or plt.subplots(figsize=(9, 3.5), layout="constrained")[1]
    samples = found.samples
    step = -(-len(samples.time_us) // MOST_POINTS)
    few = slice(None, None, step)
    time: NDArray[Any] = samples.time_us[few] / SECOND_US
    if samples.on_clock:
        time = samples.time_us[few].astype("datetime64[us]")
    axes.plot(time, samples.measured_l_per_min[few], ".", ms=2, color="0.6", label="measured")
    predicted, apart = found.predict()[few], np.diff(samples.time_us[few], prepend=0)
    # The line ends where samples are left out.
    predicted[apart > GAP * step * samples.period_us] = np.nan
    axes.plot(time, predicted, lw=1, label="predicted")
    for part, colour in ((TRAINING, "tab:green"), (VALIDATION, "tab:orange")):
        inside = found.parts[few] == part
        if inside.any():
            axes.fill_between(
                time,
                0,
                1,
                where=inside.tolist(),
                transform=axes.get_xaxis_transform(),
                color=colour,
                alpha=0.08,
                lw=0,
                label=part,
            )
    axes.set(xlabel="time (UTC)" if samples.on_clock else "time [s]", ylabel="drain flow [l/min]")
    _legend_beside(axes)
    return axes


def plot_residuals(found: FrameFit, part: Part, axes: Sequence[Axes] | None = None) -> list[Axes]:
    """Autocorrelation of the errors, and their correlation with each input, with 99 % bands."""
    tests = found.residual_tests(part)
    panels = {"errors": tests.whiteness, **tests.independence}
    found_axes, period_s = _panels(axes, len(panels)), found.samples.period_us / SECOND_US
    for ax, (name, test) in zip(found_axes, panels.items(), strict=True):
        ax.axhline(0.0, color="0.7", lw=0.8)
        ax.set(title=f"{name.replace('_', ' ')}: {test.verdict.replace('_', ' ')}")
        ax.set_xlabel("lag [s]")
        if not len(test.lags):
            ax.text(0.5, 0.5, test.reason or "", ha="center", va="center", transform=ax.transAxes)
            continue
        lags = test.lags * period_s
        ax.fill_between(lags, -test.bounds, test.bounds, color="tab:blue", alpha=0.15, lw=0)
        ax.vlines(lags, 0.0, test.values, lw=1.5)
    found_axes[0].set_ylabel("correlation [-]")
    return found_axes


def plot_leakage(
    found: FrameFit, temperature_c: float | None, speed_rpm: float | None, ax: Axes | None = None
) -> Axes:
    """Leakage by path over pressure, with the band of the sum: samples, model, sensors."""
    axes = ax or plt.subplots(figsize=(7, 4), layout="constrained")[1]
    samples, charge = found.samples, found.samples.charge_over_case_bar
    celsius = float(samples.oil_temperature_c.mean()) if temperature_c is None else temperature_c
    rpm = float(samples.speed_rpm.mean()) if speed_rpm is None else speed_rpm
    bar = np.linspace(*found.blocks.excitation.pressure_bar, CURVE_POINTS)
    at = OperatingConditions.from_bar(
        bar, celsius, rpm, None if charge is None else float(charge.mean())
    )
    theta = found.estimate.fit.coefficients
    flows = path_flows_l_per_min(found.motor, at, found.estimate.fit.coefficients_by_path)
    leaking = [path.name for path in found.motor.paths if not isinstance(path, Constant)]
    labels = [name.replace("_", " ") for name in leaking]
    axes.stackplot(bar, [flows[name] for name in leaking], labels=labels, alpha=0.5)
    rows = regressors(found.motor, at)
    total = rows[:, :-2] @ theta[:-1] + rows[:, -1]
    half = found.total_half_widths(rows, at)
    axes.plot(bar, total, color="black", lw=1.2, label="sum")
    axes.fill_between(bar, total - half, total + half, color="black", alpha=0.3, lw=0)
    axes.set(
        xlabel="pressure difference [bar]",
        ylabel="leakage [l/min]",
        title=f"{celsius:.1f} °C, {rpm:.0f} rpm; band: total ±",
    )
    _legend_beside(axes)
    return axes


def plot_profile(found: FrameFit, axes: Sequence[Axes] | None = None) -> list[Axes]:
    """Profile of the criterion over each coefficient, in units of its interval.

    The others are fitted anew at each value, within their bounds. The scale is that of the
    interval: at its limits the curve is at 1, as far as no bound is in the way.
    """
    places = found.free_places
    if not places:
        raise LeakageError("motor_paths", "nothing of this motor is estimated")
    panels = _panels(axes, len(places))
    whole = merge(found.estimate.whitened)
    lower, upper = Parametrisation.of(found.motor).coefficient_bounds()
    best = found.estimate.fit.certificate
    for ax, place in zip(panels, places, strict=True):
        path, judged = found.paths[place], found.identification.coefficients[place]
        value = float(best.coefficients[place])
        told = judged.information
        ax.set(title=f"{path.coefficient_name}: {judged.verdict.replace('_', ' ')}")
        ax.axvline(value, color="black", lw=0.8)
        reach = REACH * told.half_width if told is not None else 0.5 * max(abs(value), upper[place])
        grid = np.linspace(
            max(lower[place], value - reach), min(upper[place], value + reach), CURVE_POINTS
        )
        rise = np.array([_cost(whole, lower, upper, place, one) for one in grid])
        rise -= criterion(whole, best.coefficients)
        free = np.eye(len(lower))[place]
        scale = _rise_at(whole, found, free, told.half_width) if told is not None else 1.0
        ax.plot(grid, rise / scale)
        if told is not None:
            ax.axvspan(value - told.half_width, value + told.half_width, alpha=0.15, lw=0)
        unit = {"m3": "m³", "1": "-", "l_per_min": "l/min"}[path.coefficient_unit]
        ax.set(xlabel=f"{path.coefficient_name} [{unit}]")
    panels[0].set_ylabel("rise of the criterion")
    return panels


def _cost(whole: Array, lower: Array, upper: Array, place: int, value: float) -> float:
    """Least criterion with one coefficient held."""
    lower, upper = lower.copy(), upper.copy()
    lower[place] = upper[place] = value
    return certify(whole, lower, upper).cost


def _rise_at(whole: Array, found: FrameFit, free: Array, half_width: float) -> float:
    """Rise of the unbounded criterion at the limit of an interval."""
    fixed = found.estimate.fit.certificate.fixed
    columns = whole[:, :-2]
    others = columns[:, ~fixed & (free == 0.0)]
    own = columns @ free
    scale = np.linalg.norm(others, axis=0)
    others = others[:, scale > 0.0] / scale[scale > 0.0]
    beside = own - others @ np.linalg.lstsq(others, own)[0]
    n = float(np.sum(whole[:, -3] ** 2))
    return float(beside @ beside) * half_width**2 / n or 1.0


def _legend_beside(axes: Axes) -> None:
    """A legend that hides no data."""
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))


def _panels(axes: Sequence[Axes] | None, n: int) -> list[Axes]:
    if axes is None:
        size = (3.2 * n, 3.0)
        return list(plt.subplots(1, n, squeeze=False, figsize=size, layout="constrained")[1][0])
    if len(axes) != n:
        raise LeakageError("axes", f"{n} axes are needed, not {len(axes)}")
    return list(axes)

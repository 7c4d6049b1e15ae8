"""Plots of a fit to a frame, on Matplotlib axes that are given or made."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array
from leakage.estimation.proven_minimum import Fit
from leakage.estimation.residual_analysis import ResidualAnalysis
from leakage.estimation.sample_blocks import SECOND_US, TRAINING, VALIDATION
from leakage.frame.samples import FrameSamples
from leakage.physics.conditions import PASCALS_PER_BAR, OperatingConditions
from leakage.physics.motor import path_flows_l_per_min, regressors
from leakage.physics.paths import Constant

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Points of a curve over time: more are not seen.
MOST_POINTS = 5000
CURVE_POINTS = 60
# Periods without a sample that end a line.
GAP = 5


def plot(samples: FrameSamples, parts: NDArray[np.str_], predicted: Array, ax: Axes | None) -> Axes:
    """Measured and predicted flow over time, with the parts."""
    axes = ax or plt.subplots(figsize=(9, 3.5), layout="constrained")[1]
    step = -(-len(samples.time_us) // MOST_POINTS)
    few = slice(None, None, step)
    time: NDArray[Any] = samples.time_us[few] / SECOND_US
    if samples.on_clock:
        time = samples.time_us[few].astype("datetime64[us]")
    axes.plot(time, samples.measured_l_per_min[few], ".", ms=2, color="0.6", label="measured")
    # The line ends where samples are left out.
    apart = np.diff(samples.time_us[few], prepend=0)
    line = np.where(apart > GAP * step * samples.period_us, np.nan, predicted[few])
    axes.plot(time, line, lw=1, label="predicted")
    for part, colour in ((TRAINING, "tab:green"), (VALIDATION, "tab:orange")):
        inside = parts[few] == part
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


def plot_residuals(tests: ResidualAnalysis, period_s: float) -> list[Axes]:
    """Autocorrelation of the errors, and their correlation with each input, with 99 % bands."""
    panels = {"errors": tests.whiteness, **tests.independence}
    size = (3.2 * len(panels), 3.0)
    axes = plt.subplots(1, len(panels), squeeze=False, figsize=size, layout="constrained")[1][0]
    for ax, (name, test) in zip(axes, panels.items(), strict=True):
        ax.axhline(0.0, color="0.7", lw=0.8)
        ax.set(title=f"{name.replace('_', ' ')}: {test.verdict.replace('_', ' ')}")
        ax.set_xlabel("lag [s]")
        if not len(test.lags):
            ax.text(0.5, 0.5, test.reason or "", ha="center", va="center", transform=ax.transAxes)
            continue
        lags = test.lags * period_s
        ax.fill_between(lags, -test.bounds, test.bounds, color="tab:blue", alpha=0.15, lw=0)
        ax.vlines(lags, 0.0, test.values, lw=1.5)
    axes[0].set_ylabel("correlation [-]")
    return list(axes)


def plot_leakage(
    fit: Fit, at: OperatingConditions, half_widths: Callable[..., Array], ax: Axes | None
) -> Axes:
    """Leakage by path over pressure, with the band of the sum: samples, model, sensors."""
    axes = ax or plt.subplots(figsize=(7, 4), layout="constrained")[1]
    bar = at.pressure_difference_pa / PASCALS_PER_BAR
    flows = path_flows_l_per_min(fit.motor, at, fit.coefficients_by_path)
    leaking = [path.name for path in fit.motor.paths if not isinstance(path, Constant)]
    labels = [name.replace("_", " ") for name in leaking]
    axes.stackplot(bar, [flows[name] for name in leaking], labels=labels, alpha=0.5)
    rows = regressors(fit.motor, at)
    total = rows[:, :-2] @ fit.coefficients[:-1] + rows[:, -1]
    half = half_widths(rows, at)
    axes.plot(bar, total, color="black", lw=1.2, label="sum")
    axes.fill_between(bar, total - half, total + half, color="black", alpha=0.3, lw=0)
    axes.set(
        xlabel="pressure difference [bar]",
        ylabel="leakage [l/min]",
        title=f"{at.oil_temperature_c[0]:.1f} °C, {at.speed_rpm[0]:.0f} rpm; band: total ±",
    )
    _legend_beside(axes)
    return axes


def _legend_beside(axes: Axes) -> None:
    """A legend that hides no data."""
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))

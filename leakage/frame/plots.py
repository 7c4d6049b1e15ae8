"""Plots of a fit to a frame, as figures of Plotly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plotly.graph_objects import Bar, Figure, Scatter
from plotly.subplots import make_subplots

from leakage.arrays import Array
from leakage.estimation.blocks import SECOND_US, TRAINING, VALIDATION
from leakage.estimation.proven_minimum import Fit
from leakage.estimation.residual_analysis import ResidualAnalysis
from leakage.frame.samples import FrameSamples
from leakage.physics.conditions import PASCALS_PER_BAR, OperatingConditions
from leakage.physics.motor import path_flows_l_per_min, regressors
from leakage.physics.paths import Constant

# Points of a curve over time: more are not seen.
MOST_POINTS = 5000
CURVE_POINTS = 60
# Periods without a sample that end a line.
GAP = 5
PART_COLOURS = {TRAINING: "#009e73", VALIDATION: "#e69f00"}
BAND = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
STYLE: dict[str, Any] = {"template": "plotly_white", "height": 400, "margin": {"t": 50}}


def plot(samples: FrameSamples, parts: NDArray[np.str_], predicted: Array) -> Figure:
    """Return measured and predicted flow over time, with the parts."""
    step = -(-len(samples.time_us) // MOST_POINTS)
    few = slice(None, None, step)
    time: NDArray[Any] = samples.time_us[few] / SECOND_US
    if samples.on_clock:
        time = samples.time_us[few].astype("datetime64[us]")
    # The line ends where samples are left out.
    apart = np.diff(samples.time_us[few], prepend=0)
    line = np.where(apart > GAP * step * samples.period_us, np.nan, predicted[few])
    measured = samples.measured_l_per_min[few]
    dots = {"size": 3, "color": "#999999"}
    figure = Figure(
        [
            Scatter(x=time, y=measured, name="measured", mode="markers", marker=dots),
            Scatter(x=time, y=line, name="predicted", mode="lines"),
        ]
    )
    figure.update_layout(STYLE, shapes=list(_shade(time, parts[few])))
    figure.update_xaxes(title="time (UTC)" if samples.on_clock else "time [s]")
    return figure.update_yaxes(title="drain flow [l/min]")


def _shade(time: NDArray[Any], parts: NDArray[np.str_]) -> Iterator[dict[str, Any]]:
    """Yield a shape for each run of samples of training and of validation."""
    begins = np.flatnonzero(np.append([True], parts[1:] != parts[:-1]))
    ends = [*(begins[1:] - 1).tolist(), len(parts) - 1]
    named = set()
    for first, last in zip(begins.tolist(), ends, strict=True):
        part = str(parts[first])
        if part in PART_COLOURS:
            place = {"x0": time[first], "x1": time[last], "yref": "paper", "y0": 0, "y1": 1}
            look = {"fillcolor": PART_COLOURS[part], "opacity": 0.1, "line": {"width": 0}}
            yield place | look | {"name": part, "showlegend": part not in named}
            named.add(part)


def plot_residuals(tests: ResidualAnalysis, period_s: float) -> Figure:
    """Plot autocorrelation of the errors, and correlation with each input, with 99 % bands."""
    panels = {"errors": tests.whiteness, **tests.independence}
    titles = [
        f"{name}:<br>{test.verdict}{'' if len(test.lags) else f', {test.reason}'}".replace("_", " ")
        for name, test in panels.items()
    ]
    figure = make_subplots(1, len(panels), subplot_titles=titles)
    for column, test in enumerate(panels.values(), 1):
        lags = test.lags * period_s
        band = {"x": lags, **BAND, "fillcolor": "rgba(0, 114, 178, 0.15)"}
        traces = [
            Scatter(y=-test.bounds, **band),
            Scatter(y=test.bounds, fill="tonexty", **band),
            Bar(x=lags, y=test.values, marker={"color": "#0072b2"}, showlegend=False),
        ]
        figure.add_traces(traces, rows=1, cols=column)
    figure.update_xaxes(title="lag [s]")
    figure.update_yaxes(title="correlation [-]", col=1)
    figure.update_annotations(font_size=13)  # the titles
    return figure.update_layout(STYLE)


def plot_leakage(fit: Fit, at: OperatingConditions, half_widths: Callable[..., Array]) -> Figure:
    """Return leakage by path over pressure, with the band of the sum: samples, model, sensors."""
    bar = at.pressure_difference_pa / PASCALS_PER_BAR
    flows = path_flows_l_per_min(fit.motor, at, fit.coefficients_by_path)
    leaking = [path.name for path in fit.motor.paths if not isinstance(path, Constant)]
    rows = regressors(fit.motor, at)
    total = rows[:, :-2] @ fit.coefficients[:-1] + rows[:, -1]
    half = half_widths(rows, at)
    stacked = {"x": bar, "mode": "lines", "line": {"width": 0}, "stackgroup": "paths"}
    band = {"x": bar, **BAND, "fillcolor": "rgba(0, 0, 0, 0.3)"}
    figure = Figure(
        [
            *(Scatter(y=flows[name], name=name.replace("_", " "), **stacked) for name in leaking),
            Scatter(y=total - half, **band),
            Scatter(y=total + half, fill="tonexty", **band),
            Scatter(x=bar, y=total, name="sum", mode="lines", line={"color": "black"}),
        ]
    )
    title = f"{at.oil_temperature_c[0]:.1f} °C, {at.speed_rpm[0]:.0f} rpm; band: total ±"
    figure.update_layout(STYLE, title=title)
    figure.update_xaxes(title="pressure difference [bar]")
    return figure.update_yaxes(title="leakage [l/min]")

"""Figures of the paths without a gap: the curve over speed, and flow over pressure."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from leakage import Laminar, SpeedCurve
from leakage.physics.paths import LeakagePath
from pipeline.arrays import Array
from pipeline.config.motor_types import BAR
from pipeline.model_figures.canvas import QUIET, dots, label, line, new_figure, pen
from pipeline.model_figures.gaps import DIFFERENCE, MILLILITRES, ONE_INTERFACE, PRESSURE
from pipeline.model_figures.subject import ModelSubject

SPEED = "Speed ω / rpm"
ALL_INTERFACES = "Leakage of the path / (ml/min)"

_STEPS = 351
_SPEED_STEPS = 251
_BEYOND_RANGE = 1.3
# Pen of a simulation's points.
_POINTS = 5


def speed_curve_figure(subject: ModelSubject, path: SpeedCurve) -> Figure:
    """Leakage of one interface over speed; thesis, figures 12 and 21.

    With points of a simulation, they and the curve's deviations from them; otherwise the curve of
    the stated coefficients. Beyond its range the end value is held, drawn dashed.
    """
    points = subject.speed_points.get(path.name)
    source = "stated coefficients" if points is None else f"fitted to {len(points)} points"
    bar = path.reference_pressure_pa / BAR
    figure, axes = new_figure(
        f"{subject.motor.motor_type}, {path.name}: leakage over speed",
        1 if points is None else 2,
        note=f"At ΔP₀ = {bar:g} bar and η₀ = {1e3 * path.reference_viscosity_pa_s:g} mPa·s; "
        f"polynomial of degree {len(path.coefficients) - 1}, {source}.\n"
        "Equations (32) to (34); thesis, figures 12 and 21.",
        mark=subject.marks(path),
    )
    curve = axes[0]
    _speed_curve(curve, path, subject.places[path.name])
    if points is not None:
        dots(curve, points[:, 0], MILLILITRES * points[:, 1], _POINTS, "points of the simulation")
        _deviations(axes[1], path, points)
    curve.legend(loc="best")
    return figure


def _speed_curve(axes: Axes, path: SpeedCurve, place: int) -> None:
    low, high = path.speed_minimum_rpm, path.speed_maximum_rpm
    inside = np.linspace(low, high, _SPEED_STEPS)
    line(axes, inside, _curve(path, inside), place, "f(ω)", "-")
    beyond = [np.array([high, _BEYOND_RANGE * high])]
    if low > 0.0:
        beyond.append(np.array([0.0, low]))
    for number, speed in enumerate(beyond):
        name = "end value, held beyond the range" if number == 0 else None
        line(axes, speed, _curve(path, speed), place, name, ":")
        axes.axvspan(speed[0], speed[1], color=QUIET, alpha=0.12, linewidth=0.0)
    axes.set_xlim(0.0, _BEYOND_RANGE * high)
    axes.set_ylim(bottom=0.0)
    label(axes, f"(a) f(ω), holds from {low:g} to {high:g} rpm", SPEED, ONE_INTERFACE)


def _deviations(axes: Axes, path: SpeedCurve, points: Array) -> None:
    """Curve minus points."""
    difference = _curve(path, points[:, 0]) - MILLILITRES * points[:, 1]
    axes.vlines(points[:, 0], 0.0, difference, color=pen(_POINTS).colour, linewidth=1.0)
    dots(axes, points[:, 0], difference, _POINTS)
    axes.axhline(0.0, color="black", linewidth=0.8)
    rms = float(np.sqrt(np.mean(difference**2)))
    label(axes, f"(b) curve minus points, {rms:.3g} ml/min rms", SPEED, DIFFERENCE)


def _curve(path: SpeedCurve, speed_rpm: Array) -> Array:
    """f(ω) of one interface, [ml/min]."""
    scale = path.configured_coefficient
    return MILLILITRES * scale * path.curve_l_per_min(speed_rpm)


def laminar_figure(subject: ModelSubject, path: Laminar) -> Figure:
    """Leakage of one interface of a laminar path over pressure; thesis, equation (8)."""
    value = f"C = {path.loss_factor.value:.4g} m³, as configured, not fitted. Equations (3) and (8)"
    coefficient = path.configured_coefficient / path.count
    return _over_pressure(subject, path, coefficient, value, ONE_INTERFACE)


def pressure_figure(subject: ModelSubject, path: LeakagePath) -> Figure:
    """Leakage of a path of any law over pressure, at the reference speed."""
    coefficient = path.configured_coefficient
    value = f"{subject.speed_rpm:g} rpm; {path.coefficient_name} = {coefficient:.4g}, not fitted"
    return _over_pressure(subject, path, coefficient, value, ALL_INTERFACES)


def _over_pressure(
    subject: ModelSubject, path: LeakagePath, coefficient: float, value: str, flow_label: str
) -> Figure:
    figure, (axes,) = new_figure(
        f"{subject.motor.motor_type}, {path.name}: leakage over pressure",
        1,
        note=f"{subject.conditions_words()}, {subject.film_words()}; {value}.",
        mark=subject.marks(path, oil=True),
    )
    pressure = np.linspace(0.0, subject.highest_pressure_bar, _STEPS)
    regressor = path.regressor(
        subject.film_drive_per_s(pressure),
        pressure * BAR,
        np.full_like(pressure, subject.speed_rpm),
    )
    flow = MILLILITRES * coefficient * regressor
    line(axes, pressure, flow, subject.places[path.name], dashes="-")
    label(axes, "", PRESSURE, flow_label)
    return figure

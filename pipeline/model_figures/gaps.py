"""Figures of an annular gap: leakage over pressure and gap height, effect of deformation."""

from __future__ import annotations

from collections.abc import Callable

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from leakage import AnnularGap
from leakage.physics.simulated_curves import FittedDeformation, fit_deformation_pressure
from pipeline.arrays import Array
from pipeline.config.motor_types import BAR, MICROMETRE
from pipeline.model_figures.canvas import MAP_COLOURS, dots, label, line, new_figure, pen
from pipeline.model_figures.subject import ModelSubject, stated

PRESSURE = "Pressure difference ΔP / bar"
GAP = "Gap height h, not deformed / µm"
ONE_INTERFACE = "Leakage of one interface / (ml/min)"
DIFFERENCE = "Difference / (ml/min)"
MILLILITRES = 1e3

_STEPS = 351
_GAP_STEPS = 80
_DECADES_OF_MAP = 2
_GAPS_OF_MAP = (0.25, 2.0)  # of the configured gap height
_GAPS_OF_CURVES = (0.75, 1.0, 1.25)
_MOST_CURVES = 6


def leakage_figure(subject: ModelSubject, path: AnnularGap) -> Figure:
    """Leakage of one interface over pressure and gap height; thesis, figures 5 and 16.

    Left at constant viscosity, in the middle at the configured film pressure, right as curves at
    some gap heights; where the gap deforms, its maximum is marked on each.
    """
    figure, (constant, film, curves) = new_figure(
        f"{subject.motor.motor_type}, {path.name}: leakage over pressure and gap height",
        3,
        note=f"{subject.conditions_words()}; configured is {stated(path)}, not fitted. Marks: "
        "maxima over pressure. Equations (7), (10), (11), (28) to (31); thesis, figures 5 and 16.",
        mark=subject.marks(path, oil=True),
    )
    pressure = _pressures(subject, path)
    gaps = np.linspace(*_GAPS_OF_MAP, _GAP_STEPS) * path.gap.value
    flows = [
        _flows(path, pressure, gaps, drive)
        for drive in (subject.constant_drive_per_s(pressure), subject.film_drive_per_s(pressure))
    ]
    levels = _levels(max(float(flow.max()) for flow in flows))
    for axes, flow, name, largest in zip(
        (constant, film),
        flows,
        ("(a) constant viscosity", f"(b) {subject.film_words()}"),
        _largest_bar(subject, path),
        strict=True,
    ):
        colours = _map(axes, pressure, gaps, flow, levels)
        if largest is not None:
            axes.axvline(largest, color="black", linewidth=3.0)
            axes.axvline(largest, color="white", linestyle="--", gid="maximum")
            name += f", maximum at {largest:.2f} bar"
        label(axes, name, PRESSURE, GAP)
    figure.colorbar(
        colours, ax=[constant, film], label=ONE_INTERFACE, format=lambda value, _: f"{value:g}"
    )
    _curves(curves, subject, path, pressure)
    return figure


def deformation_figure(subject: ModelSubject, path: AnnularGap) -> Figure:
    """Leakage with and without deformation; thesis, figures 9 and 17 to 20.

    Where X is fitted to points of a simulation, both equations are compared with these;
    otherwise with each other.
    """
    points = subject.deformation_points.get(path.name)
    if points is None:
        return _stated_deformation(subject, path)
    return _fitted_deformation(subject, path, points)


def _stated_deformation(subject: ModelSubject, path: AnnularGap) -> Figure:
    """The effect of a deformation constant that the config states."""
    assert path.deformation_pressure_pa is not None
    figure, (flow, loss) = new_figure(
        f"{subject.motor.motor_type}, {path.name}: leakage with and without deformation",
        2,
        note=f"{subject.conditions_words()}; {subject.film_words()}; configured is {stated(path)}, "
        "not fitted.\nThe config states X; points of a simulation, if given instead, would be "
        "compared with both. Equations (28) to (31).",
        mark=subject.marks(path, oil=True),
    )
    pressure = _pressures(subject, path)
    drive = subject.film_drive_per_s(pressure)
    closing = np.exp(-3.0 * pressure * BAR / path.deformation_pressure_pa)
    for place, gap in enumerate(_GAPS_OF_CURVES * np.array(path.gap.value)):
        (deformed,) = _flows(path, pressure, np.array([gap]), drive)
        line(flow, pressure, deformed, place, f"h = {gap:.3g} µm", "-")
        line(flow, pressure, deformed / closing, place, dashes="--")
    label(flow, "(a) solid deformed, dashed not", PRESSURE, ONE_INTERFACE)
    flow.legend(loc="upper left")
    line(loss, pressure, 100.0 * (closing - 1.0), 0, "leakage")
    line(loss, pressure, 100.0 * (np.cbrt(closing) - 1.0), 1, "gap height")
    x_bar = path.deformation_pressure_pa / BAR
    label(loss, f"(b) what deformation takes away, X = {x_bar:.4g} bar", PRESSURE, "Change / %")
    loss.legend(loc="best")
    return figure


def _fitted_deformation(subject: ModelSubject, path: AnnularGap, points: Array) -> Figure:
    """Both equations against the points of a simulation."""
    fitted = fit_deformation_pressure(points[:, 0] * BAR, points[:, 1] * MICROMETRE, points[:, 2])
    x_bar = fitted.deformation_pressure_pa / BAR
    figure, (flow, without, with_) = new_figure(
        f"{subject.motor.motor_type}, {path.name}: leakage with and without deformation",
        3,
        note=f"X = {x_bar:.4g} bar, fitted to {fitted.n_points} points of a simulation; deviations "
        f"from them: {MILLILITRES * fitted.rms_residual_l_per_min:.3g} ml/min rms, at most "
        f"{MILLILITRES * fitted.largest_residual_l_per_min:.3g} ml/min.\nViscosity as in the "
        "simulation. Equations (30) and (31); thesis, figures 9 and 17 to 20.",
        mark=subject.marks(path),
    )
    gaps = np.unique(points[:, 1])
    drawn = gaps[np.unique(np.linspace(0, gaps.size - 1, _MOST_CURVES).round().astype(int))]
    pressure = np.linspace(0.0, points[:, 0].max(), _STEPS)
    for place, gap in enumerate(drawn):
        style, name = pen(place), f"h = {gap:.4g} µm"
        own = points[points[:, 1] == gap]
        own = own[own[:, 0].argsort()]
        dots(flow, own[:, 0], MILLILITRES * own[:, 2], place, name)
        curves = _simulated(fitted, pressure, np.full_like(pressure, gap))
        at_points = _simulated(fitted, own[:, 0], own[:, 1])
        for curve, there, axes, dashes in zip(
            curves, at_points, (with_, without), ("-", "--"), strict=True
        ):
            line(flow, pressure, curve, place, dashes=dashes)
            difference = there - MILLILITRES * own[:, 2]
            axes.plot(own[:, 0], difference, color=style.colour, marker=style.mark, label=name)
    label(flow, "(a) points; solid deformed, dashed not", PRESSURE, ONE_INTERFACE)
    flow.legend(loc="upper left")
    for axes, name in ((without, "(b) not deformed"), (with_, "(c) deformed")):
        largest = max(np.abs(line.get_ydata()).max() for line in axes.lines)
        label(axes, f"{name} minus points: at most {largest:.3g} ml/min", PRESSURE, DIFFERENCE)
        axes.axhline(0.0, color="black", linewidth=0.8)
    if drawn.size < gaps.size:
        without.text(
            0.02, 0.02, f"{drawn.size} of {gaps.size} gap heights", transform=without.transAxes
        )
    return figure


def _simulated(fitted: FittedDeformation, bar: Array, gap_um: Array) -> tuple[Array, Array]:
    """Flow by the equation with deformation and without, at the simulation's viscosity."""
    straight = fitted.amplitude * (gap_um * MICROMETRE) ** 3 * bar * BAR * MILLILITRES
    return straight * np.exp(-3.0 * bar * BAR / fitted.deformation_pressure_pa), straight


def _curves(axes: Axes, subject: ModelSubject, path: AnnularGap, pressure: Array) -> None:
    """Curves at some gap heights: solid at the film's pressure, dashed at constant viscosity."""
    drives = (subject.constant_drive_per_s(pressure), subject.film_drive_per_s(pressure))
    largest = _largest_bar(subject, path)
    for place, gap in enumerate(_GAPS_OF_CURVES * np.array(path.gap.value)):
        style = pen(place)
        for drive, bar, dashes, fill in zip(
            drives, largest, ("--", "-"), ("white", style.colour), strict=True
        ):
            (flow,) = _flows(path, pressure, np.array([gap]), drive)
            name = f"h = {gap:.3g} µm" if dashes == "-" else None
            line(axes, pressure, flow, place, name, dashes)
            if bar is not None:
                axes.plot(
                    bar, flow[pressure == bar], marker=style.mark, color=style.colour,
                    markerfacecolor=fill, linestyle="", zorder=3,
                )  # fmt: skip
    label(axes, "(c) dashed as (a), solid as (b)", PRESSURE, ONE_INTERFACE)
    axes.legend(loc="best")


def _levels(highest: float) -> Array:
    """Levels of a map in steps of 1, 2, 5 up to its highest flow: leakage goes with h³."""
    if highest <= 0.0:
        return np.array([0.0, 1.0])
    decade = np.floor(np.log10(highest))
    steps = np.outer(10.0 ** np.arange(decade - _DECADES_OF_MAP, decade + 1), [1.0, 2.0, 5.0])
    below = steps[steps < highest]
    return np.concatenate(
        [[0.0], below, [steps[steps >= highest].min(initial=10.0 ** (decade + 1))]]
    )


def _map(axes: Axes, pressure: Array, gaps: Array, flow: Array, levels: Array) -> QuadContourSet:
    """Leakage as colours with lines of equal leakage, light on dark and dark on light."""
    evenly = BoundaryNorm(levels.tolist(), mpl.colormaps[MAP_COLOURS].N)
    filled = axes.contourf(pressure, gaps, flow, levels=levels, cmap=MAP_COLOURS, norm=evenly)
    inner = levels[1:-1]
    shades = ["white" if place < 0.6 * inner.size else "black" for place in range(inner.size)]
    axes.contour(pressure, gaps, flow, levels=inner, colors=shades, linewidths=0.7)
    axes.grid(visible=False)
    return filled


def _largest_bar(subject: ModelSubject, path: AnnularGap) -> tuple[float | None, float | None]:
    """Pressures of largest leakage, at constant viscosity and at the film's pressure, [bar]."""
    constant, film = (
        _largest_of(path, drive, subject.highest_pressure_bar)
        for drive in (subject.constant_drive_per_s, subject.film_drive_per_s)
    )
    return constant, film


def _largest_of(path: AnnularGap, drive: Callable[[Array], Array], highest: float) -> float | None:
    """Pressure of largest leakage under a drive, [bar]; None where it goes on rising."""
    from scipy.optimize import minimize_scalar

    def less(bar: float) -> float:
        at = np.array([bar])
        return -float(path.regressor(drive(at), at * BAR, np.zeros(1))[0])

    found = float(
        minimize_scalar(less, bounds=(0.0, highest), method="bounded", options={"xatol": 1e-6}).x
    )
    return round(found, 3) if found < highest - 1e-3 else None


def _pressures(subject: ModelSubject, path: AnnularGap) -> Array:
    """The pressure axis, with the pressures of largest leakage on it, [bar]."""
    largest = [bar for bar in _largest_bar(subject, path) if bar is not None]
    return np.union1d(np.linspace(0.0, subject.highest_pressure_bar, _STEPS), largest)


def _flows(path: AnnularGap, pressure_bar: Array, gaps_um: Array, drive: Array) -> Array:
    """Leakage of one interface, shape (gaps, pressures), [ml/min]."""
    e = path.eccentricity
    values = [gaps_um] if e is None else [gaps_um, np.full_like(gaps_um, e.value)]
    coefficients = path.coefficient(np.stack(values, axis=-1)) / path.count
    regressor = path.regressor(drive, pressure_bar * BAR, np.zeros_like(drive))
    return MILLILITRES * np.outer(coefficients, regressor)

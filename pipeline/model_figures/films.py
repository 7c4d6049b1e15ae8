"""Figure of the films: lubrication regime by film thickness ratio, on the axis of Stribeck."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from leakage import AnnularGap
from leakage.physics.film import REGIMES, film_thickness_ratio
from pipeline.arrays import Array
from pipeline.config.motor_types import BAR, MICROMETRE
from pipeline.model_figures.canvas import QUIET, label, line, new_figure, pen, plain_ticks
from pipeline.model_figures.gaps import PRESSURE
from pipeline.model_figures.subject import ModelSubject, stated

RATIO = "Film thickness ratio Λ"

_STEPS = 351
_LEAST_AXIS = (0.1, 200.0)
# Told apart by lightness, each with its name beside it.
_REGIME_COLOURS = ("#bd5d38", "#d9a441", "#7fb6c9", "#3f6f8f")


def films_figure(subject: ModelSubject, gaps: Sequence[AnnularGap]) -> Figure:
    """Film thickness ratio of each gap over pressure, with the lubrication regimes.

    The ratio is that of the tables: at the narrowest place, h (1 − e), with the height without
    deformation at 0 bar and h exp(−ΔP/X) above.
    """
    sigma_um = math.hypot(*subject.roughness_m) / MICROMETRE
    named = "; ".join(f"{path.name} {stated(path)}" for path in gaps)
    figure, (stribeck, pressure) = new_figure(
        f"{subject.motor.motor_type}: lubrication regime by film thickness ratio",
        2,
        note="Λ = h exp(−ΔP/X) (1 − e) / √(R_a1² + R_a2²), the root "
        f"{sigma_um:.3g} µm. Regimes by the thesis's table after its reference [12] "
        f"(2.2.4), in which they overlap.\n{named}; as configured, not fitted.",
        mark=subject.marks(*gaps),
    )
    bars = np.linspace(0.0, subject.highest_pressure_bar, _STEPS)
    ratios = [_ratios(subject, path, bars) for path in gaps]
    limits = _axis(ratios)
    _stribeck(stribeck, subject, gaps, limits)
    for path, ratio in zip(gaps, ratios, strict=True):
        line(pressure, bars, ratio, subject.places[path.name], path.name)
    for limit in sorted({end for ends in REGIMES.values() for end in ends}):
        if limits[0] < limit < limits[1]:
            pressure.axhline(limit, color=QUIET, linewidth=0.8, linestyle=":")
            pressure.text(bars[-1], limit, f" {limit:g}", va="center", color=QUIET, fontsize=8)
    pressure.set_yscale("log")
    pressure.set_ylim(*limits)
    pressure.set_xlim(0.0, bars[-1])
    plain_ticks(pressure, "y")
    label(pressure, "(b) over pressure; dotted: limits of the regimes", PRESSURE, RATIO)
    pressure.legend(loc="best")
    return figure


def _ratios(subject: ModelSubject, path: AnnularGap, bars: Array) -> Array:
    """Λ over pressure."""
    x = path.deformation_pressure_pa
    closing = np.ones_like(bars) if x is None else np.exp(-bars * BAR / x)
    e = 0.0 if path.eccentricity is None else path.eccentricity.value
    return film_thickness_ratio(path.gap.value * MICROMETRE * closing, e, *subject.roughness_m)


def _axis(ratios: Sequence[Array]) -> tuple[float, float]:
    """Ends of the axis of Λ: the regimes, and all that is drawn."""
    positive = np.concatenate(ratios)
    positive = positive[positive > 0.0]
    low, high = (positive.min(), positive.max()) if positive.size else _LEAST_AXIS
    return min(_LEAST_AXIS[0], 0.5 * float(low)), max(_LEAST_AXIS[1], 2.0 * float(high))


def _stribeck(
    axes: Axes,
    subject: ModelSubject,
    gaps: Sequence[AnnularGap],
    limits: tuple[float, float],
) -> None:
    """Rows: the regimes below, the gaps above, each from 0 bar to the reference pressure."""
    for row, (low, high) in enumerate(REGIMES.values()):
        left, right = max(low, limits[0]), min(high, limits[1])
        axes.barh(row, right - left, left=left, color=_REGIME_COLOURS[row], height=0.7)
    names = [path.name for path in gaps]
    for place, path in enumerate(gaps):
        row = len(REGIMES) + place
        ends_bar = np.array([0.0, subject.pressure_bar])
        ends = _ratios(subject, path, ends_bar)
        colour = pen(subject.places[path.name]).colour
        axes.plot(ends, [row, row], color=colour, linewidth=1.2)
        for ratio, bar, fill in zip(ends, ends_bar, ("white", colour), strict=True):
            name = f"{bar:g} bar" if place == 0 else None
            axes.plot(
                ratio, row, color=colour, marker="o", markerfacecolor=fill, linestyle="", label=name
            )
    axes.set_xscale("log")
    axes.set_xlim(*limits)
    plain_ticks(axes, "x")
    axes.set_yticks(range(len(REGIMES) + len(names)), [*REGIMES, *names])
    axes.axhline(len(REGIMES) - 0.5, color=QUIET, linewidth=0.8)
    label(axes, "(a) regimes after [12] and the films", RATIO, "")
    axes.legend(loc="upper left")

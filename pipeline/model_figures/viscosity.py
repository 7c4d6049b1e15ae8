"""Figure of the oil: dynamic viscosity over temperature and over pressure."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from leakage.physics.oil import density_kg_per_m3, dynamic_viscosity_pa_s
from pipeline.config.motor_types import BAR
from pipeline.model_figures.canvas import label, line, new_figure, pen, plain_ticks
from pipeline.model_figures.subject import ModelSubject

VISCOSITY = "Dynamic viscosity η / mPa·s"

_STEPS = 351
_TEMPERATURE_STEPS = 201
_LOWEST_C, _HIGHEST_C = 0.0, 100.0
_PRESSURES_BAR = (0.0, 100.0, 200.0, 350.0)
_TEMPERATURES_C = (20.0, 40.0, 60.0, 80.0)
_MILLIPASCAL = 1e3


def viscosity_figure(subject: ModelSubject) -> Figure:
    """Viscosity by equations (1) and (2), with the points of the data sheet."""
    figure, (temperature, pressure) = new_figure(
        f"{subject.motor.motor_type}: viscosity of {subject.oil_name}",
        2,
        note="Walther (ASTM D341) (2) with the oil's density, Barus (1), "
        f"α = {1e9 * subject.motor.oil.pressure_viscosity_per_pa:.3g} 1/GPa. "
        f"In a film: {subject.film_words()}.",
        mark=subject.marks(oil=True),
    )
    oil = subject.motor.oil
    # The usual axis, stretched to the temperatures of data sheet and config.
    named = [subject.temperature_c, *(at_c for at_c, _ in subject.reference_viscosities)]
    ends = min(_LOWEST_C, *named), max(_HIGHEST_C, *named)
    celsius = np.linspace(*ends, _TEMPERATURE_STEPS)
    for place, bar in enumerate(_PRESSURES_BAR):
        eta = _MILLIPASCAL * dynamic_viscosity_pa_s(celsius, bar * BAR, oil)
        line(temperature, celsius, eta, place, f"{bar:g} bar")
    _data_sheet(temperature, subject)
    label(temperature, "(a) over temperature", "Oil temperature T / °C", VISCOSITY)
    bars = np.linspace(0.0, subject.highest_pressure_bar, _STEPS)
    chosen = sorted({*_TEMPERATURES_C, subject.temperature_c})
    for place, at_c in enumerate(chosen):
        eta = _MILLIPASCAL * dynamic_viscosity_pa_s(at_c, bars * BAR, oil)
        line(pressure, bars, eta, place, f"{at_c:g} °C")
        pressure.text(bars[-1], eta[-1], f" {at_c:g} °C", color=pen(place).colour, va="center")
    label(pressure, "(b) over pressure", "Pressure in the film / bar", VISCOSITY)
    for axes in (temperature, pressure):
        axes.set_yscale("log")
        plain_ticks(axes, "y")
        axes.grid(visible=True, which="minor", axis="y", linewidth=0.3)
    temperature.legend(loc="upper right")
    return figure


def _data_sheet(axes: Axes, subject: ModelSubject) -> None:
    """The kinematic viscosities of the data sheet, as dynamic ones."""
    celsius, nu = (np.array(column) for column in zip(*subject.reference_viscosities, strict=True))
    eta = 1e-6 * nu * density_kg_per_m3(celsius, subject.motor.oil)
    axes.plot(
        celsius, _MILLIPASCAL * eta, color="black", marker="o", linestyle="",
        label="data sheet, at 0 bar", zorder=3,
    )  # fmt: skip

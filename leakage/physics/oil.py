"""The oil: density, viscosity under pressure, and the drive ΔP/η of a laminar leakage flow."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from leakage.arrays import Array
from leakage.errors import ParameterError
from leakage.physics.walther import kinematic_viscosity_mm2_per_s, walther_coefficients

REFERENCE_DENSITY_TEMPERATURE_C = 15.0
_M2_PER_MM2 = 1e-6

FilmPressureModel = Literal["thesis", "slot"]


@dataclass(frozen=True, slots=True)
class Oil:
    """Data-sheet constants of an oil.

    `name`: Grade, such as ``"VG 68"``.
    `walther_a, walther_b`: Constants A and B of equation (2) of the thesis, decimal logarithms,
    [-].
    `density_15_c_kg_per_m3`: Density at 15 °C, [kg/m³].
    `thermal_expansion_per_k`: Coefficient β of the density, [1/K].
    `pressure_viscosity_per_pa`: Barus coefficient α, [1/Pa].

    Raises ParameterError if a constant is not finite or outside its physical range.

    Source: the thesis, equations (1) and (2).
    """

    name: str
    walther_a: float
    walther_b: float
    density_15_c_kg_per_m3: float
    thermal_expansion_per_k: float
    pressure_viscosity_per_pa: float

    def __post_init__(self) -> None:
        positive = {"walther_b", "density_15_c_kg_per_m3"}
        for field in fields(self)[1:]:
            value = getattr(self, field.name)
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and field.name in positive):
                raise ParameterError(
                    "oil_constant",
                    f"oil {self.name!r}: {field.name} is {value:g}; give the data sheet's value,"
                    " finite and not negative",
                )

    @classmethod
    def from_reference_viscosities(
        cls,
        name: str,
        *,
        temperature_1_c: float,
        viscosity_1_mm2_per_s: float,
        temperature_2_c: float,
        viscosity_2_mm2_per_s: float,
        density_15_c_kg_per_m3: float,
        thermal_expansion_per_k: float,
        pressure_viscosity_per_pa: float,
    ) -> Oil:
        """Build an oil from two kinematic viscosities of its data sheet.

        Examples
        --------
        >>> oil = Oil.from_reference_viscosities(
        ...     "VG 68", temperature_1_c=40.0, viscosity_1_mm2_per_s=68.0,
        ...     temperature_2_c=100.0, viscosity_2_mm2_per_s=8.7, density_15_c_kg_per_m3=882.0,
        ...     thermal_expansion_per_k=7.0e-4, pressure_viscosity_per_pa=2.0e-8)
        >>> round(float(dynamic_viscosity_pa_s(50.0, 200e5, oil)), 6)
        0.055055
        """
        walther_a, walther_b = walther_coefficients(
            temperature_1_c, viscosity_1_mm2_per_s, temperature_2_c, viscosity_2_mm2_per_s
        )
        return cls(
            name,
            walther_a,
            walther_b,
            density_15_c_kg_per_m3,
            thermal_expansion_per_k,
            pressure_viscosity_per_pa,
        )


@dataclass(frozen=True, slots=True)
class FilmPressure:
    """The pressure at which the viscosity of a leakage film is taken.

    `model`: ``"thesis"``: Barus at ``share`` times the pressure difference. ``"slot"``: exact for
    laminar flow through a slot whose viscosity follows Barus along the pressure drop.
    `share`: Share of the pressure difference, 0 to 1, [-]; 1 is the thesis. Not used by ``"slot"``.

    Raises ParameterError if the model is unknown or the share outside 0 to 1.
    """

    model: FilmPressureModel = "thesis"
    share: float = 1.0

    def __post_init__(self) -> None:
        if self.model not in get_args(FilmPressureModel):
            raise ParameterError(
                "film_pressure_model",
                f"film pressure model {self.model!r} is unknown; use 'thesis' or 'slot'",
            )
        if not 0.0 <= self.share <= 1.0:
            raise ParameterError(
                "film_pressure_share",
                f"film pressure share is {self.share:g}; it must lie between 0 and 1",
            )


THESIS_FILM_PRESSURE = FilmPressure()


def density_kg_per_m3(temperature_c: ArrayLike, oil: Oil) -> Array:
    r"""Return density of the oil, shape of the temperature, [kg/m³].

    .. math:: \rho(T) = \frac{\rho_{15}}{1 + \beta (T - 15)}

    A linear expansion, good to a few per mille from -20 to 120 °C; the effect of pressure (about 1
    % at 200 bar) is left out. The thesis needs the density and does not give it.

    Examples
    --------
    >>> oil = Oil("VG 68", 9.3, 3.6, 882.0, 7.0e-4, 2.0e-8)
    >>> round(float(density_kg_per_m3(50.0, oil)), 3)
    860.908
    """
    temperature = np.asarray(temperature_c, dtype=np.float64)
    expansion = temperature - REFERENCE_DENSITY_TEMPERATURE_C
    expansion = 1.0 + oil.thermal_expansion_per_k * expansion
    return oil.density_15_c_kg_per_m3 / expansion


def dynamic_viscosity_pa_s(temperature_c: ArrayLike, pressure_pa: ArrayLike, oil: Oil) -> Array:
    r"""Dynamic viscosity at temperature and pressure above ambient (Barus), [Pa·s]; (1) of the
    thesis.

    .. math:: \eta(T, p) = 10^{-6}\,\nu(T)\,\rho(T)\,e^{\alpha p}

    Isothermal; reasonable below 0.1 GPa. Of the common shape of the arguments.

    Raises ValidityError if a temperature is outside the range of Walther's equation for this oil.

    Examples
    --------
    >>> oil = Oil("VG 68", *walther_coefficients(40.0, 68.0, 100.0, 8.7), 882.0, 7.0e-4, 2.0e-8)
    >>> round(float(dynamic_viscosity_pa_s(40.0, 40e5, oil)), 6)
    0.063854
    """
    viscosity = kinematic_viscosity_mm2_per_s(temperature_c, oil.walther_a, oil.walther_b)
    ambient = _M2_PER_MM2 * viscosity * density_kg_per_m3(temperature_c, oil)
    thickening = np.exp(oil.pressure_viscosity_per_pa * np.asarray(pressure_pa, dtype=np.float64))
    result: Array = ambient * thickening
    return result


def flow_drive_per_s(
    pressure_difference_pa: ArrayLike,
    temperature_c: ArrayLike,
    oil: Oil,
    film_pressure: FilmPressure = THESIS_FILM_PRESSURE,
) -> Array:
    r"""Drive ΔP/η of a laminar leakage flow, [1/s]; never negative, the sign of ΔP has no effect.

    .. math:: \frac{|\Delta P|}{\eta(T, s |\Delta P|)} \;\text{(thesis, (1) and (3))}, \qquad
        \frac{1 - e^{-\alpha |\Delta P|}}{\alpha\, \eta(T, 0)} \;\text{(slot)}

    Of the common shape of the arguments. The slot's drive is the integral of dp/η(p) over the
    pressure drop. The thesis's share 1 is below it, by 19 % at 200 bar and α = 2e-8 1/Pa; a share
    of 0.47 to 0.49 equals it from 100 to 350 bar.

    Raises ValidityError if a temperature is outside the range of Walther's equation for this oil.

    Examples
    --------
    >>> oil = Oil("VG 68", *walther_coefficients(40.0, 68.0, 100.0, 8.7), 882.0, 7.0e-4, 2.0e-8)
    >>> thesis, slot = (flow_drive_per_s(-200e5, 50.0, oil, FilmPressure(model))
    ...                 for model in ("thesis", "slot"))
    >>> print(f"{thesis:.4g} {slot:.4g} {thesis / slot - 1:.2f}")
    3.633e+08 4.467e+08 -0.19
    """
    pressure = np.abs(np.asarray(pressure_difference_pa, dtype=np.float64))
    if film_pressure.model == "slot":
        # Where pressure does not thicken the oil, the pressure itself.
        alpha = oil.pressure_viscosity_per_pa
        driving = np.expm1(-alpha * pressure) / -alpha if alpha else pressure
        return driving / dynamic_viscosity_pa_s(temperature_c, 0.0, oil)
    return pressure / dynamic_viscosity_pa_s(temperature_c, film_pressure.share * pressure, oil)

"""The oil: density, viscosity by Walther's equation (ASTM D341) and under pressure, drive ΔP/η."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from leakage.arrays import Array
from leakage.errors import ParameterError, ValidityError

CELSIUS_ZERO_K = 273.15
PLAIN_WALTHER_MINIMUM_MM2_PER_S = 2.0  # below, D341 needs its full form
FULL_WALTHER_MINIMUM_MM2_PER_S = 0.21  # below, D341 does not hold at all
TEMPERATURE_RANGE_C = (-70.0, 370.0)  # of the charts of D341

_LN10 = math.log(10.0)


def walther_coefficients(
    temperature_1_c: float,
    viscosity_1_mm2_per_s: float,
    temperature_2_c: float,
    viscosity_2_mm2_per_s: float,
) -> tuple[float, float]:
    r"""Return Walther constants A and B from two kinematic viscosities [mm²/s], (2) of the thesis.

    .. math:: B = \frac{\log_{10}\log_{10} Z_1 - \log_{10}\log_{10} Z_2}
        {\log_{10}(T_2 + 273.15) - \log_{10}(T_1 + 273.15)}, \quad
        A = \log_{10}\log_{10} Z_1 + B \log_{10}(T_1 + 273.15)

    with :math:`Z = \nu + 0.7` from 2 mm²/s upwards and D341's full form below. Valid from
    0.21 mm²/s and from -70 to 370 °C. The order of the two points does not matter.

    Raises ParameterError if the temperatures coincide, or the viscosity does not fall with
    temperature. Raises ValidityError if a temperature or a viscosity is outside the range of D341.

    Examples
    --------
    >>> a, b = walther_coefficients(40.0, 46.0, 100.0, 6.8)
    >>> f"{a:.4f} {b:.4f}"
    '9.4180 3.6844'
    """
    _require_temperature_range(np.array([temperature_1_c, temperature_2_c]))
    log_temperature_1, log_temperature_2 = (
        math.log10(temperature + CELSIUS_ZERO_K)
        for temperature in (temperature_1_c, temperature_2_c)
    )
    double_log_1, double_log_2 = (
        math.log10(math.log10(_walther_z(viscosity)))
        for viscosity in (viscosity_1_mm2_per_s, viscosity_2_mm2_per_s)
    )
    if (log_temperature_2 - log_temperature_1) * (double_log_1 - double_log_2) <= 0.0:
        raise ParameterError(
            "oil_reference_viscosities",
            f"reference viscosities {viscosity_1_mm2_per_s:g} mm²/s at {temperature_1_c:g} °C and"
            f" {viscosity_2_mm2_per_s:g} mm²/s at {temperature_2_c:g} °C do not fall with"
            " temperature; check the data sheet",
        )
    walther_b = (double_log_1 - double_log_2) / (log_temperature_2 - log_temperature_1)
    return walther_through(temperature_1_c, viscosity_1_mm2_per_s, walther_b), walther_b


def walther_through(temperature_c: float, viscosity_mm2_per_s: float, walther_b: float) -> float:
    """Return Walther constant A of the curve of slope B through a viscosity; as `_walther_z`.

    Examples
    --------
    >>> round(walther_through(40.0, 46.0, 3.6844), 3)
    9.418
    """
    double_log = math.log10(math.log10(_walther_z(viscosity_mm2_per_s)))
    return double_log + walther_b * math.log10(temperature_c + CELSIUS_ZERO_K)


def kinematic_viscosity_mm2_per_s(
    temperature_c: ArrayLike, walther_a: float, walther_b: float
) -> Array:
    r"""Return kinematic viscosity by Walther's equation (ASTM D341) [mm²/s].

    .. math:: \log_{10}\log_{10} Z = A - B \log_{10}(T + 273.15), \quad \nu = Z - 0.7

    Below 2 mm²/s D341's full form follows, with :math:`x = Z - 0.7`:

    .. math:: \nu = x - \exp(-0.7487 - 3.295 x + 0.6119 x^2 - 0.3193 x^3)

    where ν steps down by 0.03 %. nan where the temperature is nan.

    Raises ValidityError if a temperature is outside -70 to 370 °C, or a viscosity below 0.21 mm²/s.

    Examples
    --------
    >>> a, b = walther_coefficients(40.0, 46.0, 100.0, 6.8)
    >>> round(float(kinematic_viscosity_mm2_per_s(0.0, a, b)), 1)
    577.3
    """
    temperature = np.asarray(temperature_c, dtype=np.float64)
    _require_temperature_range(temperature)
    # 10**x as exp(x ln 10): the exponential is the faster of the two.
    log10_z = np.exp(_LN10 * walther_a - walther_b * np.log(temperature + CELSIUS_ZERO_K))
    viscosity: Array = np.exp(_LN10 * log10_z) - 0.7
    if np.any(viscosity < PLAIN_WALTHER_MINIMUM_MM2_PER_S):
        return _full_walther_viscosity(viscosity)
    return viscosity


def _walther_z(viscosity_mm2_per_s: float) -> float:
    """Return z of a kinematic viscosity, D341's full form below 2 mm²/s."""
    if not FULL_WALTHER_MINIMUM_MM2_PER_S <= viscosity_mm2_per_s < math.inf:
        raise ValidityError(
            "oil_viscosity_range",
            f"a reference viscosity of {viscosity_mm2_per_s:g} mm²/s is outside ASTM D341, which"
            f" holds from {FULL_WALTHER_MINIMUM_MM2_PER_S:g} mm²/s; check the data sheet's unit",
        )
    if viscosity_mm2_per_s >= PLAIN_WALTHER_MINIMUM_MM2_PER_S:
        return viscosity_mm2_per_s + 0.7
    exponent = -1.47 + viscosity_mm2_per_s * (-1.84 - 0.51 * viscosity_mm2_per_s)
    return viscosity_mm2_per_s + 0.7 + math.exp(exponent)


def _full_walther_viscosity(plain: Array) -> Array:
    """Replace the viscosities below 2 mm²/s by those of D341's full form."""
    thin = np.minimum(plain, PLAIN_WALTHER_MINIMUM_MM2_PER_S)
    exponent = -0.7487 + thin * (-3.295 + thin * (0.6119 - 0.3193 * thin))
    full = np.where(plain < PLAIN_WALTHER_MINIMUM_MM2_PER_S, thin - np.exp(exponent), plain)
    if np.any(full < FULL_WALTHER_MINIMUM_MM2_PER_S):
        raise ValidityError(
            "oil_viscosity_range",
            f"a viscosity falls to {np.nanmin(full):.3g} mm²/s, below the"
            f" {FULL_WALTHER_MINIMUM_MM2_PER_S:g} mm²/s from which ASTM D341 holds; narrow the"
            " valid range of the temperature channel",
        )
    return full


def _require_temperature_range(temperature_c: Array) -> None:
    lowest, highest = TEMPERATURE_RANGE_C
    # A temperature that is nan is not compared, but looked at below.
    if (
        temperature_c.min(initial=lowest) >= lowest
        and temperature_c.max(initial=highest) <= highest
    ):
        return
    outside = (temperature_c < lowest) | (temperature_c > highest)
    if np.any(outside):
        raise ValidityError(
            "oil_temperature_range",
            f"an oil temperature of {np.atleast_1d(temperature_c)[np.atleast_1d(outside)][0]:g} °C"
            f" is outside ASTM D341 ({lowest:g} to {highest:g} °C); narrow the valid range of the"
            " temperature channel, or check its unit",
        )


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
    r"""Return dynamic viscosity at temperature and pressure (Barus) [Pa·s]; (1) of the
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
    r"""Return drive ΔP/η of a laminar leakage flow, [1/s]; never negative, whatever the sign of ΔP.

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

"""Kinematic viscosity over temperature: Walther's equation, ASTM D341."""

from __future__ import annotations

import math

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
    """Walther constant A of the curve of slope B through one viscosity; raises as `_walther_z`.

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
    r"""Kinematic viscosity by Walther's equation (ASTM D341), shape of the temperature, [mm²/s].

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
    # 10**x as exp(x ln 10): the exponential is the fast one of the two.
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
    # One that is nan is not compared, but looked at below.
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

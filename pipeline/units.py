"""Names and units of the channels, and the only place where a reading becomes canonical.

The factors are exact by definition of the units (BIPM SI brochure, 9th ed., and NIST SP 811,
appendix B, for inch, pound-force, kilogram-force and the gallons).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


class Conversion(NamedTuple):
    """canonical = (value + shift) * numerator / denominator.

    Numerator and denominator apart: 1 bar in 100 kPa is then exact, which a factor of 0.01 would
    not be.
    """

    numerator: float
    denominator: float = 1.0
    shift: float = 0.0


_PSI_PA = 4.4482216152605 / 0.0254**2
_US_GALLON_L = 3.785411784
_IMPERIAL_GALLON_L = 4.54609

UNITS: Mapping[str, Mapping[str, Conversion]] = {
    "pressure": {
        "bar": Conversion(1.0),
        "mbar": Conversion(1.0, 1000.0),
        "Pa": Conversion(1.0, 1e5),
        "kPa": Conversion(1.0, 100.0),
        "MPa": Conversion(10.0),
        "psi": Conversion(_PSI_PA, 1e5),
        "kgf/cm2": Conversion(0.980665),
    },
    "temperature": {
        "degC": Conversion(1.0),
        "degF": Conversion(5.0, 9.0, shift=-32.0),
        "K": Conversion(1.0, shift=-273.15),
    },
    "speed": {
        "rpm": Conversion(1.0),
        "1/s": Conversion(60.0),
        "rad/s": Conversion(30.0, math.pi),
        "deg/s": Conversion(1.0, 6.0),
    },
    "flow": {
        "l/min": Conversion(1.0),
        "l/h": Conversion(1.0, 60.0),
        "l/s": Conversion(60.0),
        "ml/min": Conversion(1.0, 1000.0),
        "cm3/min": Conversion(1.0, 1000.0),
        "cm3/s": Conversion(60.0, 1000.0),
        "m3/h": Conversion(1000.0, 60.0),
        "m3/s": Conversion(60000.0),
        "us_gal/min": Conversion(_US_GALLON_L),
        "imperial_gal/min": Conversion(_IMPERIAL_GALLON_L),
    },
    "time": {
        "h": Conversion(1.0),
        "min": Conversion(1.0, 60.0),
        "s": Conversion(1.0, 3600.0),
        "d": Conversion(24.0),
    },
    "kinematic viscosity": {
        "mm2/s": Conversion(1.0),
        "cSt": Conversion(1.0),
        "m2/s": Conversion(1e6),
    },
    "dynamic viscosity": {
        "mPa.s": Conversion(1.0),
        "cP": Conversion(1.0),
        "Pa.s": Conversion(1000.0),
    },
}
"""Units that a log may be in, by quantity; the first of each is canonical."""

# Quantity of each channel, and the limits of its readings where its config states none.
_CHANNELS = {
    "pressure_difference": ("pressure", (-450.0, 450.0)),
    "high_port_pressure": ("pressure", (-1.0, 450.0)),
    "low_port_pressure": ("pressure", (-1.0, 450.0)),
    "charge_pressure": ("pressure", (-1.0, 100.0)),
    "case_pressure": ("pressure", (-1.0, 50.0)),
    "oil_temperature": ("temperature", (-40.0, 120.0)),
    "speed": ("speed", (-500.0, 500.0)),
    "leakage_flow": ("flow", (0.0, 200.0)),
    "running_hours": ("time", (0.0, 1e6)),
    "kinematic_viscosity": ("kinematic viscosity", (1.0, 5000.0)),
    "dynamic_viscosity": ("dynamic viscosity", (1.0, 5000.0)),
}
QUANTITIES = {name: quantity for name, (quantity, _) in _CHANNELS.items()}
"""Quantity of each channel."""
FALLBACK_VALID_RANGE = {name: limits for name, (_, limits) in _CHANNELS.items()}
"""Limits of the readings of each channel that states none, in its canonical unit."""

RUNNING_HOURS = "running_hours"
"""A counter: no sample of it is judged, interpolated or needed."""

CHANNELS: tuple[str, ...] = tuple(QUANTITIES)
"""Names of the channels, everywhere."""


def canonical_unit(channel: str) -> str:
    """Return the unit of a channel from its reader to the tables."""
    return next(iter(UNITS[QUANTITIES[channel]]))


def to_canonical(channel: str, values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """Return readings of a channel in its canonical unit; what is not finite stays as it is.

    Raises as `conversion`.
    """
    import numpy as np

    numerator, denominator, shift = UNITS[QUANTITIES[channel]][unit]
    # A reading may be beyond float64 in another unit, or a signalling nan: it is then not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        readings = np.array(values, dtype=np.float64)
        if shift:
            readings += shift
        if numerator != 1.0:
            readings *= numerator
        if denominator != 1.0:
            readings /= denominator
    return readings


def from_canonical(channel: str, values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """Return readings of a channel in a unit of a log: the inverse of `to_canonical`."""
    import numpy as np

    numerator, denominator, shift = UNITS[QUANTITIES[channel]][unit]
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array(values, dtype=np.float64) * denominator / numerator - shift

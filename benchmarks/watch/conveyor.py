"""A conveyor's drives: steady, outdoors, several on a tank.

Oil of Andrade's law. Leakage between a laminar and a turbulent one, of pressure to the 1.15 and
viscosity to the −0.85, and a part that the speed pumps to the case.
"""

from __future__ import annotations

import numpy as np

from benchmarks.watch.foreign import Duty, levels, nightly, slow
from pipeline.arrays import Array

GAP = 0.062  # l/min of 1 bar and 1 mPa s
PUMPED = 0.0016  # l/min of 1 rpm, to the 1.3


def viscosity_mpa_s(temperature_c: Array) -> Array:
    """Andrade's law: 60 mPa s at 40 °C, 36 at 50 °C."""
    found: Array = 60.0 * np.exp(5150.0 * (1.0 / (temperature_c + 273.15) - 1.0 / 313.15))
    return found


class Conveyor:
    """It carries what comes: the belt's load changes in a quarter of an hour."""

    def operating_point(self, generator: np.random.Generator, load: Array, warmer_k: Array) -> Duty:
        """A belt of one speed, or nearly; oil as warm as the day."""
        nights = len(load)
        level = generator.uniform(95.0, 125.0, nights)
        belt = levels(generator, nights, 900.0, 120.0) + 0.3 * levels(generator, nights, 60.0, 5.0)
        pressure = load * (level + 60.0 * (belt - 0.65))
        speed = 30.0 + 5.0 * levels(generator, nights, 1800.0, 60.0)
        warm = generator.normal(46.0, 1.5, nights) + warmer_k
        return pressure, warm + 3.0 * levels(generator, nights, 1800.0, 900.0), speed

    def flow(self, operating_point: Duty, wear: Array, thinning: Array) -> Array:
        """Gaps that wear, and what the speed pumps."""
        pressure, temperature, speed = operating_point
        eta = viscosity_mpa_s(temperature) * thinning
        found: Array = GAP * wear * pressure**1.15 / eta**0.85 + PUMPED * speed**1.3
        return found

    def errors(self, generator: np.random.Generator, nights: int) -> Duty:
        """A turbine meter; sensors in a cabinet that warms."""
        white = generator.standard_normal(slow(generator, nights, 600.0).shape)
        flow = 0.015 * white + 0.01 * slow(generator, nights, 600.0)
        return (
            flow + 0.003 * nightly(generator, nights, 0.6),
            0.3 * generator.standard_normal((1, nights)),
            (0.3 * nightly(generator, nights, 0.6))[None],
        )

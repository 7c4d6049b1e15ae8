"""A mill's drive: slow, heavily loaded, its pressure difference read from two gauges.

Oil of Vogel's law. Leakage of both sides past gaps to the case, a part that a speed of 4 to 9 rpm
drags along, and a bleed through an orifice.
"""

from __future__ import annotations

import numpy as np

from benchmarks.watch.foreign import Duty, levels, nightly, slow
from pipeline.arrays import Array

CHARGE_BAR = 14.5  # of the low side above the case
GAP = 0.18  # l/min a bar, of 1 mPa s
DRAG = 0.02  # l/min a rpm
BLEED = 0.016  # l/min a √bar


def viscosity_mpa_s(temperature_c: Array) -> Array:
    """Vogel's law: 59 mPa s at 40 °C, 7.3 at 100 °C."""
    found: Array = 0.0573 * np.exp(962.0 / (temperature_c + 98.7))
    return found


class Mill:
    """What it grinds is uneven: loads of minutes about a level of the night."""

    def operating_point(self, generator: np.random.Generator, load: Array, warmer_k: Array) -> Duty:
        """Loads of three minutes, speeds of twenty; the oil follows the day."""
        nights = len(load)
        level = generator.uniform(150.0, 210.0, nights)
        pressure = load * (level + 90.0 * (levels(generator, nights, 180.0, 8.0) - 0.5))
        speed = 4.0 + 5.0 * levels(generator, nights, 1200.0, 30.0)
        warm = generator.normal(51.0, 2.0, nights) + warmer_k
        return pressure, warm + 4.0 * levels(generator, nights, 1200.0, 600.0), speed

    def flow(self, operating_point: Duty, wear: Array, thinning: Array) -> Array:
        """Gaps that wear, drag, bleed."""
        pressure, temperature, speed = operating_point
        both_sides = pressure + 2.0 * CHARGE_BAR
        gaps = GAP * wear * both_sides / (viscosity_mpa_s(temperature) * thinning)
        found: Array = gaps + DRAG * speed + BLEED * np.sqrt(pressure + CHARGE_BAR)
        return found

    def errors(self, generator: np.random.Generator, nights: int) -> Duty:
        """A good meter, two gauges that do not agree, a sensor in the return line."""
        white = 0.012 * generator.standard_normal(slow(generator, nights, 900.0).shape)
        flow = white + 0.008 * slow(generator, nights, 900.0)
        gauges = 0.25 * generator.standard_normal((2, nights))
        return (
            flow + 0.003 * nightly(generator, nights, 0.5),
            (gauges[0] - gauges[1])[None],
            (0.3 * nightly(generator, nights, 0.6))[None],
        )

"""A harbour winch: loads come and go, and its clearances grow as it warms.

An oil whose viscosity falls by a constant share a kelvin and rises with pressure; gaps whose height
follows the temperature; a valve plate that lifts under load; churning.
"""

from __future__ import annotations

import numpy as np

from benchmarks.watch.foreign import ROWS, STEP_S, Duty, nightly, slow
from pipeline.arrays import Array

IDLE_BAR, LIFT_BAR = (18.0, 30.0), (170.0, 290.0)
IDLE_S, LIFT_S = 70.0, 90.0  # how long each lasts on average
GAP, PLATE = 0.125, 0.0034  # l/min a bar and a bar^1.5, of 1 mPa s
CHURNING = 0.0025  # l/min a rpm
GROWS_PER_K = 0.003  # of a gap's height


def viscosity_mpa_s(pressure_bar: Array, temperature_c: Array) -> Array:
    """47 mPa s at 45 °C, 4 % less a kelvin, 0.17 % more a bar."""
    warmer = temperature_c - 45.0
    found: Array = 47.0 * np.exp(-0.041 * warmer + 0.00012 * warmer**2 + 0.0017 * pressure_bar)
    return found


class Winch:
    """It lifts for a minute or two, and waits."""

    def operating_point(self, generator: np.random.Generator, load: Array, warmer_k: Array) -> Duty:
        """Idling and lifts, each with a load and a speed of its own."""
        nights = len(load)
        lifts = np.zeros((ROWS, nights), dtype=np.bool_)
        size, pace = np.zeros((ROWS, nights)), np.zeros((ROWS, nights))
        is_lift, drawn = np.zeros(nights, dtype=np.bool_), generator.random((2, nights))
        for row in range(ROWS):
            ends = generator.random(nights) < STEP_S / np.where(is_lift, LIFT_S, IDLE_S)
            drawn = np.where(ends, generator.random((2, nights)), drawn)
            is_lift = is_lift ^ ends
            lifts[row], size[row], pace[row] = is_lift, *drawn
        idle = IDLE_BAR[0] + (IDLE_BAR[1] - IDLE_BAR[0]) * size
        lifting = load * (LIFT_BAR[0] + (LIFT_BAR[1] - LIFT_BAR[0]) * size)
        time_s = STEP_S * np.arange(ROWS)[:, None]
        warm = generator.normal(47.0, 2.5, nights) + warmer_k
        temperature = warm - generator.uniform(3.0, 9.0, nights) * np.exp(-time_s / 1500.0)
        return np.where(lifts, lifting, idle), temperature, np.where(lifts, 12.0 + 45.0 * pace, 0.5)

    def flow(self, operating_point: Duty, wear: Array, thinning: Array) -> Array:
        """Gaps that wear, the plate, churning."""
        pressure, temperature, speed = operating_point
        drive = pressure / (viscosity_mpa_s(pressure, temperature) * thinning)
        height = 1.0 + GROWS_PER_K * (temperature - 45.0)
        found: Array = (GAP * wear * height**3 + PLATE * np.sqrt(pressure)) * drive
        return found + CHURNING * speed

    def errors(self, generator: np.random.Generator, nights: int) -> Duty:
        """A gear meter on a swinging drain, and nights that are not quite alike."""
        flow = 0.02 * generator.standard_normal((ROWS, nights))
        flow += 0.012 * slow(generator, nights, 500.0)
        return (
            flow + 0.003 * nightly(generator, nights, 0.6),
            0.5 * generator.standard_normal((1, nights)),
            (0.3 * nightly(generator, nights, 0.6))[None],
        )

"""Machines that nobody here fitted, each with physics, oil and errors of its own.

No machine knows the fitted model or its constants. The model sees what a log has: pressure
difference, temperature, speed and drain flow; its paths are those of a CB560.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.watch.simulator import STEP_S, Duty, Errors, Machine, State, levels
from pipeline.arrays import Array
from pipeline.demo.fleet import autoregression, phi_of

BASELINE = 15  # nights whose conditions are the machine's own
ROWS = round(3600.0 / STEP_S)
Generator = np.random.Generator


@dataclass(frozen=True)
class Foreign(Machine):
    """What its sensors make of a machine: errors of the flow over the flow, of ΔP and of °C."""

    # quick, slow, gain_phi: errors of each sample and those that forget, the memory of a night's.
    quick: float
    slow: float
    memory_s: float
    bar: float
    gain_phi: float = 0.6
    two_gauges: bool = False  # whose difference is ΔP
    draws: int = 3  # of errors of samples, of which the last two count
    own_every = 12

    def errors(self, seed: Sequence[int], n: int, nights: int) -> Errors:
        """Of the meter, and of sensors that err alike all night."""
        of_samples = np.random.default_rng([*seed, 1])
        quick, slow = of_samples.standard_normal((self.draws, n, nights))[-2:]
        flow = self.quick * quick + self.slow * autoregression(slow, phi_of(STEP_S, self.memory_s))
        first, second, third, fourth = of_samples.standard_normal((4, nights))
        gain, bar, warm = (
            (third, first - second, fourth) if self.two_gauges else (first, second, third)
        )
        return Errors(
            1.0 + flow + 0.003 * autoregression(gain, self.gain_phi),
            self.bar * bar,
            0.3 * autoregression(warm, 0.6),
        )


class Mill(Foreign):
    """A mill's drive: slow, heavily loaded, its pressure difference read from two gauges.

    Oil of Vogel's law. Leakage of both sides past gaps to the case, a part that a speed of 4 to
    9 rpm drags along, and a bleed through an orifice.
    """

    CHARGE_BAR = 14.5  # of the low side above the case
    GAP = 0.18  # l/min a bar, of 1 mPa s
    DRAG = 0.02  # l/min a rpm
    BLEED = 0.016  # l/min a √bar

    def duty(self, generator: Generator, nights: int, state: State) -> Duty:
        """Loads of three minutes about a level of the night, speeds of twenty, oil of the day."""
        level = generator.uniform(150.0, 210.0, nights)
        uneven = 90.0 * (levels(generator, ROWS, nights, 180.0, 8.0) - 0.5)
        speed = 4.0 + 5.0 * levels(generator, ROWS, nights, 1200.0, 30.0)
        warm = generator.normal(51.0, 2.0, nights) + state.warmer_k
        warming = 4.0 * levels(generator, ROWS, nights, 1200.0, 600.0)
        return Duty(state.load * (level + uneven), warm + warming, speed)

    def flow(self, duty: Duty, state: State) -> Array:
        """Gaps that wear, drag, bleed; 59 mPa s at 40 °C, 7.3 at 100 °C."""
        pressure, temperature, speed = duty
        mpa_s = 0.0573 * np.exp(962.0 / (temperature + 98.7)) * state.viscosity
        gaps = self.GAP * state.wear * (pressure + 2.0 * self.CHARGE_BAR) / mpa_s
        bleed = self.BLEED * np.sqrt(pressure + self.CHARGE_BAR)
        flow: Array = gaps + self.DRAG * speed + bleed
        return flow


class Winch(Foreign):
    """A harbour winch: loads come and go, and its clearances grow as it warms.

    An oil whose viscosity falls by a constant share a kelvin and rises with pressure; gaps whose
    height follows the temperature; a valve plate that lifts under load; churning.
    """

    IDLE_BAR, LIFT_BAR = (18.0, 30.0), (170.0, 290.0)
    IDLE_S, LIFT_S = 70.0, 90.0  # how long each lasts on average
    GAP, PLATE = 0.125, 0.0034  # l/min a bar and a bar^1.5, of 1 mPa s
    CHURNING = 0.0025  # l/min a rpm
    GROWS_PER_K = 0.003  # of a gap's height

    def duty(self, generator: Generator, nights: int, state: State) -> Duty:
        """Idling and lifts, each with a load and a speed of its own."""
        lifts = np.zeros((ROWS, nights), dtype=np.bool_)
        size, pace = np.zeros((2, ROWS, nights))
        is_lift, drawn = np.zeros(nights, dtype=np.bool_), generator.random((2, nights))
        for row in range(ROWS):
            ends = generator.random(nights) < STEP_S / np.where(is_lift, self.LIFT_S, self.IDLE_S)
            drawn = np.where(ends, generator.random((2, nights)), drawn)
            is_lift = is_lift ^ ends
            lifts[row], size[row], pace[row] = is_lift, *drawn
        idle, lift = (low + (high - low) * size for low, high in (self.IDLE_BAR, self.LIFT_BAR))
        pressure = np.where(lifts, state.load * lift, idle)
        warm = generator.normal(47.0, 2.5, nights) + state.warmer_k
        time_s = STEP_S * np.arange(ROWS)[:, None]
        temperature = warm - generator.uniform(3.0, 9.0, nights) * np.exp(-time_s / 1500.0)
        return Duty(pressure, temperature, np.where(lifts, 12.0 + 45.0 * pace, 0.5))

    def flow(self, duty: Duty, state: State) -> Array:
        """Gaps that wear, the plate, churning; 47 mPa s at 45 °C, 0.17 % more a bar."""
        pressure, temperature, speed = duty
        warmer = temperature - 45.0
        mpa_s = 47.0 * np.exp(-0.041 * warmer + 0.00012 * warmer**2 + 0.0017 * pressure)
        gaps = self.GAP * state.wear * (1.0 + self.GROWS_PER_K * warmer) ** 3
        drive = pressure / (mpa_s * state.viscosity)
        flow: Array = (gaps + self.PLATE * np.sqrt(pressure)) * drive + self.CHURNING * speed
        return flow


class Conveyor(Foreign):
    """A conveyor's drives: steady, outdoors, several on a tank.

    Oil of Andrade's law. Leakage between laminar and turbulent, of pressure to the 1.15 and
    viscosity to the −0.85, and a part that the speed pumps to the case.
    """

    GAP = 0.062  # l/min of 1 bar and 1 mPa s
    PUMPED = 0.0016  # l/min of 1 rpm, to the 1.3

    def duty(self, generator: Generator, nights: int, state: State) -> Duty:
        """A belt of nearly constant speed, its load new in a quarter of an hour; oil of the day."""
        level = generator.uniform(95.0, 125.0, nights)
        belt = levels(generator, ROWS, nights, 900.0, 120.0)
        belt = belt + 0.3 * levels(generator, ROWS, nights, 60.0, 5.0)
        speed = 30.0 + 5.0 * levels(generator, ROWS, nights, 1800.0, 60.0)
        warm = generator.normal(46.0, 1.5, nights) + state.warmer_k
        warming = 3.0 * levels(generator, ROWS, nights, 1800.0, 900.0)
        return Duty(state.load * (level + 60.0 * (belt - 0.65)), warm + warming, speed)

    def flow(self, duty: Duty, state: State) -> Array:
        """Gaps that wear, and what the speed pumps; 60 mPa s at 40 °C, 36 at 50 °C."""
        pressure, temperature, speed = duty
        mpa_s = 60.0 * np.exp(5150.0 * (1.0 / (temperature + 273.15) - 1.0 / 313.15))
        gaps = self.GAP * state.wear * pressure**1.15 / (mpa_s * state.viscosity) ** 0.85
        flow: Array = gaps + self.PUMPED * speed**1.3
        return flow


MACHINES: Mapping[str, Machine] = {
    "mill": Mill(0.012, 0.008, 900.0, 0.25, gain_phi=0.5, two_gauges=True),
    "winch": Winch(0.02, 0.012, 500.0, 0.5, draws=2),
    "conveyor": Conveyor(0.015, 0.01, 600.0, 0.3),
}

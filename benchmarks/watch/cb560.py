"""A CB560 with the placeholders of its type: fitted, or not quite.

A night is an hour of load steps in a warm-up, up to a load and a speed that differ from night to
night. Its drain flow has short and slow errors as a real record has them
(`benchmarks/results/noise.md`), its sensors wander from night to night.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.watch.simulator import (
    MODEL,
    STEP_S,
    THETA,
    Duty,
    Errors,
    Machine,
    State,
    levels,
)
from leakage import regressors
from leakage.physics.oil import FilmPressure, Oil
from pipeline.arrays import Array
from pipeline.demo.fleet import autoregression, phi_of

VG46 = Oil.from_reference_viscosities(
    "VG 46",
    temperature_1_c=40.0,
    viscosity_1_mm2_per_s=46.0,
    temperature_2_c=100.0,
    viscosity_2_mm2_per_s=6.8,
    density_15_c_kg_per_m3=882.0,
    thermal_expansion_per_k=7e-4,
    pressure_viscosity_per_pa=2e-8,
)
# Ranges from which a night's highest load [bar] and speed [rpm] are drawn.
TOP_BAR, TOP_RPM = (220.0, 300.0), (80.0, 110.0)
# Wander of sensors from night to night: gain and temperature with a memory, pressure without; of
# odd nights, times Student's t of 3.
WANDER_GAIN, WANDER_TEMPERATURE_C, WANDER_PRESSURE_BAR, ODD_GAIN = 0.003, 0.3, 0.3, 0.06
# Errors of a drain flow over the flow as on a real record (`benchmarks/results/noise.md`): short
# ones and their φ at 1 Hz, and slow ones with the time over which they forget.
RECORDED_SHORT, RECORDED_PHI, RECORDED_SLOW, RECORDED_SLOW_S = 0.013, 0.4, 0.0145, 600.0
# Of a mean of so many samples at 1 Hz of the short errors.
SHORT = RECORDED_SHORT * np.sqrt((1.0 + RECORDED_PHI) / (1.0 - RECORDED_PHI) / STEP_S)
# Deformation pressure of a ring that leaks at low pressure.
RING_PA = 120e5


@dataclass(frozen=True)
class CB560(Machine):
    """In what a motor, its sensors and its nights differ from the usual and from the model."""

    # Pressure at which its films have their viscosity.
    film_pressure: FilmPressure = MODEL.film_pressure
    # Change of all flows with temperature beyond that of the viscosity [1/K].
    per_kelvin: float = 0.0
    # Charge pressure that leaks past the low side; None: leakage is one-sided.
    charge_bar: float | None = None
    # Coefficients of ring, piston, sleeve, flushing [l/min], and the factor of the rollers' curve.
    coefficients: tuple[float, ...] = (*THETA.tolist(), 1.0)
    wander: float = 1.0  # factor on the wander of sensors
    phi: float = 0.6  # memory of the wander
    odd: float = 0.0  # share of odd nights
    paths: float = 0.0  # wander of each path
    minutes: int = 60  # of a night
    bar: tuple[float, float] | None = None  # every load is between these; None: a night's highest

    @property
    def flushing_l_per_min(self) -> float:
        """Flow in the drain line that is no leakage."""
        return self.coefficients[-2]

    def duty(self, generator: np.random.Generator, nights: int, state: State) -> Duty:
        """A warm-up under steps of load: 60 s of pressure, 90 s of speed."""
        n = round(60.0 * self.minutes / STEP_S)

        def drawn(low: float, high: float) -> Array:
            return generator.uniform(low, high, nights)

        warm_c, cold_k, tau_s = drawn(54.0, 60.0), drawn(8.0, 16.0), drawn(1200.0, 2400.0)
        top_bar, top_rpm = drawn(*TOP_BAR) * state.load, drawn(*TOP_RPM) * state.speed
        low_bar, high_bar = self.bar or (15.0, top_bar)
        warming = cold_k * np.exp(-STEP_S * np.arange(n)[:, None] / tau_s)
        temperature = warm_c - warming + 3.0 * levels(generator, n, nights, 600.0, 200.0) - 1.5
        return Duty(
            low_bar + (high_bar - low_bar) * levels(generator, n, nights, 60.0, 3.0),
            temperature + state.warmer_k,
            3.0 + (top_rpm - 3.0) * levels(generator, n, nights, 90.0, 3.0),
        )

    def flow(self, duty: Duty, state: State) -> Array:
        """Of all paths."""
        flow = self._of_paths(MODEL.oil, duty, state)
        if np.any(state.vg46):
            flow = np.where(state.vg46, self._of_paths(VG46, duty, state), flow)
        flow *= 1.0 + self.per_kelvin * (duty.temperature_c - 55.0)
        low = flow * np.exp(-3e5 * duty.pressure_bar / RING_PA)
        with_ring: Array = flow + low * state.ring_like * (flow.sum(axis=0) / low.sum(axis=0))
        return with_ring

    def _of_paths(self, oil: Oil, duty: Duty, state: State) -> Array:
        n, nights = duty.pressure_bar.shape
        of = replace(MODEL, oil=oil, film_pressure=self.film_pressure)
        columns = regressors(of, duty.conditions(self.charge_bar)).reshape(nights, n, -1)
        theta = np.tile(self.coefficients, (nights, 1))
        theta[:, :3] *= state.wander
        for column, factor in enumerate(
            (state.piston_ring, state.balance_piston, state.balance_sleeve)
        ):
            theta[:, column] *= state.wear * factor
        theta[:, [0, 1, 2, 4]] /= np.reshape(state.viscosity, (-1, 1))
        flow: Array = np.einsum("kni,ki->nk", columns, theta)
        return flow

    def errors(self, seed: Sequence[int], n: int, nights: int) -> Errors:
        """Short and slow ones of the flow, and the wander."""
        of_samples, of_nights = (np.random.default_rng([*seed, part]) for part in (1, 2))
        remembered = autoregression(of_nights.standard_normal((nights, 5)), self.phi)
        odd = of_nights.standard_t(3.0, nights) * (of_nights.random(nights) < self.odd)
        pressure = WANDER_PRESSURE_BAR * self.wander * of_nights.standard_normal(nights)
        short = of_samples.standard_normal((n, nights))
        slow = of_samples.standard_normal((n, nights))
        flow = SHORT * short + RECORDED_SLOW * autoregression(slow, phi_of(STEP_S, RECORDED_SLOW_S))
        return Errors(
            (1.0 + WANDER_GAIN * self.wander * remembered[:, 0] + ODD_GAIN * odd) * (1.0 + flow),
            pressure,
            WANDER_TEMPERATURE_C * self.wander * remembered[:, 1],
            1.0 + self.paths * remembered[:, 2:],
        )


FITTED = CB560()
# Films as in a slot, and an effect of temperature as on both pump records.
OTHERWISE = CB560(FilmPressure("slot"), -0.009)
# The charged low side leaks as well, which the stated model leaves out.
TWO_SIDED = CB560(FilmPressure("slot"), -0.009, 15.0)
FLUSHED = CB560(coefficients=(*THETA[:-1].tolist(), 0.5, 1.0))
# Nothing but a laminar gap; its flow falls by 0.3 % a kelvin beside the viscosity's.
LAMINAR = CB560(FilmPressure(share=0.0), -0.003, coefficients=(0.0, 2.0 * THETA[1], 0.0, 0.0, 0.0))

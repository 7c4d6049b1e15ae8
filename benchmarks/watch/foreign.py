"""Machines that nobody here fitted: what happens to them, and what the watch sees of it.

The physics of each is in a file of its own, which knows neither the fitted model nor its constants
(`mill.py`, `winch.py`, `conveyor.py`). The model sees what a log has: pressure difference,
temperature, speed and drain flow; its paths are those of a CB560.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from benchmarks.simulated_nights import lagging
from benchmarks.watch.cb560 import AN_HOUR, MODEL
from benchmarks.watch.history import Event, History, block_means, night_blocks
from leakage import OperatingConditions, regressors
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression, phi_of

STEP_S = 10.0
ROWS = round(3600.0 / STEP_S)
BASELINE = 15  # nights whose conditions are the machine's own
Duty = tuple[Array, Array, Array]  # ΔP [bar], oil temperature [°C], speed [rpm]; (n, nights) each


@dataclass(frozen=True, slots=True)
class Night:
    """What a machine and its sensors are in a night; as at first, by default."""

    wear: float = 1.0  # factor on the conductance of what wears
    viscosity: float = 1.0
    meter: float = 1.0
    load: float = 1.0
    warmer_k: float = 0.0

    @property
    def as_first(self) -> Night:
        """The same operating conditions of a machine in which nothing has changed."""
        return Night(load=self.load, warmer_k=self.warmer_k)


class Foreign(Protocol):
    """A machine with physics of its own."""

    def operating_point(self, generator: np.random.Generator, load: Array, warmer_k: Array) -> Duty:
        """What it does in its nights, by factor on the load and warmth of each."""

    def flow(self, operating_point: Duty, wear: Array, thinning: Array) -> Array:
        """Drain flow [l/min], by factors on what wears and on the viscosity of each night."""

    def errors(self, generator: np.random.Generator, nights: int) -> Duty:
        """Errors of flow (relative), pressure [bar] and temperature [°C]."""


def history(
    machine: Foreign, story: Callable[[int], Night], nights: int, seed: Sequence[int]
) -> History:
    """Nights of a machine, as the model that is none of it sees them."""
    of_duty, of_errors = (np.random.default_rng([*seed, part]) for part in range(2))
    told = [story(place) for place in range(nights)]
    operating_point = machine.operating_point(of_duty, _each(told, "load"), _each(told, "warmer_k"))
    flow = _measured(machine, operating_point, told)
    newest_night = (
        flow.mean(axis=0) / _measured(machine, operating_point, [Night()] * nights).mean(axis=0)
        - 1.0
    )
    pressure, temperature, speed = operating_point
    bar, celsius, rpm = (one[::12, :BASELINE].reshape(-1, 1) for one in operating_point)
    own = _measured(machine, (bar, celsius, rpm), told).mean(axis=0)
    change = own / _measured(machine, (bar, celsius, rpm), [Night()]).mean() - 1.0
    gain, off_bar, off_c = machine.errors(of_errors, nights)
    seen = np.stack(np.broadcast_arrays(temperature + off_c, pressure + off_bar, speed), axis=-1)
    at = OperatingConditions.from_bar(*(seen[..., one].T.ravel() for one in (1, 0, 2)))
    columns = AN_HOUR.drives(regressors(MODEL, at)).reshape(nights, ROWS, -1).swapaxes(0, 1)
    means = (block_means(one, STEP_S) for one in (columns, flow * (1.0 + gain), seen))
    return History(AN_HOUR.watched, night_blocks(*means), newest_night, change)


def _measured(machine: Foreign, operating_point: Duty, nights: Sequence[Night]) -> Array:
    """What a good meter would have read, shape (n, nights) [l/min]."""
    flow = machine.flow(operating_point, _each(nights, "wear"), _each(nights, "viscosity"))
    return flow * _each(nights, "meter")


def _each(nights: Sequence[Night], name: str) -> Array:
    return np.array([getattr(one, name) for one in nights])


def levels(generator: np.random.Generator, nights: int, hold_s: float, lag_s: float) -> Array:
    """Levels within 0 to 1 that are held for so long each, smoothed; shape (n, nights)."""
    held = round(hold_s / STEP_S)
    drawn = np.repeat(generator.random((ROWS // held + 1, nights)), held, axis=0)
    return lagging(drawn[:ROWS], STEP_S, lag_s)


def slow(generator: np.random.Generator, nights: int, memory_s: float) -> Array:
    """Errors of unit variance that forget within a night, shape (n, nights)."""
    return autoregression(generator.standard_normal((ROWS, nights)), phi_of(STEP_S, memory_s))


def nightly(generator: np.random.Generator, nights: int, phi: float) -> Array:
    """Errors of unit variance that last for a night, shape (nights,)."""
    return autoregression(generator.standard_normal(nights), phi)


def _ramp(place: int, begin: int, end: int) -> float:
    return float(np.clip((place - begin) / (end - begin), 0.0, 1.0))


def _warming(place: int) -> Night:
    """A season of +12 K in 90 nights."""
    return Night(warmer_k=12.0 * _ramp(place, 0, 90) - 6.0)


def _from(begin: int, **changed: float) -> Callable[[int], Night]:
    return lambda night: Night(**changed) if night >= begin else Night()


WEAR = frozenset({"all_gaps", "all_flows"})
OIL, METER = frozenset({"all_flows", "oil_grade"}), frozenset({"all_flows"})
STORIES = {
    "nothing": Event(_from(0), 100),
    "load +30 %": Event(_from(30, load=1.3), 70),
    "load −40 %": Event(_from(30, load=0.6), 70),
    "season, +12 K in 90 nights": Event(_warming, 100),
    "oil −20 %": Event(_from(30, viscosity=0.8), 60, 30, OIL),
    "meter +6 %": Event(_from(30, meter=1.06), 60, 30, METER),
    "wear, a step": Event(_from(30, wear=1.25), 60, 30, WEAR),
    "the season, and a step of wear": Event(
        lambda n: replace(_warming(n), wear=1.18 if n >= 45 else 1.0), 100, 45, WEAR
    ),
    "the season, and wear in 70 nights": Event(
        lambda n: replace(_warming(n), wear=1.0 + 0.35 * _ramp(n, 20, 90)),
        100,
        20,
        WEAR,
        is_step=False,
    ),
    "wear in 8 nights": Event(
        lambda n: Night(wear=1.0 + 0.4 * _ramp(n, 20, 28)), 50, 20, WEAR, is_step=False
    ),
    "wear in 45 nights, then a repair": Event(
        lambda n: Night(wear=1.0 + 0.3 * _ramp(n, 15, 60) * (n < 60)), 90, 15, WEAR, is_step=False
    ),
    "every third night +8 %": Event(
        lambda n: Night(meter=1.08 if n >= 40 and n % 3 == 0 else 1.0),
        90,
        40,
        frozenset({"odd_nights"}),
    ),
}

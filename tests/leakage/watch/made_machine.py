"""A CB560's nights as blocks, from physics written out here: nothing of it is the product's.

Placeholder geometry, oil and roller of the model's description. The model is given the drives of
its own film law (Barus at the pressure difference); the machine may follow another.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from leakage.watch import Machine, NightBlocks, Watch, WatchSettings

Array = NDArray[np.float64]

PATHS = ("ring", "piston", "sleeve", "known")
VG_46, VG_68 = (46.0, 6.8), (68.0, 8.7)
CB560 = Machine(PATHS, PATHS[:3], VG_68)
# K of ring, piston and sleeve [m³], and the factor of the known roller.
COEFFICIENTS = np.array([7.506312e-14, 1.558230e-14, 4.373874e-14, 1.0])
BLOCK_S, SAMPLES = 120.0, 6


def kinematic_viscosity(oil: tuple[float, float], t_c: Array | float) -> Array:
    """ASTM D341 through 40 and 100 °C, [mm²/s]."""
    w40, w100 = np.log10(np.log10(np.array(oil) + 0.7))
    t40, t100 = np.log10([313.15, 373.15])
    slope = (w40 - w100) / (t100 - t40)
    twice: Array = w40 - slope * (np.log10(np.asarray(t_c) + 273.15) - t40)
    return 10.0**10.0**twice - 0.7


Film = Literal["barus", "slot", "turbulent"]


def drives(conditions: Array, oil: tuple[float, float] = VG_68, film: Film = "barus") -> Array:
    """Flow a unit of each coefficient at °C, bar and rpm of (..., 3), shape (..., 4), [l/min].

    Of a laminar gap with the viscosity at the whole pressure difference (the fitted law) or along
    the slot, or of a turbulent one: root of the pressure difference, whatever the viscosity.
    """
    t_c, bar, rpm = np.moveaxis(conditions, -1, 0)
    eta = 1e-6 * kinematic_viscosity(oil, t_c) * 882.0 / (1.0 + 7e-4 * (t_c - 15.0))
    pascal, thicker = 1e5 * bar, np.exp(2e-8 * 1e5 * bar)
    by_film = {
        "barus": pascal / thicker,
        "slot": (1.0 - np.exp(-2e-8 * pascal)) / 2e-8,
        "turbulent": 2e3 * np.sqrt(pascal) * eta / 0.05,
    }
    laminar = 6e4 * by_film[film] / eta
    quintic = np.polyval([2e-11, -7e-9, 9e-7, -5e-5, 1.6e-3, 4e-3], np.clip(rpm, 0.0, 125.0))
    roller = 32 * quintic * (bar / 200.0) * 0.035 / (eta * thicker)
    ring, sleeve = np.exp(-3 * bar / 120.0) * laminar, np.exp(-3 * bar / 900.0) * laminar
    return np.stack([ring, laminar, sleeve, roller], axis=-1)


@dataclass(frozen=True, slots=True)
class Plant:
    """A machine, its conditions, its errors, and what happens to it; nights count from 0."""

    growth: Callable[[int], Array | float] = lambda _: 1.0
    oil: Callable[[int], tuple[float, float]] = lambda _: VG_68
    offset_c: Callable[[int], float] = lambda _: 0.0
    warmer_c: Callable[[int], float] = lambda _: 0.0
    by_warmth: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)  # growth of each path's flow a kelvin
    film: Film = "barus"
    operating_point: Literal["varied", "one pressure"] = "varied"
    load: Callable[[int], float] = lambda _: 1.0
    blocks: int = 30
    wander: float = 0.006
    serial: float = 0.4
    slow: float = 0.004
    block: float = 0.004
    days: Callable[[int], int] = lambda night: night

    def nights(self, n: int, seed: int) -> list[NightBlocks]:
        """Nights from the first on; a night is the same whatever comes after it."""
        shifts = self.wander * autoregression(n, self.serial, np.random.default_rng((seed, 0)))
        return [self._night(night, shifts[night], (seed, 1, night)) for night in range(n)]

    def _night(self, night: int, shift: float, seed: tuple[int, ...]) -> NightBlocks:
        generator = np.random.default_rng(seed)
        middle_s = np.linspace(0.0, BLOCK_S * (self.blocks - 1), self.blocks) + BLOCK_S / 2
        truth = self._conditions(night, middle_s, generator)
        seen = truth + np.array([self.offset_c(night), 0.0, 0.0])
        of_paths = drives(truth, self.oil(night), self.film)
        of_paths *= 1.0 + (truth[..., :1] - 50.0) * self.by_warmth
        flow = (of_paths.mean(axis=1) * COEFFICIENTS) @ (np.ones(4) * self.growth(night))
        error = shift + slow_errors(middle_s, self.slow, 600.0, generator)
        error += self.block * generator.standard_normal(self.blocks)
        return NightBlocks(
            self.days(night),
            middle_s,
            drives(seen).mean(axis=1),
            flow * (1.0 + error),
            np.abs(seen).mean(axis=1),
        )

    def _conditions(self, night: int, middle_s: Array, generator: np.random.Generator) -> Array:
        """Temperature, pressure and speed of samples of each block, shape (b, samples, 3)."""
        shape = len(middle_s), SAMPLES
        warm = 44.0 + 8.0 * (1.0 - np.exp(-middle_s / 1200.0)) + 1.5 * generator.standard_normal()
        warm += self.warmer_c(night)
        if self.operating_point == "one pressure":
            bar, rpm = np.full(shape, 180.0), np.full(shape, 30.0)
            bar, rpm = bar + generator.normal(0, 0.3, shape), rpm + generator.normal(0, 0.05, shape)
        else:
            level = generator.permutation(np.linspace(40.0, 280.0, len(middle_s)))
            bar = level[:, None] * generator.uniform(0.85, 1.15, shape)
            rpm = generator.uniform(5.0, 100.0, len(middle_s))[:, None] + np.zeros(shape)
        return np.stack([warm[:, None] + np.zeros(shape), self.load(night) * bar, rpm], axis=-1)


def autoregression(n: int, phi: float, generator: np.random.Generator) -> Array:
    """Stationary, of unit variance, by its own definition."""
    values = generator.standard_normal(n)
    for night in range(1, n):
        values[night] = phi * values[night - 1] + np.sqrt(1.0 - phi**2) * values[night]
    return values


def slow_errors(
    middle_s: Array, sd: float, memory_s: float, generator: np.random.Generator
) -> Array:
    """An error that is forgotten within a time, by its covariance."""
    covariance = sd**2 * np.exp(-np.abs(middle_s[:, None] - middle_s) / memory_s)
    root = np.linalg.cholesky(covariance + 1e-14 * np.eye(len(middle_s)))
    return root @ generator.standard_normal(len(middle_s))


def grown(path: str, by: float, since: int, until: int = 10**6) -> Callable[[int], Array]:
    """One path's flow, all gaps' or all flows', larger by a share from a night on."""
    worn = np.ones(4)
    worn[{"all_flows": slice(4), "all_gaps": slice(3)}.get(path) or PATHS.index(path)] += by

    def growth(night: int) -> Array:
        return worn if since <= night < until else np.ones(4)

    return growth


def of_flow(by: Array | float, film: Film = "barus") -> float:
    """True relative change of the mean flow where the paths' flows change by shares."""
    before, after = (
        np.concatenate([night.flow for night in Plant(growth=growth, film=film).nights(20, 99)])
        for growth in (lambda _: 1.0, lambda _: 1.0 + np.asarray(by))
    )
    return float(after.mean() / before.mean()) - 1.0


def watched(
    nights: Sequence[NightBlocks],
    machine: Machine = CB560,
    settings: WatchSettings | None = None,
    first: int | None = None,
) -> list[Watch]:
    """The watch after each night from the end of the baseline on.

    A watch hangs on its nights so far alone: where plants begin alike, it is made once.
    """
    settings = settings or WatchSettings()
    first = first or settings.baseline_nights
    so_far, found = hashlib.sha256(repr((machine, settings, first)).encode()), []
    for last, night in enumerate(nights, start=1):
        for values in (night.day, night.middle_s, night.drives, night.flow, night.conditions):
            so_far.update(np.ascontiguousarray(values).tobytes())
        if last < first:
            continue
        if (key := so_far.digest()) not in _WATCHED:
            _WATCHED[key] = (
                found[-1].after(night, earlier_of(nights[:last]))
                if found
                else Watch.begin(machine, nights[:last], settings)
            )
        found.append(_WATCHED[key])
    return found


_WATCHED: dict[bytes, Watch] = {}


def earlier_of(nights: Sequence[NightBlocks]) -> Callable[[int], Sequence[NightBlocks]]:
    """What the watch asks for: the nights from a day on."""
    return lambda day: [night for night in nights if night.day >= day]


def first_detected(watches: Sequence[Watch]) -> Watch | None:
    """The watch on the night on which a change is first in force."""
    return next((watch for watch in watches if watch.state.in_force is not None), None)

"""Simulated nights of a CB560 with the placeholders of its type, for studies of the statistics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from leakage import Motor, OperatingConditions, Parametrisation, regressors
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.motors import FlushingTable

Array = NDArray[np.float64]
CONFIGS = Path(__file__).parent.parent / "configs"
RATE_HZ = 10.0
BLOCK_S = 120.0
REFERENCE = OperatingConditions.from_bar(200.0, 50.0, 30.0)


def motor(flushing: FlushingTable | None = None, mode: str = "none") -> Motor:
    """The CB560 of the shipped configuration."""
    import json
    import tomllib

    def load(path: str) -> str:
        return json.dumps(tomllib.loads((CONFIGS / path).read_text("utf-8")))

    kind = MotorTypeFile.model_validate_json(load("motor_types/CB560.toml"))
    oil = OilFile.model_validate_json(load("oils/vg68.toml")).oil()
    table = flushing or FlushingTable()
    return Motor(kind.motor_type, (*kind.paths(), table.path(mode)), oil)


def true_coefficients(of: Motor) -> Array:
    """θ as configured, shape (p + 1,)."""
    paths = Parametrisation.of(of).paths
    return np.array([path.configured_coefficient if path else 0.0 for path in paths])


@dataclass(frozen=True, slots=True)
class Duty:
    """What a motor saw in a night, on an even time base of 10 Hz; shape (n,) each."""

    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array

    @property
    def conditions(self) -> OperatingConditions:
        """As the physics takes it."""
        return OperatingConditions.from_bar(self.pressure_bar, self.temperature_c, self.speed_rpm)


def duty(hours: float, generator: np.random.Generator) -> Duty:
    """Load steps every minute or so, smoothed; temperature drifting over tens of minutes."""
    n = int(hours * 3600 * RATE_HZ)
    return Duty(
        _walk(n, 15.0, 300.0, 60.0, 3.0, generator),
        _walk(n, 40.0, 60.0, 600.0, 200.0, generator),
        _walk(n, 3.0, 110.0, 90.0, 3.0, generator),
    )


def _walk(
    n: int, low: float, high: float, hold_s: float, lag_s: float, generator: np.random.Generator
) -> Array:
    hold = int(hold_s * RATE_HZ)
    steps = np.repeat(generator.uniform(low, high, n // hold + 1), hold)[:n]
    decay = np.exp(-1.0 / (lag_s * RATE_HZ))
    smoothed, _ = lfilter([1.0 - decay], [1.0, -decay], steps, zi=[decay * steps[0]])
    result: Array = np.asarray(smoothed, dtype=np.float64)
    return result


def correlated_noise(n: int, phi: float, draws: int, generator: np.random.Generator) -> Array:
    """First-order autoregressions of unit variance, in their stationary state; shape (n, draws)."""
    white = generator.standard_normal((n, draws))
    start = phi * generator.standard_normal((1, draws))
    noise, _ = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white, axis=0, zi=start)
    result: Array = np.asarray(noise, dtype=np.float64)
    return result


class CompressedNights:
    """Factors of nights that share their duty and differ in their noise.

    The regressors' part of each block's decomposition is done once; a night then costs a product.
    """

    def __init__(self, of: Motor, seen: Duty) -> None:
        self.columns = regressors(of, seen.conditions)
        rows = int(BLOCK_S * RATE_HZ)
        self.n_blocks = len(self.columns) // rows
        blocks = self.columns[: self.n_blocks * rows].reshape(self.n_blocks, rows, -1)
        self._q, self._r = np.linalg.qr(blocks)
        self._rows = rows

    def factors(self, flow: Array) -> Iterator[Array]:
        """Block factors of each night, from its flow, shape (n, draws)."""
        n, draws = self.n_blocks * self._rows, flow.shape[1]
        blocks = flow[:n].reshape(self.n_blocks, self._rows, draws)
        inside = np.einsum("brc,brd->bcd", self._q, blocks)
        rest = np.linalg.norm(blocks - self._q @ inside, axis=1)
        size = self._r.shape[-1] + 1
        for draw in range(draws):
            whole = np.zeros((self.n_blocks, size, size))
            whole[:, :-1, :-1] = self._r
            whole[:, :-1, -1] = inside[:, :, draw]
            whole[:, -1, -1] = rest[:, draw]
            yield whole

"""Simulated nights of a CB560 with the placeholders of its type, for studies of the statistics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.multi_start import Parametrisation
from pipeline.arrays import Array
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.motors import FlushingTable
from pipeline.demo.noise import phi_of

CONFIGS = Path(__file__).parent.parent / "configs"
# Wander of sensors from night to night: gain and temperature with this memory, pressure without.
WANDER_PHI, WANDER_GAIN, WANDER_TEMPERATURE_C, WANDER_PRESSURE_BAR = 0.6, 0.003, 0.3, 0.3
# Errors of a drain flow over the flow as on a real record (`benchmarks/results/noise.md`): short
# ones and their φ at 1 Hz, and slow ones with the time over which they forget.
RECORDED_SHORT, RECORDED_PHI, RECORDED_SLOW, RECORDED_SLOW_S = 0.013, 0.4, 0.0145, 600.0
RATE_HZ = 10.0
BLOCK_S = 120.0
REFERENCE = OperatingConditions.from_bar(200.0, 50.0, 30.0)


def motor() -> Motor:
    """The CB560 of the shipped configuration."""
    import json
    import tomllib

    def load(path: str) -> str:
        return json.dumps(tomllib.loads((CONFIGS / path).read_text("utf-8")))

    kind = MotorTypeFile.model_validate_json(load("motor_types/CB560.toml"))
    oil = OilFile.model_validate_json(load("oils/vg68.toml")).oil()
    return Motor(kind.motor_type, (*kind.paths(), FlushingTable().path("none")), oil)


def true_coefficients(of: Motor) -> Array:
    """θ as configured, shape (p + 1,)."""
    paths = Parametrisation.of(of).paths
    return np.array([path.configured_coefficient if path else 0.0 for path in paths])


@dataclass(frozen=True, slots=True)
class Duty:
    """What a motor saw in a night, on an even time base; shape (n,) each."""

    rate_hz: float
    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array

    @property
    def time_s(self) -> Array:
        """Since the first sample [s]."""
        return np.arange(len(self.pressure_bar)) / self.rate_hz

    @property
    def channels(self) -> tuple[Array, Array, Array]:
        """Pressure difference [bar], temperature [°C] and speed [rpm]."""
        return self.pressure_bar, self.temperature_c, self.speed_rpm

    @property
    def conditions(self) -> OperatingConditions:
        """As the physics takes it."""
        return OperatingConditions.from_bar(*self.channels)


def duty(
    hours: float,
    generator: np.random.Generator,
    rate_hz: float = RATE_HZ,
    hold_s: tuple[float, float] = (60.0, 60.0),
) -> Duty:
    """Load steps that last so long, smoothed; temperature drifting over tens of minutes."""
    n = round(hours * 3600 * rate_hz)

    def walk(low: float, high: float, held_s: tuple[float, float], lag_s: float) -> Array:
        most = int(n / (held_s[0] * rate_hz)) + 2
        holds = np.rint(rate_hz * generator.uniform(*held_s, most)).astype(int)
        steps = np.repeat(generator.uniform(low, high, most), holds)
        # The level before the first sample fades as well.
        before = np.full(1, generator.uniform(low, high))
        return lagging(np.concatenate([before, steps[:n]]), 1.0 / rate_hz, lag_s)[1:]

    return Duty(
        rate_hz,
        walk(15.0, 300.0, hold_s, 3.0),
        walk(40.0, 60.0, (600.0, 600.0), 200.0),
        walk(3.0, 110.0, (1.5 * hold_s[0], 1.5 * hold_s[1]), 3.0),
    )


def lagging(signal: Array, step_s: float, time_constant_s: float) -> Array:
    """First-order lag behind a signal, settled on its first value: heat behind its sensor."""
    phi = phi_of(step_s, time_constant_s)
    lagged, _ = lfilter([1.0 - phi], [1.0, -phi], signal, axis=0, zi=phi * signal[:1])
    return np.asarray(lagged, dtype=np.float64)


class CompressedNights:
    """Factors of nights that share their duty and differ in their flow.

    The regressors' part of each block's decomposition is done once; a night then costs a product.
    The factors are those of the samples, to rounding.
    """

    def __init__(self, of: Motor, seen: Duty) -> None:
        self.columns = regressors(of, seen.conditions)
        self._rows = round(BLOCK_S * seen.rate_hz)
        self.n_blocks = -(-len(self.columns) // self._rows)
        self._q, self._r = np.linalg.qr(self._in_blocks(self.columns))

    def factors(self, flow: Array) -> Iterator[Array]:
        """Block factors of each night, from its flow, shape (n, draws)."""
        blocks = self._in_blocks(flow)
        inside = self._q.transpose(0, 2, 1) @ blocks
        rest = np.linalg.norm(blocks - self._q @ inside, axis=1)
        size = self._r.shape[-1] + 1
        for draw in range(flow.shape[1]):
            whole = np.zeros((self.n_blocks, size, size))
            whole[:, :-1, :-1] = self._r
            whole[:, :-1, -1] = inside[:, :, draw]
            whole[:, -1, -1] = rest[:, draw]
            yield whole

    def _in_blocks(self, columns: Array) -> Array:
        """Rows by block, shape (blocks, rows, columns); the last is filled up with rows of 0."""
        missing = self.n_blocks * self._rows - len(columns)
        filled = np.concatenate([columns, np.zeros((missing, columns.shape[1]))])
        return filled.reshape(self.n_blocks, self._rows, -1)

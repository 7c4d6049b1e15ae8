"""Simulated nights of a CB560 with the placeholders of its type, for studies of the statistics."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from leakage import Motor
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


def motor() -> Motor:
    """The CB560 of the shipped configuration."""

    def load(path: str) -> str:
        return json.dumps(tomllib.loads((CONFIGS / path).read_text("utf-8")))

    kind = MotorTypeFile.model_validate_json(load("motor_types/CB560.toml"))
    oil = OilFile.model_validate_json(load("oils/vg68.toml")).oil()
    return Motor(kind.motor_type, (*kind.paths(), FlushingTable().path("none")), oil)


def true_coefficients(of: Motor) -> Array:
    """θ as configured, shape (p + 1,)."""
    paths = of.coefficient_paths
    return np.array([path.configured_coefficient if path else 0.0 for path in paths])


def lagging(signal: Array, step_s: float, time_constant_s: float) -> Array:
    """First-order lag behind a signal, settled on its first value: heat behind its sensor."""
    phi = phi_of(step_s, time_constant_s)
    lagged, _ = lfilter([1.0 - phi], [1.0, -phi], signal, axis=0, zi=phi * signal[:1])
    return np.asarray(lagged, dtype=np.float64)

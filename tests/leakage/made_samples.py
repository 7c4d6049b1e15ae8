"""Made samples of a motor with known loss factors: the columns of z, realistic in size.

The regressors of the gaps are of order 1e13 l/min per m³, the flow of order 1 l/min.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import Motor, regressors, total_flow_l_per_min

Array = NDArray[np.float64]
Generator = np.random.Generator


def made_conditions(
    n: int, seed: int = 1, pressure_bar: tuple[float, float] = (5.0, 320.0)
) -> OperatingConditions:
    """Conditions spread over the range of a night's work."""
    generator = np.random.default_rng(seed)
    return OperatingConditions.from_bar(
        generator.uniform(*pressure_bar, n),
        generator.uniform(35.0, 60.0, n),
        generator.uniform(0.0, 100.0, n),
    )


def made_samples(
    motor: Motor,
    n: int = 2000,
    seed: int = 1,
    *,
    noise_l_per_min: float = 0.02,
    conditions: OperatingConditions | None = None,
) -> Array:
    """Columns of `n` samples as ``motor.columns``; the motor's own values are the truth."""
    conditions = made_conditions(n, seed) if conditions is None else conditions
    noise = np.random.default_rng(seed + 1).standard_normal(len(conditions))
    flow = total_flow_l_per_min(motor, conditions) + noise_l_per_min * noise
    return np.column_stack([regressors(motor, conditions), flow])


def true_coefficients(motor: Motor) -> Array:
    """θ behind `made_samples`: the configured coefficients, then the constant flow or 0."""
    constant = 0.0 if motor.constant is None else motor.constant.configured_coefficient
    return np.array([*(path.configured_coefficient for path in motor.column_paths), constant])


def autoregression(phi: float, n: int, generator: Generator) -> Array:
    """Stationary AR(1) of unit variance."""
    start = [phi * generator.normal()]
    series, _ = lfilter([math.sqrt(1 - phi * phi)], [1.0, -phi], generator.normal(size=n), zi=start)
    return np.asarray(series)

"""Loss factors that change with the measured temperature: frozen with the baseline, taken off.

Nights are the blocks: what an indicator shows over the nights is how they differ in temperature.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from leakage import Parametrisation
from leakage.temperature_correction import TemperatureCorrection, temperature_correction
from pipeline.trends.history import History
from pipeline.trends.night_records import whole_matrix

Array = NDArray[np.float64]

# Good nights that tell it, and neighbours among them that share their errors.
NIGHTS, NIGHTS_A_CLUSTER = 30, 5


def correction_of(
    history: History, places: NDArray[np.intp], theta: Array
) -> TemperatureCorrection | None:
    """Correction from some nights together, θ their model; None where they cannot tell it."""
    factors = whole_matrix(history.records["factor"][places], len(history.layout.columns))
    temperature = history.records["mean_temperature_c"][places]
    known = np.isfinite(factors).all(axis=(1, 2)) & np.isfinite(temperature)
    if not known.any():
        return None
    motor = history.spec.motor(history.nights[int(places[-1])], history.spec.file.flushing.mode)
    lower, upper = Parametrisation.of(motor).coefficient_bounds()
    return temperature_correction(
        factors[known],
        temperature[known],
        np.arange(int(known.sum())) // NIGHTS_A_CLUSTER,
        theta,
        (lower < theta) & (theta < upper),
    )


def warming(
    history: History, here: slice | NDArray[np.intp], correction: TemperatureCorrection | None
) -> Array:
    """Loss factors at the temperature of some nights over those at T₀, shape (m,).

    1 where no change is certain, and in nights without a fit of their own: filtered figures are
    those of many nights.
    """
    temperature = history.records["mean_temperature_c"][here]
    if correction is None or not correction.is_certain:
        return np.ones(len(temperature))
    told = history.fitted[here] & np.isfinite(temperature)
    found: Array = np.where(told, correction.factor(temperature), 1.0)
    return found

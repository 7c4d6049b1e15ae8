"""Loss factors that change with the measured temperature: frozen with the baseline, taken off.

Nights are the blocks: what an indicator shows over the nights is how they differ in temperature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.course.temperature_correction import TemperatureCorrection, temperature_correction
from pipeline.trends.figures.baseline_model import baseline_model, bounds_of
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import Records

Array = NDArray[np.float64]

# Good nights that may tell it, whichever do first, and neighbours that share their errors.
NIGHTS, NIGHTS_A_CLUSTER = (30, 60, 120), 5


@dataclass(frozen=True, slots=True)
class FrozenCorrection:
    """A known effect of temperature, and the place of the last of the nights that tell it."""

    correction: TemperatureCorrection
    place: int


def frozen_correction(history: History, first: int, end: int) -> FrozenCorrection | None:
    """Effect of temperature from the first good nights between two places; None while not known.

    It is relative to the temperature of the nights that are a baseline.
    """
    trend = history.spec.settings.trend
    places = first + np.flatnonzero(history.fitted[first:end])
    lengths = [one for one in NIGHTS if one <= len(places)]
    model = baseline_model(history, places[: trend.provisional_nights]) if lengths else None
    if model is None:
        return None
    for length in lengths:
        found = _correction_of(history, places[:length], model)
        if found is not None and found.is_known:
            usual_c = float(usual_temperatures(history, places[:length])[-1])
            return FrozenCorrection(found.referred_to(usual_c), int(places[length - 1]))
    return None


def usual_temperatures(history: History, places: NDArray[np.intp]) -> Array:
    """Mean temperature of the baseline's nights as of each of some good ones [°C], shape (m,)."""
    temperature = history.records["mean_temperature_c"][places]
    known = np.isfinite(temperature)
    known[history.spec.settings.trend.baseline_nights :] = False
    with np.errstate(invalid="ignore"):
        means: Array = np.cumsum(np.where(known, temperature, 0.0)) / np.cumsum(known)
    return means


def _correction_of(
    history: History, places: NDArray[np.intp], theta: Array
) -> TemperatureCorrection | None:
    """Correction from some nights together, θ their model; None where they cannot tell it."""
    factors = history.factors(places)
    temperature = history.records["mean_temperature_c"][places]
    known = np.isfinite(factors).all(axis=(1, 2)) & np.isfinite(temperature)
    if int(known.sum()) < NIGHTS[0] // 2:
        return None
    numbers, temperature = history.numbers[places][known].astype(np.float64), temperature[known]
    lower, upper = bounds_of(history, places)
    found = temperature_correction(
        factors[known],
        temperature,
        np.arange(len(temperature)) // NIGHTS_A_CLUSTER,
        theta,
        (lower < theta) & (theta < upper),
        numbers,
    )
    about_line = temperature - np.polyval(np.polyfit(numbers, temperature, 1), numbers)
    return found and found.with_wander(float(np.var(about_line)))


def warming(records: Records, correction: TemperatureCorrection | None) -> Array:
    """Loss factors at the temperature of some nights over those at T₀, shape (m,).

    1 where no change is certain.
    """
    temperature = records["mean_temperature_c"]
    if correction is None or not correction.is_certain:
        return np.ones(len(temperature))
    found: Array = np.where(np.isfinite(temperature), correction.factor(temperature), 1.0)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """Effect of temperature on a motor's nights; shape (n,) each."""

    # Loss factors over those at the era's T₀; 1 until that is known: what was told stays, and over
    # the nights behind it, it is 1 on the mean.
    factor: Array
    per_kelvin: Array  # b that is taken off within a night [1/K]
    left: Array  # relative ± of what is not known of it; 0 until there is a model to compare with

    @property
    def is_taken_off(self) -> bool:
        """True if it changes any night."""
        return bool(self.per_kelvin.any())

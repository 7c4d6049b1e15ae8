"""Conditions at which a motor's leakage is told: the fleet's, and its own of its first good nights.

Many motors never see the fleet's conditions; each sees its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError, OperatingConditions, regressors
from pipeline.trends.nights.history import History

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OwnConditions:
    """Conditions at which a motor's own reference leakage is told."""

    pressure_bar: float
    temperature_c: float
    speed_rpm: float
    charge_over_case_bar: float | None = None


def reference_conditions(history: History, place: int) -> OwnConditions:
    """The fleet's reference conditions, with a night's charge pressure."""
    asked = history.spec.settings.reference
    charge = float(history.once(_charges)[place])
    return OwnConditions(
        asked.pressure_bar,
        asked.temperature_c,
        asked.speed_rpm,
        None if np.isnan(charge) else charge,
    )


def _charges(history: History) -> Array:
    """The last charge pressure that there was in each night; nan before the first."""
    values = history.records["charge"]
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    known: Array = np.where(last >= 0, values[last], np.nan)
    return known


def own_conditions(history: History, places: NDArray[np.intp]) -> OwnConditions | None:
    """Medians of the mean conditions of some nights; None where there are none."""
    figures = history.records["own"][places]
    figures = figures[np.isfinite(figures).all(axis=1)]
    if not len(figures):
        return None
    charge = history.records["charge"][places]
    charge = charge[np.isfinite(charge)]
    pressure, temperature, speed = np.median(figures, axis=0).tolist()
    above_case = float(np.median(charge)) if len(charge) else None
    return OwnConditions(pressure, temperature, speed, above_case)


def regressor_row(history: History, place: int, own: OwnConditions) -> Array | str:
    """Columns of the statistics at some conditions in a night, without the measured flow.

    A text where the model does not hold there, which says why. The night's oil decides: what else
    shapes them is the same for all nights.
    """
    spec, key = history.spec, (history.spec.file.oil_on(history.nights[place]), own)
    if key not in history.kept:
        try:
            motor = spec.motor(history.nights[place], spec.file.flushing.mode)
            at = OperatingConditions.from_bar(
                own.pressure_bar, own.temperature_c, own.speed_rpm, own.charge_over_case_bar
            )
            history.kept[key] = regressors(motor, at)[0]
        except LeakageError as error:
            history.kept[key] = str(error)
    row: Array | str = history.kept[key]
    return row

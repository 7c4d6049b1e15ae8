"""Payload of a motor's page: its course over all nights."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.validation import POOR_FIT_PERCENT
from pipeline.report.encoding import numbers, whole_numbers
from pipeline.report.history import Course, MotorHistory
from pipeline.report.tables import ReportTables
from pipeline.report.trends import trend_payload
from pipeline.report.words import for_scripts
from pipeline.thinning import keep_extremes

Payload = dict[str, Any]

# More nights than a chart has pixels are thinned, so that a page stays small for decades.
PLOTTED_NIGHTS = 1500
# Name in the payload and column of `fits`.
NIGHTLY = {
    "training_fit": "training_fit_percent",
    "validation_fit": "validation_fit_percent",
    "previous_fit": "previous_model_fit_percent",
    "kept_share": "kept_share",
    "pressure": "own_pressure_bar",
    "temperature": "own_temperature_c",
    "speed": "own_speed_rpm",
    "mean_flow": "mean_flow_l_per_min",
}
CONDITIONS = {
    "pressure": "reference_pressure_bar",
    "temperature": "reference_temperature_c",
    "speed": "reference_speed_rpm",
}


def motor_payload(
    motor: MotorHistory,
    page: str,
    detailed: set[dt.date],
    history: ReportTables,
    events: Sequence[Payload],
) -> Payload:
    """The payload of a motor's page."""
    fits = motor.fits
    places = _plotted(motor)
    return {
        "motor": motor.motor_id,
        "file": page,
        "words": for_scripts(),
        "poor_fit_percent": POOR_FIT_PERCENT,
        "nights": [night.isoformat() for night in motor.nights],
        "statuses": motor.statuses,
        "reasons": {
            str(place): reason for place, reason in enumerate(fits["reason"]) if reason is not None
        },
        "detailed": [int(night in detailed) for night in motor.nights],
        "plotted": whole_numbers(places),
        "reference": _course(motor.reference, places)
        | {"systematic": _column(fits, "reference_leakage_systematic", places)},
        "own": _course(motor.own, places)
        | {"systematic": _column(fits, "own_conditions_leakage_systematic", places)},
        "frozen": _course(motor.frozen, places),
        "conditions": _conditions(fits),
        "paths": _named(motor.paths, places),
        "gaps": _named(motor.gap_changes(), places),
        "coefficients": _named(motor.coefficients, places),
        "nightly": {name: _column(fits, column, places) for name, column in NIGHTLY.items()},
        "events": list(events),
        "trend": trend_payload(motor.motor_id, history),
    }


def _plotted(motor: MotorHistory) -> NDArray[np.int64]:
    """Places of the nights that charts show: all, or those with the extremes among them."""
    if len(motor.nights) <= PLOTTED_NIGHTS:
        return np.arange(len(motor.nights))
    columns = [
        motor.leakages[motor.leakage_kind].value,
        *(course.value for course in motor.coefficients.values()),
    ]
    return keep_extremes(np.column_stack(columns), PLOTTED_NIGHTS)


def _course(course: Course, places: NDArray[np.int64]) -> Payload:
    return {
        "value": numbers(course.value[places]),
        "lower": numbers(course.lower[places]),
        "upper": numbers(course.upper[places]),
    }


def _named(courses: Mapping[str, Course], places: NDArray[np.int64]) -> list[Payload]:
    return [{"name": name} | _course(course, places) for name, course in sorted(courses.items())]


def _column(fits: pl.DataFrame, column: str, places: NDArray[np.int64]) -> Payload:
    return numbers(fits[column].cast(pl.Float64).to_numpy()[places])


def _conditions(fits: pl.DataFrame) -> Payload | None:
    """The newest reference conditions."""
    known = fits.select(CONDITIONS.values()).drop_nulls()
    if not known.height:
        return None
    last = known.row(-1, named=True)
    return {name: last[column] for name, column in CONDITIONS.items()}

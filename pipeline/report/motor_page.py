"""Payload of a motor's page: its course over all nights."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.estimation.validation import POOR_FIT_PERCENT
from pipeline.arrays import Array
from pipeline.palette import COLOURS
from pipeline.report.encoding import numbers, whole_numbers
from pipeline.report.first_screen import FirstScreen, Line
from pipeline.report.history import Course, MotorHistory
from pipeline.report.words import LEAKAGE_KINDS, for_scripts
from pipeline.thinning import keep_extremes

Payload = dict[str, Any]

# More nights than a chart has pixels are thinned, so that a page stays small for decades.
PLOTTED_NIGHTS = 1500
# Letters of a night's reason; the night itself has it whole.
REASON_LETTERS = 120
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
SYSTEMATIC = {
    "reference": "reference_leakage_systematic",
    "own": "own_conditions_leakage_systematic",
}
CONDITIONS = {
    "pressure": "reference_pressure_bar",
    "temperature": "reference_temperature_c",
    "speed": "reference_speed_rpm",
}


def motor_payload(
    motor: MotorHistory,
    screen: FirstScreen,
    page: str,
    detailed: set[dt.date],
    told: Sequence[Payload],
    trend: Payload,
    events: Sequence[Payload],
) -> Payload:
    """The payload of a motor's page."""
    fits = motor.fits
    places = _plotted(screen)
    return {
        "file": page,
        "words": for_scripts(),
        "colours": COLOURS,
        "poor_fit_percent": POOR_FIT_PERCENT,
        "nights": [night.isoformat() for night in motor.nights],
        "statuses": motor.statuses,
        "reasons": {
            str(place): reason[:REASON_LETTERS]
            for place, reason in enumerate(fits["reason"])
            if reason is not None
        },
        "detailed": [int(night in detailed) for night in motor.nights],
        "plotted": whole_numbers(places),
        "first": _first(screen, fits, places) | {"told": list(told)},
        "nightly": {name: _column(fits, column, places) for name, column in NIGHTLY.items()},
        "events": list(events),
        "trend": trend,
    }


def reference_conditions(motor: MotorHistory) -> Mapping[str, float] | None:
    """The newest reference conditions; None before the first fit."""
    known = motor.fits.select(CONDITIONS.values()).drop_nulls()
    if not known.height:
        return None
    last = known.row(-1, named=True)
    return {name: last[column] for name, column in CONDITIONS.items()}


def _plotted(screen: FirstScreen) -> NDArray[np.int64]:
    """Places of the nights that charts show: all, or those with the extremes among them."""
    columns = [screen.leakage.value, screen.flow.value]
    columns += [line.course.value for line in (*screen.changes, *screen.paths)]
    return keep_extremes(columns, PLOTTED_NIGHTS)


def _first(screen: FirstScreen, fits: pl.DataFrame, places: NDArray[np.int64]) -> Payload:
    systematic = SYSTEMATIC.get(screen.leakage_kind)
    return {
        "changes": [_line(line, places) for line in screen.changes],
        "limits": {name: _packed(level, places) for name, level in screen.limits.items()},
        "limitsOf": screen.limits_of,
        "leakage": _course(screen.leakage, places)
        | {"name": LEAKAGE_KINDS[screen.leakage_kind]}
        | ({"systematic": _column(fits, systematic, places)} if systematic else {}),
        "paths": [_line(line, places) for line in screen.paths],
        "flow": _packed(screen.flow.value, places),
    }


def _line(line: Line, places: NDArray[np.int64]) -> Payload:
    return {"name": line.name, "place": line.place} | _course(line.course, places)


def _course(course: Course, places: NDArray[np.int64]) -> Payload:
    parts = {"value": course.value, "lower": course.lower, "upper": course.upper}
    return {name: _packed(part, places) for name, part in parts.items() if np.isfinite(part).any()}


def _packed(figures: Array, places: NDArray[np.int64]) -> Payload:
    return numbers(figures[places])


def _column(fits: pl.DataFrame, column: str, places: NDArray[np.int64]) -> Payload:
    return _packed(fits[column].cast(pl.Float64).to_numpy(), places)

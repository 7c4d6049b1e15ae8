"""Payload of a motor's page: its watch over all nights, and figures of each night's own fit."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.estimation.validation import POOR_FIT_PERCENT
from pipeline.arrays import Array
from pipeline.palette import COLOURS, path_places
from pipeline.report.encoding import numbers, whole_numbers
from pipeline.report.history import Course, MotorHistory
from pipeline.report.words import for_scripts, plain
from pipeline.thinning import keep_extremes
from pipeline.trends.nights.decisions import LEAKAGE
from pipeline.trends.sentences import limit_dates, name_of

Payload = dict[str, Any]

# More nights than a chart has pixels are thinned, so that a page stays small for decades; of each
# of some fifteen figures of the nights' own fits fewer are drawn, extremes kept.
PLOTTED_NIGHTS, SHOWN_NIGHTS = 1500, 600
GAP = "gap_change_"
# Letters of a night's reason; the night itself has it whole.
REASON_LETTERS = 120
# Name in the payload and column of `watch`, beside the leakage.
WATCHED = {
    "change": "tonight_change",
    "changeLower": "tonight_change_lower",
    "changeUpper": "tonight_change_upper",
    "evidence": "evidence",
    "limit": "evidence_limit",
}
# Name in the payload and column of `fits`.
NIGHTLY = {
    "training_fit": "training_fit_percent",
    "validation_fit": "validation_fit_percent",
    "previous_fit": "previous_model_fit_percent",
    "kept_share": "kept_share",
    "pressure": "own_pressure_bar",
    "temperature": "own_temperature_c",
    "speed": "own_speed_rpm",
}
# Of the newest night of a figure, beside its course.
SLOPE = ("slope_per_year", "slope_per_year_lower", "slope_per_year_upper", "days_to_limit_status")


def motor_payload(
    motor: MotorHistory,
    page: str,
    detailed: set[dt.date],
    changes: Sequence[Mapping[str, Any]],
    events: Sequence[Payload],
    declared: Sequence[str],
) -> Payload:
    """The payload of a motor's page.

    `changes` are its rows of `alarms`, `declared` its leakage paths in the config's order.
    """
    gaps = gap_changes(motor, declared)
    watched = {name: motor.watched(column) for name, column in WATCHED.items()}
    # Without any evidence it is minus infinity, which no chart shows.
    watched["level"] = motor.level
    watched["evidence"] = np.where(np.isfinite(watched["evidence"]), watched["evidence"], np.nan)
    places = _plotted(motor, [watched["evidence"], *(one.value for _, _, one in gaps)])
    return {
        "file": page,
        "words": for_scripts(),
        "colours": COLOURS,
        "poor_fit_percent": POOR_FIT_PERCENT,
        "nights": [night.isoformat() for night in motor.nights],
        "statuses": motor.statuses,
        "reasons": {
            str(place): reason[:REASON_LETTERS]
            for place, reason in enumerate(motor.fits["reason"])
            if reason is not None
        },
        "detailed": [int(night in detailed) for night in motor.nights],
        "plotted": whole_numbers(places),
        "leakage": _course(motor.leakage, places),
        "flow": _packed(motor.flow.value, places),
        "watch": {name: _packed(figures, places) for name, figures in watched.items()},
        "baselines": _baselines(motor),
        "told": _told(motor, changes),
        "gaps": [
            {"name": plain(path), "place": place} | _course(course, places)
            for path, place, course in gaps
        ],
        "nightly": {
            name: _packed(motor.fits[column].cast(pl.Float64).to_numpy(), places)
            for name, column in NIGHTLY.items()
        },
        "events": list(events),
        "shown": [
            _shown(rows)
            for name, rows in motor.trends.items()
            if not name.startswith(GAP) and rows["value"].is_not_null().any()
        ],
    }


def gap_changes(motor: MotorHistory, declared: Iterable[str]) -> list[tuple[str, int, Course]]:
    """Path, its place among the colours, and the gap change of each night's own fit, %."""
    paths = [name.removeprefix(GAP) for name in motor.trends if name.startswith(GAP)]
    places = path_places([*declared, *paths])
    found = ((path, places[path], motor.course(GAP + path)) for path in paths)
    return sorted((one for one in found if one[2].is_known.any()), key=lambda one: one[1])


def _plotted(motor: MotorHistory, others: Sequence[Array]) -> NDArray[np.int64]:
    """Places of the nights that charts show: all, or those with the extremes among them."""
    return keep_extremes([motor.leakage.value, motor.flow.value, *others], PLOTTED_NIGHTS)


def _baselines(motor: MotorHistory) -> list[list[str]]:
    """First and last night of the baseline of each era."""
    ends = motor.baselines.select("start", "end").drop_nulls()
    return [[one.isoformat() for one in row] for row in ends.rows()]


def _told(motor: MotorHistory, changes: Iterable[Mapping[str, Any]]) -> list[Payload]:
    """Nights in which a change was told, by its cause, and nights that began an alarm."""
    told = motor.watch.filter(pl.col("told_on").is_not_null(), pl.col("goes_on").not_())
    causes = told.unique("told_on", keep="last", maintain_order=True).select("told_on", "cause")
    alarms = [
        row["night"]
        for row in changes
        if row["indicator"] == LEAKAGE and row["to_state"] == "alarm" != row["from_state"]
    ]
    marks = [(night, plain(cause), False) for night, cause in causes.rows()]
    marks += [(night, "alarm", True) for night in alarms]
    return [
        {"night": night.isoformat(), "label": label, "isAlarm": is_alarm}
        for night, label, is_alarm in sorted(marks)
    ]


def _shown(rows: pl.DataFrame) -> Payload:
    """A figure of each night's own fit."""
    last = rows.row(-1, named=True)
    columns = {name: rows[name].cast(pl.Float64).to_numpy() for name in ("value", "lower", "upper")}
    places = keep_extremes([columns["value"]], SHOWN_NIGHTS)
    return {
        "name": name_of(last["indicator"]),
        "unit": last["unit"],
        "days": whole_numbers(rows["night"].to_physical().to_numpy()[places]),
        **{name: numbers(values[places]) for name, values in columns.items()},
        "latest": {name: last[name] for name in SLOPE if last[name] is not None},
        "limitDates": limit_dates(last),
    }


def _course(course: Course, places: NDArray[np.int64]) -> Payload:
    parts = {"value": course.value, "lower": course.lower, "upper": course.upper}
    return {name: _packed(part, places) for name, part in parts.items() if np.isfinite(part).any()}


def _packed(figures: Array, places: NDArray[np.int64]) -> Payload:
    return numbers(figures[places])

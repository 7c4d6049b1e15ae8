"""The charts of a motor and of a night, as data: drawn by Plotly on pages, by Matplotlib on paper.

A chart is some panels below one another on one axis of time.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.estimation.sample_blocks import TRAINING, VALIDATION
from pipeline.arrays import Array
from pipeline.messages import plain
from pipeline.palette import COLOURS, path_places
from pipeline.report.tables import Course, MotorHistory
from pipeline.report.words import EVENTS, STATUSES
from pipeline.trends.nights.decisions import LEAKAGE
from pipeline.trends.sentences import cause_words

Times = NDArray[np.datetime64]
Row = Mapping[str, Any]

BLUE, VERMILION, ORANGE = COLOURS[0], COLOURS[1], COLOURS[4]
GREY: Final = "#8a949e"
GAP = "gap_change_"
# Evidence that far beyond its limit says nothing more, and would hide how it came there.
SHOWN_EVIDENCE = 2.5
# Half the height of an axis at least, as a share of the middle value: noise looks like noise.
LEAST_REACH = 0.15


@dataclass(frozen=True, slots=True)
class Line:
    """A course of shape (n,); NaN where it has no value."""

    name: str
    time: Times
    value: Array
    colour: str
    # lower, upper: its interval.
    lower: Array | None = None
    upper: Array | None = None
    # dash, symbol: names of Plotly; empty: no line, or no marks.
    dash: str = "solid"
    symbol: str = ""
    words: tuple[str, ...] = ()  # of each point, beside its value


@dataclass(frozen=True, slots=True)
class Panel:
    """Lines on one axis of values."""

    title: str
    unit: str
    lines: tuple[Line, ...]
    ends: tuple[float, float] | None = None  # of its axis; None: as the lines need
    height: int = 170  # pixels on a page; on paper the heights' proportions hold
    has_axis: bool = True


@dataclass(frozen=True, slots=True)
class Mark:
    """A dated event, or a change that was detected."""

    night: dt.date
    words: str
    colour: str


@dataclass(frozen=True, slots=True)
class Chart:
    """Panels on one axis of time; none: there is nothing to show."""

    panels: tuple[Panel, ...]
    shaded: tuple[tuple[dt.date, dt.date], ...] = ()  # first and last night of each baseline
    marks: tuple[Mark, ...] = ()  # in order of time; numbered from 1


def watch_chart(
    motor: MotorHistory,
    declared: Iterable[str],
    events: Sequence[Row] = (),
    changes: Sequence[Row] = (),
) -> Chart:
    """What the watch has found over the nights.

    `declared` are the motor's leakage paths in the config's order, `events` its dated events,
    `changes` its rows of `alarms`.
    """
    panels = (
        _leakage_panel(motor),
        _outcomes(motor),
        _evidence_panel(motor),
        _gap_panel(motor, declared),
    )
    marks = [*_events(events), *_detected(motor, changes)]
    return Chart(
        tuple(one for one in panels if one is not None and one.lines),
        tuple(motor.baselines.select("start", "end").drop_nulls().iter_rows()),
        tuple(sorted(marks, key=lambda one: one.night)),
    )


def conditions_chart(motor: MotorHistory) -> Chart:
    """For the analyst: fit, measured flow and operating conditions of each night."""
    columns = {
        "training_fit_percent": "on training data",
        "validation_fit_percent": "on validation data",
        "previous_model_fit_percent": "of the night before's model",
    }
    lines = [
        _styled(name, motor.stamps, motor.fitted(column), place)
        for place, (column, name) in enumerate(columns.items())
    ]
    # A poor fit may lie far below the others; the axis ends at −50 %.
    lowest = min((float(np.nanmin(one.value)) for one in _known(lines)), default=60.0)
    ends = max(min(lowest - 3.0, 60.0), -50.0), 101.0
    panels = [Panel("Fit of the model", "%", _known(lines), ends)]
    single = (
        ("Drain flow, mean of the night", "l/min", "mean_flow_l_per_min"),
        ("Pressure difference", "bar", "own_pressure_bar"),
        ("Oil temperature", "°C", "own_temperature_c"),
        ("Speed", "rpm", "own_speed_rpm"),
    )
    for title, unit, column in single:
        line = Line(title, motor.stamps, motor.fitted(column), BLUE, symbol="circle")
        panels.append(Panel(title, unit, _known([line]), height=90))
    return Chart(tuple(one for one in panels if one.lines))


def night_chart(samples: pl.DataFrame) -> Chart:
    """Measured and modelled drain flow of a night with its inputs, from rows of `predictions`."""
    if samples.is_empty():
        return Chart(())
    time = samples["time"].dt.replace_time_zone(None).to_numpy().astype("datetime64[s]")
    steps = np.diff(time).astype(np.int64)
    longest = 3 * np.quantile(steps, 0.95) if len(steps) else 0
    # Where samples are missing a row without values breaks the lines.
    gaps = np.flatnonzero(steps > longest) + 1
    time = np.insert(time, gaps, time[gaps - 1] + np.timedelta64(1, "s"))
    part = np.insert(samples["part"].to_numpy().astype(object), gaps, "")

    def column(name: str) -> Array:
        values: Array = np.insert(samples[name].cast(pl.Float64).to_numpy(), gaps, np.nan)
        return values

    measured, predicted = column("measured_l_per_min"), column("predicted_l_per_min")
    flow = [Line("measured", time, measured, GREY)]
    for name, colour, dash in ((TRAINING, BLUE, "solid"), (VALIDATION, VERMILION, "dash")):
        of_part = np.where(part == name, predicted, np.nan)
        flow.append(Line(f"model, {name} data", time, of_part, colour, dash=dash))
    inputs = (
        ("Pressure difference", "bar", "pressure_difference_bar"),
        ("Oil temperature", "°C", "oil_temperature_c"),
        ("Speed", "rpm", "speed_rpm"),
    )
    panels = [Panel("Drain flow", "l/min", _known(flow), height=200)]
    for title, unit, name in inputs:
        lines = (Line(title, time, column(name), BLUE),)
        panels.append(Panel(title, unit, lines, height=80))
    return Chart(tuple(panels))


def gap_courses(motor: MotorHistory, declared: Iterable[str]) -> list[tuple[str, int, Course]]:
    """Path, its place among the colours, and the gap change of each night's own fit, %."""
    paths = [name.removeprefix(GAP) for name in motor.trends if name.startswith(GAP)]
    places = path_places([*declared, *paths])
    found = ((path, places[path], motor.course(GAP + path)) for path in paths)
    return sorted((one for one in found if one[2].is_known.any()), key=lambda one: one[1])


def _gap_panel(motor: MotorHistory, declared: Iterable[str]) -> Panel | None:
    """Changes of the gaps; None where no gap is known."""
    lines = tuple(
        _styled(plain(path), motor.stamps, one.value, place, one.lower, one.upper)
        for path, place, one in gap_courses(motor, declared)
    )
    ends = _ends([np.zeros(1), *(one.value for one in lines)], 5.0)
    return Panel("Change of the gap, night by night", "%", lines, ends, 150) if lines else None


def _leakage_panel(motor: MotorHistory) -> Panel:
    """The leakage; without any, the drain flow as measured, under its own name."""
    leakage = motor.leakage
    if not leakage.is_known.any():
        flow = motor.fitted("mean_flow_l_per_min")
        line = Line("drain flow", motor.stamps, flow, GREY, symbol="circle")
        return Panel("Drain flow, mean of the night", "l/min", _known([line]))
    own = _styled("leakage", motor.stamps, leakage.value, 0, leakage.lower, leakage.upper)
    level = Line("baseline", motor.stamps, motor.level, GREY, dash="dash")
    ends = _ends([own.value, level.value], LEAST_REACH * float(np.nanmedian(own.value)))
    return Panel("Leakage at its own conditions", "l/min", _known([own, level]), ends, 210)


def _outcomes(motor: MotorHistory) -> Panel | None:
    """Nights without a fit, each with its reason."""
    kinds = (("failed", VERMILION, "x"), ("insufficient_data", ORANGE, "diamond"))
    quiet = (("stood_still", GREY, "circle-open"), ("no_new_data", GREY, "line-ns-open"))
    lines = []
    for status, colour, symbol in (*kinds, *quiet):
        places = np.flatnonzero((motor.fits["status"] == status).fill_null(value=False))
        if len(places):
            words = tuple((motor.fits["reason"][int(at)] or "")[:120] for at in places)
            time, level = motor.stamps[places], np.full(len(places), 0.5)
            line = Line(STATUSES[status], time, level, colour, dash="", symbol=symbol, words=words)
            lines.append(line)
    panel = Panel("Nights without a fit", "", tuple(lines), (0.0, 1.0), 16, has_axis=False)
    return panel if lines else None


def _evidence_panel(motor: MotorHistory) -> Panel | None:
    time, limit, whole = motor.stamps, motor.watched("evidence_limit"), motor.watched("evidence")
    if not np.isfinite(limit).any():
        return None
    whole[~np.isfinite(whole)] = np.nan
    top = SHOWN_EVIDENCE * float(np.nanmax(limit))
    words = tuple("" if np.isnan(one) else f"{one:.1f}" for one in whole.tolist())
    lines = (
        Line("evidence", time, np.minimum(whole, top), BLUE, symbol="circle", words=words),
        Line("limit: a change is detected above it", time, limit, VERMILION, dash="longdash"),
    )
    return Panel("Evidence of a change", "ln R", _known(lines), (-2.0, 1.05 * top), 110)


def _events(events: Iterable[Row]) -> Iterable[Mark]:
    for one in events:
        kind = EVENTS.get(one["kind"], plain(one["kind"]))
        note = f": {one['note']}" if one.get("note") else ""
        yield Mark(one["date"], f"{kind}{note}", GREY)


def _detected(motor: MotorHistory, changes: Iterable[Row]) -> Iterable[Mark]:
    """Nights in which a change was detected, by its last cause, and nights that began an alarm."""
    told = motor.watch.filter(pl.col("told_on").is_not_null(), pl.col("goes_on").not_())
    causes = told.unique("told_on", keep="last", maintain_order=True).select("told_on", "cause")
    for night, cause in causes.iter_rows():
        what = "cause not known" if cause == "cannot_be_told" else cause_words(cause)
        yield Mark(night, f"change detected: {what}", ORANGE)
    for row in changes:
        if row["indicator"] == LEAKAGE and row["to_state"] == "alarm" != row["from_state"]:
            yield Mark(row["night"], "alarm", VERMILION)


def _styled(
    name: str,
    time: Times,
    value: Array,
    place: int,
    lower: Array | None = None,
    upper: Array | None = None,
) -> Line:
    """A line in the look of a place; dash and mark differ too, to be told apart in grey."""
    dashes = ("solid", "dash", "dot", "dashdot", "longdash")
    symbols = ("circle", "square", "diamond", "triangle-up", "x")
    colour, dash, symbol = (one[place % len(one)] for one in (COLOURS, dashes, symbols))
    return Line(name, time, value, colour, lower, upper, dash, symbol)


def _known(lines: Iterable[Line]) -> tuple[Line, ...]:
    return tuple(one for one in lines if np.isfinite(one.value).any())


def _ends(values: Sequence[Array], reach: float) -> tuple[float, float]:
    """Ends of an axis that reach at least so far around the middle value."""
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    middle = float(np.median(known))
    low, high = min(known.min(), middle - reach), max(known.max(), middle + reach)
    return float(low - 0.05 * (high - low)), float(high + 0.05 * (high - low))

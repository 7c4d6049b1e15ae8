"""The charts of a fleet, a motor and a night, as data; `plotly_json` has them for Plotly.

A chart is some panels below each other on a common axis of time.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.estimation.blocks import TRAINING, VALIDATION
from pipeline.arrays import Array, keep_extremes
from pipeline.config.motors import Event
from pipeline.messages import figure, plain
from pipeline.report.status import MotorHistory
from pipeline.trends.decisions import LEAKAGE
from pipeline.trends.motor_states import what_of
from pipeline.trends.sentences import DATED, cause_words

# Of Okabe and Ito, "Color universal design", 2008: distinguished with any kind of colour vision, on
# white and on black paper.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999")
# Paths of the thesis's motors have the first places; others follow by name.
FIRST = ("piston_ring", "balance_piston", "balance_sleeve", "cam_roller")


# Times of a chart, or lags [s].
Times = NDArray[np.datetime64] | Array
Row = Mapping[str, Any]

BLUE, VERMILION, ORANGE = COLOURS[0], COLOURS[1], COLOURS[4]
# Share of the present trend's days to the alarm level that is shown beyond its earliest date.
BEYOND = 1.05
GREY: Final = "#8a949e"
GAP = "gap_change_"
# Of the small picture of a motor's leakage.
WIDTH, HEIGHT, MARGIN = 120.0, 28.0, 2.5
POINTS = 90
# It is at least this share of the median high each way, so that noise looks like noise.
LEAST_REACH = 0.15
# Days without a value over which no line is drawn.
LONGEST_GAP = 7
# The axis of the evidence ends that far beyond its limit: more would hide how it came there.
SHOWN_EVIDENCE = 2.5


@dataclass(frozen=True, slots=True)
class Line:
    """Values at the times of a chart, shape (n,); NaN where there is none."""

    name: str
    value: Array
    colour: str = BLUE
    # lower, upper: its interval.
    lower: Array | None = None
    upper: Array | None = None
    # dash, symbol: names of Plotly; empty: no marks.
    dash: str = "solid"
    symbol: str = ""
    is_band: bool = False  # its interval is a band, not a bar at each night
    time: Times | None = None  # of its own, as beyond the last night; None: those of the chart


@dataclass(frozen=True, slots=True)
class Area:
    """A shaded area, by its corners."""

    time: Times
    value: Array
    colour: str


@dataclass(frozen=True, slots=True)
class Panel:
    """Lines on a common axis of values."""

    title: str
    unit: str
    lines: tuple[Line, ...]
    ends: tuple[float, float] | None = None  # of its axis; None: as the lines need
    height: int = 170  # pixels
    areas: tuple[Area, ...] = ()
    right: float | None = None  # l/min at 0 %, for an axis on the right; None: there is none


@dataclass(frozen=True, slots=True)
class Mark:
    """A dated event, or a change that was detected."""

    night: dt.date
    words: str
    colour: str


@dataclass(frozen=True, slots=True)
class Chart:
    """Panels on a common axis of time, or of lags in seconds; none: there is nothing to show."""

    time: Times
    panels: tuple[Panel, ...]
    shaded: tuple[tuple[dt.date, dt.date], ...] = ()  # first and last night of each baseline
    marks: tuple[Mark, ...] = ()  # in order of time
    until: np.datetime64 | None = None  # beyond the last night; None: that


def watch_chart(
    motor: MotorHistory,
    declared: Iterable[str],
    events: Iterable[Event] = (),
    changes: Iterable[Row] = (),
) -> Chart:
    """Return what the watch has found over the nights; `declared` are the motor's leakage paths."""
    projection = _projection(motor)
    leakage = _leakage_panel(motor, projection)
    panels = (leakage, _evidence_panel(motor), _gap_panel(motor, declared))
    marks = [
        Mark(event.date, ": ".join(filter(None, (plain(event.kind), event.note))), GREY)
        for event in events
    ]
    marks += _detections(motor, changes)
    return Chart(
        motor.stamps,
        _shown(panels),
        tuple(motor.baselines),
        tuple(sorted(marks, key=lambda mark: mark.night)),
        projection[1].time.max() if projection else None,
    )


def night_chart(samples: pl.DataFrame) -> Chart:
    """Return measured and modelled drain flow of a night and its inputs, from `predictions`."""
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

    predicted = column("predicted_l_per_min")
    flow = [Line("measured", column("measured_l_per_min"), GREY)]
    for name, colour, dash in ((TRAINING, BLUE, "solid"), (VALIDATION, VERMILION, "dash")):
        of_part = np.where(part == name, predicted, np.nan)
        flow.append(Line(f"model, {name} data", of_part, colour, dash=dash))
    panels = [Panel("Drain flow", "l/min", tuple(flow), height=200)]
    for title, unit, name in (
        ("Pressure difference", "bar", "pressure_difference_bar"),
        ("Oil temperature", "°C", "oil_temperature_c"),
        ("Speed", "rpm", "speed_rpm"),
    ):
        panels.append(Panel(title, unit, (Line(title, column(name)),), height=80))
    return Chart(time, _shown(panels))


def residual_chart(tests: Iterable[Row]) -> Chart:
    """Return correlations of the errors lag by lag with their 99 % bands: equations (27) and (26).

    `tests` are rows of `residual_tests` of a fit; those of validation count where there are any.
    """
    drawn = [row for row in tests if row["lags_s"]]
    part = VALIDATION if any(row["part"] == VALIDATION for row in drawn) else TRAINING
    rows = [row for row in drawn if row["part"] == part]
    rows.sort(key=lambda row: (row["test"] != "whiteness", row["input"]))
    lags: list[float] = max((row["lags_s"] for row in rows), key=len, default=[])
    panels = []
    for row in rows:
        # Errors have no later errors that are earlier.
        empty = [None] * (len(lags) - len(row["lags_s"]))
        value, bound = (
            np.array([*empty, *row[name]], dtype=np.float64) for name in ("correlations", "bounds")
        )
        what = "themselves" if row["test"] == "whiteness" else plain(row["input"])
        lines = (
            Line("99 % band from", -bound, GREY, dash="dot"),
            Line("to", bound, GREY, dash="dot"),
            Line("correlation", value, symbol="circle"),
        )
        panels.append(Panel(f"Errors with {what}: {row['verdict']}", "", lines, height=80))
    return Chart(np.array(lags, dtype=np.float64), _shown(panels))


def _gap_panel(motor: MotorHistory, declared: Iterable[str]) -> Panel:
    """Return the gap change of each night's own fit, %, in the colours of the paths."""
    paths = [name.removeprefix(GAP) for name in motor.trends if name.startswith(GAP)]
    places = path_places([*declared, *paths])
    courses = {path: motor.course(GAP + path) for path in sorted(paths, key=places.__getitem__)}
    lines = tuple(_style(plain(path), places[path], *of) for path, of in courses.items())
    ends = _ends([np.zeros(1), *(line.value for line in lines)], 5.0)
    return Panel("Change of the gap, night by night", "%", lines, ends, 150)


def path_places(names: Iterable[str]) -> dict[str, int]:
    """Return place of each path of a motor among colours, line styles and marks."""
    paths = set(names)
    order = (*FIRST, *sorted(paths.difference(FIRST)))
    return {name: place for place, name in enumerate(order) if name in paths}


def _projection(motor: MotorHistory) -> tuple[Line, Area] | None:
    """Return the present trend's way to the alarm level, and its 90 % band; None without a date."""
    if not motor.nights:
        return None
    row, level = motor.rows.row(-1, named=True), _alarm_level(motor)
    change, earliest = row["leakage_change_percent"], row["days_to_limit_lower"]
    likeliest, latest = row["days_to_limit"], row["days_to_limit_upper"]
    if row["days_to_limit_status"] not in DATED or change is None or not change < level:
        return None
    end = latest or BEYOND * (likeliest or earliest)
    corners = [(0.0, change), (earliest, level), (end, level)]
    corners += [] if latest else [(end, change)]
    night = np.datetime64(row["night"], "m")

    def after(*days: float) -> Times:
        return night + np.array([np.timedelta64(round(1440 * some), "m") for some in days])

    days, changes = zip(*corners, strict=True)
    name = "90 % band" if likeliest else "earliest of its 90 % band"
    values, until = np.array([change, level]), after(0.0, likeliest or earliest)
    line = Line(f"projection, {name}", values, ORANGE, dash="dash", time=until)
    return line, Area(after(*days), np.array(changes), ORANGE)


def _alarm_level(motor: MotorHistory) -> float:
    """Return the rise that is an alarm, %: the fleet's, or that to the motor type's own limit."""
    row = motor.rows.row(-1, named=True)
    level = float(row["alarm_level_percent"] or np.nan)
    reference = motor.trends.get("reference_leakage")
    if row["alarm_limit_l_per_min"] is None or reference is None:
        return level
    means = [mean for mean in reference["baseline_mean"] if mean is not None] or [np.nan]
    return float(np.fmin(level, 100.0 * (row["alarm_limit_l_per_min"] / means[-1] - 1.0)))


def _leakage_panel(motor: MotorHistory, projection: tuple[Line, Area] | None) -> Panel:
    """Return the leakage against its baseline; without any, the drain flow as measured."""
    change, lower, upper = (
        motor.figure(f"leakage_change_{end}") for end in ("percent", "lower", "upper")
    )
    if np.isnan(change).all():
        flow = Line("drain flow", motor.figure("mean_drain_flow_l_per_min"), GREY, symbol="circle")
        return Panel("Drain flow, mean of the night", "l/min", (flow,))
    own = Line("leakage", change, BLUE, lower, upper, symbol="circle", is_band=True)
    alarm, limits = _alarm_level(motor), motor.figure("detection_limit_percent")
    span = np.array([motor.nights[0], motor.nights[-1]], dtype="datetime64[m]")
    if projection is not None:
        span[1] = projection[1].time.max()

    def level(name: str, height: float, colour: str, dash: str) -> Line:
        return Line(name, np.full(2, height), colour, dash=dash, time=span)

    lines = [
        own,
        level("baseline", 0.0, GREY, "dash"),
        level(f"alarm level +{alarm:.3g} %", alarm, VERMILION, "longdash"),
    ]
    if np.isfinite(limits).any():
        warning = float(limits[np.isfinite(limits)][-1])
        lines.append(
            level(f"warning from a step of +{warning:.2g} %, ten nights", warning, ORANGE, "dot")
        )
    areas: tuple[Area, ...] = ()
    if projection is not None:
        lines.append(projection[0])
        areas = projection[1:]
    known = np.concatenate([change, [0.0, alarm, lower[-1], upper[-1]]])
    low, high = float(np.nanmin(known)), float(np.nanmax(known))
    ends = low - 0.08 * (high - low), high + 0.08 * (high - low)
    right = motor.baseline_leakage
    unit = "% and l/min" if right else "%"
    return Panel("Leakage against its baseline", unit, tuple(lines), ends, 250, areas, right)


def _evidence_panel(motor: MotorHistory) -> Panel | None:
    limit, evidence = motor.figure("evidence_limit"), motor.figure("evidence")
    if np.isnan(limit).all():
        return None
    whole = np.where(np.isfinite(evidence), evidence, np.nan)
    top = SHOWN_EVIDENCE * float(np.nanmax(limit))
    lines = (
        Line("evidence", whole, symbol="circle"),
        Line("limit: a change is detected above it", limit, VERMILION, dash="longdash"),
    )
    unit = "ln R" if np.nanmax(whole, initial=0.0) <= top else f"ln R, up to {top:.0f}"
    return Panel("Evidence of a change", unit, lines, (-2.0, top), 110)


def _detections(motor: MotorHistory, changes: Iterable[Row]) -> Iterable[Mark]:
    """Yield nights in which a change was detected, by its last cause, or an alarm began."""
    detected = motor.rows.filter(pl.col("detected_on").is_not_null(), ~pl.col("still_rising"))
    last = detected.unique("detected_on", keep="last", maintain_order=True)
    for night, cause in last.select("detected_on", "cause").iter_rows():
        what = "cause not known" if cause == "not_identified" else cause_words(cause)
        yield Mark(night, f"change detected: {what}", ORANGE)
    for row in changes:
        if what_of(row) == LEAKAGE and row["to_state"] == "alarm" != row["from_state"]:
            yield Mark(row["night"], "alarm", VERMILION)


def _style(name: str, place: int, value: Array, lower: Array, upper: Array) -> Line:
    """Return line in the look of a place; dash and mark differ too, to be distinguished in grey."""
    dashes = ("solid", "dash", "dot", "dashdot", "longdash")
    symbols = ("circle", "square", "diamond", "triangle-up", "x")
    colour, dash, symbol = (looks[place % len(looks)] for looks in (COLOURS, dashes, symbols))
    return Line(name, value, colour, lower, upper, dash, symbol)


def _shown(panels: Iterable[Panel | None]) -> tuple[Panel, ...]:
    """Return the panels that have a line with a value, with these lines alone."""
    filled = []
    for panel in panels:
        known = [line for line in panel.lines if np.isfinite(line.value).any()] if panel else []
        if panel and known:
            filled.append(replace(panel, lines=tuple(known)))
    return tuple(filled)


def _ends(values: Sequence[Array], reach: float) -> tuple[float, float]:
    """Return ends of an axis that reach at least so far around the middle value."""
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    middle = float(np.median(known))
    low, high = min(known.min(), middle - reach), max(known.max(), middle + reach)
    return float(low - 0.05 * (high - low)), float(high + 0.05 * (high - low))


def fleet_span(motors: Sequence[MotorHistory]) -> tuple[dt.date, dt.date] | None:
    """Return the first and the newest night of all motors; None where there is none."""
    nights = [night for motor in motors for night in (*motor.nights[:1], *motor.nights[-1:])]
    return (min(nights), max(nights)) if nights else None


def overlay(motors: Sequence[MotorHistory], level: float) -> dict[str, Any]:
    """Return the leakage of all motors against their baselines, % by night, for a chart."""
    nights = sorted({night for motor in motors for night in motor.nights})
    named = [{"name": motor.motor_id, "y": _changes(motor, nights)} for motor in motors]
    return {"nights": list(map(str, nights)), "motors": named, "alarm": level, "colours": COLOURS}


def _changes(motor: MotorHistory, nights: Sequence[dt.date]) -> list[float | None]:
    known = dict(motor.rows.select("night", "leakage_change_percent").iter_rows())
    changes = (known.get(night) for night in nights)
    return [None if change is None else round(change, 1) for change in changes]


def sparkline(motor: MotorHistory, span: tuple[dt.date, dt.date]) -> str:
    """Return a motor's leakage as SVG over the fleet's `span`, broken over long gaps."""
    leakage = motor.figure("own_leakage_l_per_min")
    known = np.flatnonzero(np.isfinite(leakage))
    if not len(known):
        return ""
    value = leakage[known]
    first, newest = (np.datetime64(edge) for edge in span)
    days = (motor.stamps[known] - first).astype(float)
    places = keep_extremes([value], POINTS)
    median = float(np.median(value))
    reach = max(float(np.abs(value - median).max()), LEAST_REACH * abs(median), 1e-9)

    def height(flow: Array) -> Array:
        inside: Array = np.clip((flow - median) / reach, -1.0, 1.0)
        return HEIGHT / 2 - inside * (HEIGHT / 2 - MARGIN)

    length = max(float((newest - first).astype(float)), 1.0)
    x = MARGIN + days[places] / length * (WIDTH - 2 * MARGIN)
    y = height(value[places])
    longest = max(LONGEST_GAP, 3 * length / POINTS)
    letters = np.where(np.diff(days[places], prepend=-np.inf) > longest, "M", "L")
    level = motor.baseline_leakage
    line = "".join(f"{letter}{a:.1f} {b:.1f}" for letter, a, b in zip(letters, x, y, strict=True))
    baseline = ""
    if level is not None:
        baseline = f"M{MARGIN:g} {height(np.array(level)):.1f}H{WIDTH - MARGIN:g}"
    text = f"Leakage {figure(value.min())} to {figure(value.max())} l/min"
    return (
        f'<svg class="sparkline" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{text}">'
        f'<path class="level" d="{baseline}"/><path d="{line}"/>'
        f'<circle cx="{x[-1]:.1f}" cy="{y[-1]:.1f}" r="2.2"/></svg>'
    )

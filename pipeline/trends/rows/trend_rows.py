"""Rows of `trends`: figures of a night that are shown, with slopes and dates of those watched."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.course.slope import fit_slope
from leakage.course.time_to_limit import time_to_limit
from leakage.estimation.identifiability import TOLD
from leakage.watch import Estimate
from pipeline.arrays import Array
from pipeline.night.time_base import VISCOSITIES
from pipeline.trends.nights.history import NIGHTS_BEFORE, WATCHED, History
from pipeline.trends.nights.layout import LOSS_FACTOR
from pipeline.trends.sentences import day
from pipeline.trends.states.course import Course, WatchedNight
from pipeline.trends.states.judged import JudgedNight
from pipeline.trends.states.zeros import HALF, Zero, health

Row = dict[str, Any]

DAYS_A_YEAR = 365.25
# Names in `trends` of what the watch says of a night.
REFERENCE, DEVIATION = "reference_leakage", "baseline_deviation"
INDICATORS = (REFERENCE, "own_reference_leakage", DEVIATION)
NO_HALT, NO_FIGURE = "no settled halt without pressure", "no figure"


def trend_rows(
    course: Course, night: JudgedNight, zeros: Mapping[str, Zero], words: str
) -> Iterator[Row]:
    """Rows of a night; `words` is what is reported of it."""
    shared = _shared(course, night, zeros)
    state: Row = {"state": night.state, "state_reason": words}
    change = night.change
    if change is not None and night.state != "ok":
        state["change_start"] = dt.date.fromordinal(change.since)
    for name in INDICATORS:
        yield shared | _watched_row(course, night, name) | state
    yield from (shared | row for row in _of_fit(course, night.watched))
    yield from (shared | row for row in _of_blocks(course, night.watched.place))
    for zero in zeros.values():
        if np.isfinite(zero.value[: night.watched.place + 1]).any():
            yield shared | _zero_row(zero, night.watched.place)


def _shared(course: Course, night: JudgedNight, zeros: Mapping[str, Zero]) -> Row:
    """Columns that all rows of a night share."""
    history, place = course.nights.history, night.watched.place
    record = history.records[place]
    hours, is_estimated = history.running_hours(place + 1)
    baseline = night.watched.baseline
    fit = course.nights.fits.get(night.watched.night, {})
    return {
        "motor_id": history.spec.motor_id,
        "night": night.watched.night,
        "n_nights": 1,
        "running_hours": float(hours[-1]),
        "running_hours_estimated": is_estimated,
        "oil": history.spec.file.oil_on(night.watched.night),
        "mean_temperature_c": _finite(record["mean_temperature_c"]),
        "share_reversed": _finite(record["share_reversed"]),
        "flushing_mode": fit.get("flushing_mode"),
        "baseline_start": None if baseline is None else baseline.start,
        "sensor_health": health(list(zeros.values()), place),
    }


def _watched_row(course: Course, night: JudgedNight, name: str) -> Row:
    """A figure of the watch, with its slope and the time to its limit."""
    watched, verdict = night.watched, night.watched.verdict
    found: Estimate | str | None = watched.own
    if name == REFERENCE:
        found = night.reference or watched.reference
    elif name == DEVIATION:
        found = verdict.newest_night if verdict is not None else watched.own
    limits = night.spec.motor_type.limits
    row: Row = {
        "indicator": name,
        "unit": "1" if name == DEVIATION else "l/min",
        "days_to_limit_status": "insufficient",
        "n_slope": 0,
        "provisional": False,
        "alarm_limit": limits.alarm_l_per_min if name == REFERENCE else None,
    }
    if isinstance(found, str) or not watched.n_blocks:
        return row | {"gated_reason": found if isinstance(found, str) else night.why_no_blocks}
    assert found is not None
    row |= {"value": found.value, "lower": found.lower, "upper": found.upper}
    if verdict is None:
        return row
    level = night.spec.settings.alarms.alarm_percent / 100.0
    shift = 1.0 if name == DEVIATION else 0.0
    frozen = _frozen(watched, name)
    row["deviation_percent"] = 100.0 * verdict.newest_night.value
    if frozen is None:
        return row
    row["baseline_mean"] = frozen - shift
    limit = row["alarm_limit"] or frozen * (1.0 + level)
    row["alarm_limit"] = row["alarm_limit"] or limit - shift
    column = WATCHED[INDICATORS.index(name)]
    return row | _line(course, night, column, limit, shift)


def _frozen(watched: WatchedNight, name: str) -> float | None:
    """An indicator over the baseline; the flow against the baseline is 1 there."""
    if name == DEVIATION or watched.baseline is None:
        return 1.0
    baseline = watched.baseline
    return baseline.reference_leakage if name == REFERENCE else baseline.own_leakage


def _line(course: Course, night: JudgedNight, name: str, limit: float, shift: float) -> Row:
    """Slopes and time to limit as of a night.

    Where a change stands told, of the nights since it began: a line across a step, or across
    nights before a wear began, is none. Where nothing is told, since the baseline began.
    """
    history, watched = course.nights.history, night.watched
    first, end = watched.period.first, watched.place + 1
    if night.change is not None:
        first = max(first, history.place_from(dt.date.fromordinal(night.change.since)))
    trend, here = night.spec.settings.trend, slice(first, end)
    numbers, series = history.numbers[here], course.figures[here, WATCHED.index(name)]
    hours = history.running_hours(end)[0][first:]
    line = fit_slope(numbers, series, numbers / DAYS_A_YEAR, coverage=trend.confidence)
    by_hours = fit_slope(numbers, series, hours / 1000.0, coverage=trend.confidence, median=False)
    row = {
        "n_slope": line.n,
        "slope_start": history.nights[first] if line.slope is not None else None,
        "provisional": line.status == "provisional",
        "p_value": line.p_value,
        "theil_sen_per_year": line.theil_sen,
        "theil_sen_outside": line.theil_sen_outside if line.slope is not None else None,
        **{
            f"slope_{per}{end}": figure
            for per, one in (("per_year", line), ("per_1000_h", by_hours))
            for end, figure in (("", one.slope), ("_lower", one.lower), ("_upper", one.upper))
        },
    }
    if line.slope is None:
        return row
    days = _days(numbers, hours, series, limit, trend.horizon_years)
    return row | {"limit": limit - shift} | days


def _days(
    nights: NDArray[np.int64], hours: Array, series: Array, limit: float, years_ahead: float
) -> Row:
    """Days to a limit: the fit goes by running hours, and the days by the hours of a night.

    Those of the last month and of all nights may differ; the earliest date takes the larger, the
    latest the smaller.
    """
    every, recent = (
        float(np.ptp(hours[part])) / max(int(np.ptp(nights[part])), 1)
        for part in (slice(None), slice(-NIGHTS_BEFORE - 1, None))
    )
    # A motor that has stood still for a month is taken to run again as it did.
    rates = every, recent or every
    found = time_to_limit(nights, hours, series, limit, years_ahead * DAYS_A_YEAR * max(rates))

    def days(ahead: float | None, rate: float) -> float | None:
        return None if ahead is None else ahead / rate

    return {
        "days_to_limit": days(found.time, every),
        "days_to_limit_lower": days(found.lower, max(rates)),
        "days_to_limit_upper": days(found.upper, min(rates)),
        "days_to_limit_status": found.status,
    }


def _of_fit(course: Course, watched: WatchedNight) -> Iterator[Row]:
    """Coefficients of the night's own fit: as such, as leakages, and as changes of gaps."""
    history, place = course.nights.history, watched.place
    figures = course.nights.parameters.get(watched.night, {})
    drives = course.drives_at(course.reference, place)
    for number, name in enumerate([*history.layout.coefficients, "C_f"]):
        if name not in figures or (name == "C_f" and not history.layout.is_flushed):
            continue
        # With its interval where it is identified; otherwise why it is not.
        figure, verdict = figures[name], figures[name]["verdict"] or ""
        why = "" if verdict in TOLD else figure["reason"] or verdict.replace("_", " ") or NO_FIGURE
        row: Row = {} if why else {end: figure[end] for end in ("value", "lower", "upper")}
        row |= {"gated_reason": why or None, "outside_fitted_range": False}
        yield row | {"indicator": name, "unit": _unit(name)}
        if name == "C_f":
            continue
        path = history.layout.paths[number]
        if not isinstance(drives, str):
            shown = _scaled(row, lambda one, by=float(drives[number]): by * one)
            yield row | shown | {"indicator": f"leakage_{path}", "unit": "l/min"}
        if watched.baseline is not None and name.startswith(LOSS_FACTOR):
            first = watched.baseline.coefficients[number]
            if first > 0.0:
                # A loss factor goes with the cube of its gap.
                gap = _scaled(row, lambda one, by=first: 100.0 * (math.cbrt(one / by) - 1.0))
                yield row | gap | {"indicator": f"gap_change_{path}", "unit": "%"}


def _unit(name: str) -> str:
    return "l/min" if name == "C_f" else "m3" if name.startswith(LOSS_FACTOR) else "1"


def _scaled(row: Row, change: Any) -> Row:
    ends = (end for end in ("value", "lower", "upper") if row.get(end) is not None)
    return {end: change(row[end]) for end in ends}


def _of_blocks(course: Course, place: int) -> Iterator[Row]:
    """Mean case drain flow, and the oil as measured."""
    history = course.nights.history
    blocks = course.nights.blocks.get(history.nights[place].toordinal())
    if blocks is not None:
        flow = float(np.mean(blocks.flow)) + history.layout.fixed_flushing
        yield {"indicator": "drain_flow", "unit": "l/min", "value": flow}
    if (ratio := viscosity_ratio(history, place)) is not None:
        words = oil_as_measured(history, place)
        value = 100.0 * (ratio - 1.0)
        yield {"indicator": "oil_viscosity", "unit": "%", "value": value, "state_reason": words}


def _zero_row(zero: Zero, place: int) -> Row:
    value, half = zero.value[place], HALF * zero.error[place]
    return {
        "indicator": zero.name,
        "unit": zero.unit,
        "value": _finite(value),
        "lower": _finite(value - half),
        "upper": _finite(value + half),
        "gated_reason": None if np.isfinite(value) else NO_HALT,
        "outside_fitted_range": False,
        "baseline_mean": _finite(zero.first[place]),
        "state": zero.state[place],
        "state_reason": zero.words(place) or None,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def oil_as_measured(history: History, place: int) -> str:
    """Measured viscosity of a night's oil in words, and its water; empty if not measured."""
    ratio, night = viscosity_ratio(history, place), history.nights[place]
    if ratio is None:
        return ""
    percent = 100.0 * (ratio - 1.0)
    size = f"{abs(percent):.0f} % {'thinner' if percent < 0 else 'thicker'} than its data sheet"
    words = "as its data sheet" if abs(percent) < 0.5 else size
    samples = [one for one in history.spec.samples_of(night) if one.date <= night]
    measured = [one.date for one in samples if one.viscosity_40_c_mm2_per_s is not None]
    water = [one.water_mg_per_kg for one in samples if one.water_mg_per_kg is not None]
    by_log = any(name in history.spec.file.channels for name in VISCOSITIES)
    source = "by the log" if by_log or not measured else f"on {day(measured[-1])}"
    wet = f", water {water[-1]:g} mg/kg" if water else ""
    return f"oil as measured {source}: {words}{wet}"


def viscosity_ratio(history: History, place: int) -> float | None:
    """Measured viscosity over the data sheet's, of the last night that has it."""
    ratios = history.records["viscosity"][: place + 1]
    known = ratios[np.isfinite(ratios)]
    return float(known[-1]) if len(known) else None

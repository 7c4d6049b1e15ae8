"""Rows of `trends`: figures of a night that are shown, with slopes and dates of those watched."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.course import fit_slope, time_to_limit, zero_course
from leakage.estimation.identifiability import WITH_VALUE
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.night.time_base import VISCOSITIES
from pipeline.schema import Row
from pipeline.trends.checkpoint import WATCHED
from pipeline.trends.course import Course
from pipeline.trends.decisions import FLOW_ZERO, PRESSURE_ZERO, SENSORS
from pipeline.trends.night_state import NightState
from pipeline.trends.nights import HALF, NIGHTS_BEFORE, BaselinePeriod, PublishedNights
from pipeline.trends.sentences import day
from pipeline.trends.watch_columns import LOSS_FACTOR

DAYS_A_YEAR = 365.25
# A straight line says nothing of a limit beyond [years].
HORIZON_YEARS = 5.0
REFERENCE = "reference_leakage"
NO_HALT, NO_FIGURE = "no settled halt without pressure", "no figure"


def trend_rows(course: Course, night: NightState, zeros: Mapping[str, Zero]) -> Iterator[Row]:
    """Yield rows of a night's own fit, its blocks, and the zeros of its sensors."""
    place = night.place
    yield from _of_fit(course, night)
    yield from _of_blocks(course, place)
    for zero in zeros.values():
        if np.isfinite(zero.value[: place + 1]).any():
            yield _zero_row(zero, place)


def leakage_rows(course: Course, night: NightState) -> tuple[list[Row], Row]:
    """Return rows of the two leakages with their slopes, and columns of `nights` on their limit.

    The limit is that of the figure that alarms; the days are those of the first that comes. What is
    no wear has none.
    """
    stated = night.spec.motor_type.limits.alarm_l_per_min
    rise = 1.0 + night.spec.settings.alarms.alarm_percent / 100.0
    limits: Row = {"alarm_limit_l_per_min": stated, "days_to_limit_status": "insufficient"}
    rows, dated = [], []
    for name in WATCHED:
        frozen = _frozen(night, name)
        row = _leakage_row(night, name)
        if "value" in row and frozen is not None and night.verdict is not None:
            row["baseline_mean"] = frozen
            limit = stated if name == REFERENCE else _risen(course, night, rise)
            line, days = _line(course, night, name, limit if night.may_wear else None)
            row |= line
            dated += [days] if days else []
        rows.append(row)
    return rows, limits | min(dated, key=_earliest, default={})


def _risen(course: Course, night: NightState, rise: float) -> float | None:
    """Return what the baseline's leakage has to grow to, by the oil of the night."""
    first = course.first_leakage(night.place)
    return None if isinstance(first, str) else rise * first


def _earliest(days: Row) -> tuple[bool, float]:
    lower = days.get("days_to_limit_lower")
    return lower is None, lower or 0.0


def _leakage_row(night: NightState, name: str) -> Row:
    leakage = night.own_leakage
    if name == REFERENCE:
        leakage = night.reference or night.reference_leakage
    row: Row = {"indicator": name, "unit": "l/min", "n_nights": 0, "is_provisional": False}
    if isinstance(leakage, str) or not night.n_blocks:
        return row | {"reason": leakage if isinstance(leakage, str) else night.why_no_blocks}
    return row | {"value": leakage.value, "lower": leakage.lower, "upper": leakage.upper}


def _frozen(night: NightState, name: str) -> float | None:
    """Return a leakage over the baseline; None where there is none."""
    baseline = night.baseline
    if baseline is None:
        return None
    return baseline.reference_leakage if name == REFERENCE else baseline.own_leakage


def _line(course: Course, night: NightState, name: str, limit: float | None) -> tuple[Row, Row]:
    """Return slopes of a leakage since the change in force or the baseline, and days to its limit.

    A line across a step, as that of another oil, or across nights before a wear began, is none.
    """
    nights, first, end = course.nights, night.period.first, night.place + 1
    begins = [event.date for event in night.spec.file.changes if event.date <= night.night]
    if night.change is not None:
        begins.append(dt.date.fromordinal(night.change.since))
    first = max([first, *map(nights.place_from, begins)])
    here = slice(first, end)
    numbers, series = nights.numbers[here], course.figures[here, WATCHED.index(name)]
    hours = nights.running_hours(end)[first:]
    line = fit_slope(numbers, series, numbers / DAYS_A_YEAR)
    by_hours = fit_slope(numbers, series, hours / 1000.0)
    row: Row = {"n_nights": line.n, "is_provisional": line.is_provisional}
    for per, slope in (("per_year", line), ("per_1000_h", by_hours)):
        row[f"slope_{per}"] = slope.slope
        row |= {f"slope_{per}_lower": slope.lower, f"slope_{per}_upper": slope.upper}
    if line.slope is None or limit is None:
        return row, {}
    return row, _days(numbers, hours, series, limit)


def _days(nights: NDArray[np.int64], hours: Array, series: Array, limit: float) -> Row:
    """Return days to a limit: the fit goes by running hours, and the days by the hours of a night.

    Of those of the last month and of all nights the earliest date takes the larger.
    """
    every, recent = (
        float(np.ptp(hours[part])) / max(int(np.ptp(nights[part])), 1)
        for part in (slice(None), slice(-NIGHTS_BEFORE - 1, None))
    )
    # A motor that has stood still for a month is taken to run again as it did.
    rates = every, recent or every
    ahead = time_to_limit(nights, hours, series, limit, HORIZON_YEARS * DAYS_A_YEAR * max(rates))

    def days(time: float | None, rate: float) -> float | None:
        return None if time is None else time / rate

    return {
        "days_to_limit": days(ahead.time, every),
        "days_to_limit_lower": days(ahead.lower, max(rates)),
        "days_to_limit_upper": days(ahead.upper, min(rates)),
        "days_to_limit_status": ahead.status,
    }


def _of_fit(course: Course, night: NightState) -> Iterator[Row]:
    """Yield coefficients of the night's own fit: as such, as leakages, and as changes of gaps."""
    columns = course.nights.watch_columns
    figures = course.nights.parameters.get(night.night, {})
    drives = course.drives_at(course.reference, night.place)
    for number, name in enumerate([*columns.coefficients, "C_f"]):
        if name not in figures or (name == "C_f" and not columns.is_flushed):
            continue
        # With its interval where it is identified; otherwise why it is not.
        figure, verdict = figures[name], figures[name]["verdict"] or ""
        row: Row = {"reason": figure["reason"] or verdict.replace("_", " ") or NO_FIGURE}
        if verdict in WITH_VALUE:
            row = {end: figure[end] for end in ("value", "lower", "upper")}
        unit = "l/min" if name == "C_f" else "m3" if name.startswith(LOSS_FACTOR) else "1"
        yield row | {"indicator": name, "unit": unit}
        if name == "C_f":
            continue
        path = columns.paths[number]
        if not isinstance(drives, str):
            shown = _scale(row, lambda value, by=float(drives[number]): by * value)
            yield row | shown | {"indicator": f"leakage_{path}", "unit": "l/min"}
        if night.baseline is not None and name.startswith(LOSS_FACTOR):
            first = night.baseline.coefficients[number]
            if first > 0.0:
                # A loss factor goes with the cube of its gap.
                gap = _scale(row, lambda value, by=first: 100.0 * (math.cbrt(value / by) - 1.0))
                yield row | gap | {"indicator": f"gap_change_{path}", "unit": "%"}


def _scale(row: Row, change: Any) -> Row:
    """Return the value of a row and its ends as something that follows from them."""
    ends = (end for end in ("value", "lower", "upper") if row.get(end) is not None)
    return {end: change(row[end]) for end in ends}


def _of_blocks(course: Course, place: int) -> Iterator[Row]:
    """Yield mean case drain flow, and the oil as measured."""
    nights = course.nights
    blocks = nights.blocks.get(nights.labels[place].toordinal())
    if blocks is not None:
        flow = float(np.mean(blocks.flow)) + nights.watch_columns.fixed_flushing
        yield {"indicator": "drain_flow", "unit": "l/min", "value": flow}
    if (ratio := viscosity_ratio(nights, place)) is not None:
        yield {"indicator": "oil_viscosity", "unit": "%", "value": 100.0 * (ratio - 1.0)}


def _zero_row(zero: Zero, place: int) -> Row:
    value, half = zero.value[place], HALF * zero.error[place]
    return {
        "indicator": zero.name,
        "unit": zero.unit,
        "value": _finite(value),
        "lower": _finite(value - half),
        "upper": _finite(value + half),
        "reason": None if np.isfinite(value) else NO_HALT,
        "baseline_mean": _finite(zero.first[place]),
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def oil_as_measured(nights: PublishedNights, place: int) -> str:
    """Return measured viscosity of a night's oil in words; empty if not measured."""
    ratio, night = viscosity_ratio(nights, place), nights.labels[place]
    if ratio is None:
        return ""
    percent = 100.0 * (ratio - 1.0)
    size = f"{abs(percent):.0f} % {'thinner' if percent < 0 else 'thicker'} than its data sheet"
    words = "as its data sheet" if abs(percent) < 0.5 else size
    dates = (sample.date for sample in nights.spec.samples_of(night))
    measured = [date for date in dates if date <= night]
    by_log = any(name in nights.spec.file.channels for name in VISCOSITIES)
    source = "by the log" if by_log or not measured else f"on {day(measured[-1])}"
    return f"oil as measured {source}: {words}"


def viscosity_ratio(nights: PublishedNights, place: int) -> float | None:
    """Return measured viscosity over the data sheet's, of the last night that has it."""
    ratios = nights.records["viscosity"][: place + 1]
    known = ratios[np.isfinite(ratios)]
    return float(known[-1]) if len(known) else None


PRESSURES = ("pressure_difference", "high_port_pressure", "low_port_pressure")
# A smaller move is no drift where the config states no tolerance: it moves the piston rings' K by
# less than K scatters (model.md, section 5).
LEAST_MOVE = {PRESSURE_ZERO: 0.5, FLOW_ZERO: 0.01}
COLUMNS = {
    PRESSURE_ZERO: ("pressure_zero_bar", "pressure_zero_upper"),
    FLOW_ZERO: ("flow_zero_l_per_min", "flow_zero_upper"),
}
UNITS = {PRESSURE_ZERO: "bar", FLOW_ZERO: "l/min"}
NAMES = {PRESSURE_ZERO: "pressure", FLOW_ZERO: "flow"}
# Nights with halts in a row that tell a drift, and that end it.
ON_NIGHTS, OFF_NIGHTS = 3, 5


@dataclass(frozen=True, slots=True)
class Zero:
    """A sensor's zero over a motor's nights; shape (n,) each."""

    # name, unit: as in `trends`.
    name: str
    unit: str
    # value, error: zero of each night and its standard error; nan where there was no halt, or too
    # few.
    value: Array
    error: Array
    first: Array  # zero of the first halts, as far as they were known in each night; nan before
    # move, lower, upper: how far it has moved since, and the interval; nan before ten nights with
    # halts.
    move: Array
    lower: Array
    upper: Array
    state: tuple[str, ...]  # insufficient, ok or warning
    periods: tuple[BaselinePeriod, ...]  # nights that the same zero at first serves

    def words(self, place: int, *, is_notice: bool = False) -> str:
        """Return that the sensor has drifted by a night, in words; empty where it has not."""
        if self.state[place] != "warning":
            return ""
        moves_little = "which moves the leakage by less than its interval"
        return (
            f"the zero of the {NAMES[self.name]} sensor has moved by "
            f"{self.move[place]:+z.3g} {self.unit} [{self.lower[place]:z.3g}, "
            f"{self.upper[place]:.3g}]"
            f"{f', {moves_little}' if is_notice else ': check it before the motor'}"
        )

    def is_notice(self, course: Course, night: NightState) -> bool:
        """Return True until a pressure zero moves the leakage beyond its interval (issue 49.8)."""
        baseline, verdict, place = night.baseline, night.verdict, night.place
        if self.name != PRESSURE_ZERO or self.state[place] != "warning":
            return False
        if baseline is None or verdict is None:
            return True
        own, theta = baseline.own, np.array(baseline.coefficients)
        shifted = replace(own, pressure_bar=own.pressure_bar + float(self.move[place]))
        before, after = (course.drives_at(at, place) for at in (own, shifted))
        if isinstance(before, str) or isinstance(after, str):
            return True
        effect = float(theta @ after) / max(float(theta @ before), 1e-12) - 1.0
        return abs(effect) <= verdict.present.upper - verdict.present.value


def sensor_zeros(nights: PublishedNights) -> dict[str, Zero]:
    """Return the zeros of a motor's sensors, by indicator."""
    return {name: _zero(nights, name) for name in SENSORS}


def _zero(nights: PublishedNights, name: str) -> Zero:
    value, upper = (nights.records[column].copy() for column in COLUMNS[name])
    error = (upper - value) / HALF
    if name == FLOW_ZERO and nights.spec.file.flushing.mode == "estimated":
        # What is flushed moves with it: nobody can tell which of the two has changed.
        value[:] = np.nan
    n = len(nights)
    first, move, low, high = (np.full(n, np.nan) for _ in range(4))
    state = np.full(n, "insufficient", dtype=object)
    periods = nights.periods(name)
    for period in periods if np.isfinite(value).any() else ():
        here = slice(period.first, period.end)
        course = zero_course(
            value[here],
            np.nan_to_num(error[here]),
            tolerance(nights.spec, name),
        )
        first[here], move[here] = course.zero - course.change, course.change
        low[here], high[here] = course.change_lower, course.change_upper
        reported = _held(course.drifts, np.isfinite(value[here]))
        known = np.isfinite(course.change)
        state[here] = np.where(known, np.where(reported, "warning", "ok"), "insufficient")
    return Zero(
        name, UNITS[name], value, error, first, move, low, high, tuple(state.tolist()), periods
    )


def _held(drifts: NDArray[np.bool_], halted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return nights with a drift reported: several with a halt in a row begin and end it."""
    reported = np.zeros(len(drifts), dtype=np.bool_)
    is_on, in_a_row = False, 0
    for place in range(len(drifts)):
        if halted[place]:
            in_a_row = in_a_row + 1 if drifts[place] != is_on else 0
            if in_a_row == (OFF_NIGHTS if is_on else ON_NIGHTS):
                is_on, in_a_row = not is_on, 0
        reported[place] = is_on
    return reported


def tolerance(spec: MotorSpec, name: str) -> float:
    """Return permitted move of a zero: the config's offset tolerance, at least `LEAST_MOVE`."""
    names = PRESSURES if name == PRESSURE_ZERO else ("leakage_flow",)
    declared = [spec.file.channels[column] for column in names if column in spec.file.channels]
    stated = float(np.hypot.reduce([channel.offset_tolerance for channel in declared]))
    return max(stated, LEAST_MOVE[name], *(channel.resolution for channel in declared))

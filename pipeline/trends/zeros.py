"""Zeros of the pressure and the flow sensor at halts: a sensor that drifts is named before wear."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.course.sensor_zero import zero_course
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.trends.course import Course
from pipeline.trends.decisions import FLOW_ZERO, PRESSURE_ZERO, SENSORS
from pipeline.trends.night_state import NightState
from pipeline.trends.nights import HALF, BaselinePeriod, PublishedNights

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
    """Nights with a drift reported: some with a halt in a row begin and end it, others hold."""
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

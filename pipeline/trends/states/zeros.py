"""Zeros of the pressure and the flow sensor at halts: a sensor that drifts is named before wear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from leakage.course.alarms import Levels, above_level
from leakage.course.sensor_zero import zero_course
from pipeline.config import MotorSpec
from pipeline.trends.nights.history import History
from pipeline.trends.nights.segments import Segment, segments

Array = NDArray[np.float64]

PRESSURE_ZERO, FLOW_ZERO = "pressure_zero", "flow_zero"
PRESSURES = ("pressure_difference", "high_port_pressure", "low_port_pressure")
# A smaller move is no drift where the config states no tolerance: it moves the piston rings' K by
# less than K scatters (model.md, section 5).
LEAST_MOVE = {PRESSURE_ZERO: 0.5, FLOW_ZERO: 0.01}
COLUMNS = {
    PRESSURE_ZERO: ("pressure_zero_bar", "pressure_zero_standard_error_bar"),
    FLOW_ZERO: ("flow_zero_l_per_min", "flow_zero_standard_error_l_per_min"),
}
UNITS = {PRESSURE_ZERO: "bar", FLOW_ZERO: "l/min"}
SENSORS = {PRESSURE_ZERO: "pressure", FLOW_ZERO: "flow"}
NO_HALT = "no settled halt without pressure"
HALF = float(ndtri(0.975))


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
    segments: tuple[Segment, ...]  # nights that one zero at first serves

    def words(self, place: int) -> str:
        """That the sensor has drifted by a night, in words; empty where it has not."""
        if self.state[place] != "warning":
            return ""
        return (
            f"the zero of the {SENSORS[self.name]} sensor has moved by "
            f"{self.move[place]:+.3g} {self.unit} [{self.lower[place]:.3g}, "
            f"{self.upper[place]:.3g}]: check it before the motor"
        )


def sensor_zeros(history: History) -> dict[str, Zero]:
    """The zeros of a motor's sensors, by indicator."""
    return {name: _zero(history, name) for name in (PRESSURE_ZERO, FLOW_ZERO)}


def health(zeros: Sequence[Zero], place: int) -> str:
    """Health of the sensors in a night, from their zeros: ok, drifted or unknown."""
    states = {zero.state[place] for zero in zeros}
    return "drifted" if "warning" in states else "ok" if "ok" in states else "unknown"


def _zero(history: History, name: str) -> Zero:
    value, error = (history.records[column].copy() for column in COLUMNS[name])
    if name == FLOW_ZERO and history.spec.file.flushing.mode == "estimated":
        # What is flushed moves with it: nobody can tell which of the two has changed.
        value[:] = np.nan
    n = len(history)
    first, move, lower, upper = (np.full(n, np.nan) for _ in range(4))
    state = np.full(n, "insufficient", dtype=object)
    parts = segments(history, name)
    rule = nights_rule(history.spec)
    for part in parts if np.isfinite(value).any() else ():
        here = part.here
        found = zero_course(
            history.numbers[here],
            value[here],
            np.nan_to_num(error[here]),
            tolerance(history.spec, name),
        )
        first[here], move[here] = found.zero - found.change, found.change
        lower[here], upper[here] = found.change_lower, found.change_upper
        # Nights with a halt decide; the others hold.
        drifts = np.where(np.isfinite(value[here]), found.drifts.astype(np.float64), np.nan)
        known = np.isfinite(found.change)
        told = above_level(np.where(known, drifts, np.nan), 0.5, 0.0, rule)
        state[here] = np.where(known, np.where(told, "warning", "ok"), "insufficient")
    return Zero(
        name, UNITS[name], value, error, first, move, lower, upper, tuple(state.tolist()), parts
    )


def tolerance(spec: MotorSpec, name: str) -> float:
    """Permitted move of a zero: the config's offset tolerance, at least `LEAST_MOVE`."""
    names = PRESSURES if name == PRESSURE_ZERO else ("leakage_flow",)
    declared = [spec.file.channels[one] for one in names if one in spec.file.channels]
    stated = float(np.hypot.reduce([one.offset_tolerance for one in declared]))
    return max(stated, LEAST_MOVE[name], *(one.resolution for one in declared))


def nights_rule(spec: MotorSpec) -> Levels:
    """As many nights as other indicators need to go on and off."""
    needed, of = spec.settings.alarms.on_nights
    return Levels(on_nights=needed, of_nights=of, off_nights=spec.settings.alarms.off_nights)

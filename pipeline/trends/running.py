"""Running hours, confounders and sensor zeros of a motor's nights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.sensor_zero import ZeroDrift, zero_drift
from pipeline.config import MotorSpec
from pipeline.trends.history import History
from pipeline.trends.watch import night_numbers

Array = NDArray[np.float64]

# Nights before, whose mean share a night without a log takes.
NIGHTS_BEFORE = 30
HOURS_OF_A_NIGHT = 24.0


@dataclass(frozen=True, slots=True)
class RunningHours:
    """Running hours since a motor's first night.

    Attributes
    ----------
    total
        At the end of each night [h], shape (n,).
    estimated
        Whether some of them belong to nights without a log, shape (n,).
    """

    total: Array
    estimated: NDArray[np.bool_]


def running_hours(history: History) -> RunningHours:
    """Running hours at the end of each night; nights without a log take what the 30 before had."""
    own = history.operated("running_hours")
    numbers = night_numbers(history)
    total, estimated = np.zeros(len(own)), np.zeros(len(own), dtype=np.bool_)
    known: list[float] = []
    so_far, guessed, last = 0.0, False, -1
    for place, (number, hours) in enumerate(zip(numbers.tolist(), own.tolist(), strict=True)):
        usual = float(np.mean(known[-NIGHTS_BEFORE:])) if known else 0.0
        missing = number - last - 1
        so_far += missing * usual
        guessed |= missing > 0 or np.isnan(hours)
        if np.isnan(hours):
            so_far += usual
        else:
            so_far += hours
            known.append(hours)
        total[place], estimated[place], last = so_far, guessed, number
    return RunningHours(total, estimated)


def coverage(history: History, place: int, first: int, last: int) -> float | None:
    """How far a night saw what the nights of a baseline saw, from 0 to 1.

    Parameters
    ----------
    history
        The motor's nights.
    place
        The night.
    first, last
        Nights of the baseline, both included.

    Returns
    -------
    float or None
        Overlap Σ min(p, q) of the histograms of pressure, temperature and speed, the smallest of
        the three; None without samples.
    """
    overlaps = []
    for name in ("pressure_histogram", "temperature_histogram", "speed_histogram"):
        column = history.operation[name]
        here = column[place]
        before = [one for one in column[first : last + 1].to_list() if one is not None]
        if here is None or not before:
            return None
        p = np.array(here, dtype=np.float64)
        q = np.sum(np.array(before, dtype=np.float64), axis=0)
        if not p.sum() or not q.sum():
            return None
        overlaps.append(float(np.minimum(p / p.sum(), q / q.sum()).sum()))
    return min(overlaps)


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """What the zeros at halts say of the sensors up to a night.

    Attributes
    ----------
    status
        ok, drifted or unknown.
    words
        Which sensor, how far; empty where none drifted.
    """

    status: str
    words: str


def sensor_health(spec: MotorSpec, history: History, place: int, first: int) -> SensorHealth:
    """Whether the zero of the pressure or of the flow has moved between two nights.

    Parameters
    ----------
    spec
        The motor; the tolerances of its channels say which move matters.
    history
        Its nights.
    place, first
        Tonight, and the first night that counts: the start of its baseline.
    """
    drifts = [
        _drift(spec, history, place, first, name, unit, channels)
        for name, unit, channels in (
            ("pressure_zero", "bar", PRESSURES),
            ("flow_zero", "l_per_min", ("leakage_flow",)),
        )
    ]
    words = [
        f"the zero of the {what} sensor has moved by {one.change:+.3g} {unit} "
        f"[{one.change_lower:.3g}, {one.change_upper:.3g}]"
        for one, what, unit in zip(drifts, ("pressure", "flow"), ("bar", "l/min"), strict=True)
        if one.status == "drifts"
    ]
    if words:
        return SensorHealth("drifted", "; ".join(words) + ": check it before the motor")
    known = any(one.status == "steady" for one in drifts)
    return SensorHealth("ok" if known else "unknown", "")


PRESSURES = ("pressure_difference", "high_port_pressure", "low_port_pressure")


def _drift(
    spec: MotorSpec,
    history: History,
    place: int,
    first: int,
    name: str,
    unit: str,
    channels: tuple[str, ...],
) -> ZeroDrift:
    numbers = night_numbers(history)[first : place + 1]
    zeros = history.operated(f"{name}_{unit}")[first : place + 1]
    errors = history.operated(f"{name}_standard_error_{unit}")[first : place + 1]
    declared = [spec.file.channels[one] for one in channels if one in spec.file.channels]
    tolerance = float(np.hypot.reduce([one.offset_tolerance for one in declared]))
    resolution = max(one.resolution for one in declared)
    if name == "flow_zero" and spec.file.flushing.mode == "estimated":
        # What is flushed moves with it: nobody can tell which of the two has changed.
        zeros = np.full(len(zeros), np.nan)
    return zero_drift(numbers, zeros, np.nan_to_num(errors), max(tolerance, resolution))

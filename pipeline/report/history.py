"""A motor's course over its nights: leakage, its paths, how much each gap has changed.

All figures come from the tables; gaps are relative to the motor's published baselines.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.report.tables import ReportTables, by_motor
from pipeline.schema import BASELINES, TRENDS, frame

Array = NDArray[np.float64]

REFERENCE = "reference_leakage"
OWN_REFERENCE = "own_reference_leakage"
COMPARABLE = "comparable_drain_flow"
NO_BASELINES = frame(BASELINES, [])
COEFFICIENT_PREFIXES = ("K_", "C_", "scale_")


@dataclass(frozen=True, slots=True)
class Course:
    """A figure over a motor's nights with its 95 % interval; NaN where there is none.

    Attributes
    ----------
    value, lower, upper
        Shape (n,), one a night.
    """

    value: Array
    lower: Array
    upper: Array

    @classmethod
    def empty(cls, n: int) -> Course:
        """No value in any of n nights."""
        return cls(*(np.full(n, np.nan) for _ in range(3)))

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Nights that have a value, shape (n,)."""
        known: NDArray[np.bool_] = np.isfinite(self.value)
        return known


@dataclass(frozen=True, slots=True)
class MotorHistory:
    """All nights of a motor.

    Attributes
    ----------
    motor_id
        The motor.
    fits
        Its primary fits in time order, one row a night, n of them; none for a motor without any.
    nights
        Labels of these nights.
    reference, own
        Leakage at the reference conditions, and at each night's own mean conditions, l/min.
    frozen
        Leakage at the motor's own reference conditions, frozen with its baseline, l/min; none
        where no run has judged trends.
    coefficients
        Coefficient by name where it is identified, in the table's unit.
    paths
        Leakage of each path at the reference conditions by the path's name, l/min.
    baselines
        First night and mean of each baseline by coefficient, in time order.
    """

    motor_id: str
    fits: pl.DataFrame
    nights: tuple[dt.date, ...]
    reference: Course
    own: Course
    frozen: Course
    coefficients: Mapping[str, Course]
    paths: Mapping[str, Course]
    baselines: Mapping[str, Sequence[tuple[dt.date, float]]]

    @property
    def statuses(self) -> list[str]:
        """Outcome of each night."""
        return self.fits["status"].to_list()

    @property
    def leakages(self) -> dict[str, Course]:
        """Leakage by kind of conditions, the most comparable first."""
        return {"reference": self.reference, "frozen": self.frozen, "own": self.own}

    @property
    def leakage_kind(self) -> str:
        """Conditions of the leakage that stands for the motor: the first that is ever known."""
        known = (kind for kind, course in self.leakages.items() if course.is_known.any())
        return next(known, "reference")

    def gap_changes(self) -> dict[str, Course]:
        """(K/K_baseline)^(1/3) − 1 in percent by path, of every K that has a baseline."""
        changes = {}
        for name, course in self.coefficients.items():
            if not name.startswith("K_") or name not in self.baselines:
                continue
            starts, means = zip(*self.baselines[name], strict=True)
            place = np.searchsorted(_stamps(starts), _stamps(self.nights), side="right") - 1
            level = np.array(means)[np.maximum(place, 0)]
            # The lower end of a wide interval may be negative: its gap is then closed.
            parts = (course.value, np.maximum(course.lower, 0.0), course.upper)
            changes[name.removeprefix("K_")] = Course(
                *(100.0 * (np.cbrt(part / level) - 1.0) for part in parts)
            )
        return changes


def motor_histories(history: ReportTables, motors: Sequence[str]) -> Iterator[MotorHistory]:
    """The history of each motor."""
    fits = by_motor(history.fits)
    parameters = by_motor(history.parameters)
    own_leakage = by_motor(_own_reference(history.trends))
    baselines = by_motor(history.trends.get("baselines", NO_BASELINES))
    for motor_id in motors:
        rows = fits.get(motor_id, history.fits.clear())
        stamps = rows["night"].to_numpy().astype("datetime64[D]")
        yield _motor_history(
            motor_id,
            rows,
            {
                part["parameter"][0]: _over(stamps, part)
                for part in parameters.get(motor_id, history.parameters.clear()).partition_by(
                    "parameter", maintain_order=True
                )
            },
            frozen=_placed(stamps, own_leakage[motor_id])
            if motor_id in own_leakage
            else Course.empty(len(stamps)),
            baselines=_baselines(baselines.get(motor_id, NO_BASELINES)),
        )


def _own_reference(trends: Mapping[str, pl.DataFrame]) -> pl.DataFrame:
    """Leakage at the motors' own reference conditions, as the trends have it."""
    rows = trends.get("trends", frame(TRENDS, []))
    columns = ("motor_id", "night", "value", "lower", "upper")
    return rows.filter(indicator=OWN_REFERENCE).select(columns)


def _baselines(rows: pl.DataFrame) -> dict[str, list[tuple[dt.date, float]]]:
    """First night and mean of each baseline by indicator; of those frozen anew the last."""
    last = rows.sort("indicator", "start", "night").unique(
        ["indicator", "start"], keep="last", maintain_order=True
    )
    found: dict[str, list[tuple[dt.date, float]]] = {}
    for indicator, start, mean in last.select("indicator", "start", "mean").drop_nulls().rows():
        found.setdefault(indicator, []).append((start, mean))
    return found


def _motor_history(
    motor_id: str,
    fits: pl.DataFrame,
    courses: Mapping[str, Course],
    *,
    frozen: Course,
    baselines: Mapping[str, Sequence[tuple[dt.date, float]]],
) -> MotorHistory:
    nights = fits["night"].to_list()
    reference = _leakage(fits, REFERENCE)
    coefficients = {
        name: course
        for name, course in courses.items()
        if name.startswith(COEFFICIENT_PREFIXES) and np.isfinite(course.lower).any()
    }
    return MotorHistory(
        motor_id=motor_id,
        fits=fits,
        nights=tuple(nights),
        reference=reference,
        own=_leakage(fits, "own_conditions_leakage"),
        frozen=frozen,
        coefficients=coefficients,
        paths=_path_leakage(reference, courses),
        baselines=baselines,
    )


def _stamps(nights: Sequence[dt.date]) -> NDArray[np.datetime64]:
    return np.array(nights, dtype="datetime64[D]")


def _leakage(fits: pl.DataFrame, name: str) -> Course:
    columns = (f"{name}_l_per_min", f"{name}_lower", f"{name}_upper")
    return Course(*(fits[column].cast(pl.Float64).to_numpy() for column in columns))


def _over(stamps: NDArray[np.datetime64], rows: pl.DataFrame) -> Course:
    """A parameter over the nights, in those in which the data determine it."""
    return _placed(
        stamps, rows.filter(pl.col("verdict").is_in(["identified", "uncertain", "fixed"]))
    )


def _placed(stamps: NDArray[np.datetime64], rows: pl.DataFrame) -> Course:
    """Figures of some nights among all nights of the motor."""
    course = Course.empty(len(stamps))
    labels = rows["night"].to_numpy().astype("datetime64[D]")
    is_there = np.isin(labels, stamps)
    place = np.searchsorted(stamps, labels[is_there])
    for name in ("value", "lower", "upper"):
        getattr(course, name)[place] = rows[name].to_numpy()[is_there]
    return course


def _path_leakage(reference: Course, courses: Mapping[str, Course]) -> dict[str, Course]:
    """Leakage by path: its share of the reference leakage, with the interval of its coefficient.

    A path's leakage is its coefficient times a factor that the conditions fix, so that both have
    one relative interval; a path whose coefficient is held fixed has none.
    """
    paths = {}
    for name, share in courses.items():
        if not name.startswith("share_") or not share.is_known.any():
            continue
        path = name.removeprefix("share_")
        flow = share.value * reference.value
        coefficient = next(
            (
                courses[f"{kind}{path}"]
                for kind in COEFFICIENT_PREFIXES
                if f"{kind}{path}" in courses
            ),
            Course.empty(len(flow)),
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            each = flow / coefficient.value
        paths[path] = Course(flow, coefficient.lower * each, coefficient.upper * each)
    return paths

"""A motor's course over its nights: leakage, its paths, how much each gap has changed.

All figures come from the tables. Changes are relative to the motor's baseline or its own first good
nights, anew after each event that starts a new baseline.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.report.tables import History
from pipeline.schema import BASELINES, TRENDS, frame

Array = NDArray[np.float64]

# Good nights whose median a change is taken from, at the beginning and at the end; as in the
# README's query.
FIRST_NIGHTS = LAST_NIGHTS = 10
# A change is told where it is this many times its own standard error.
CLEAR = 3.0
# Scaled median absolute deviation, and the standard error of a median, both of a normal sample.
NORMAL_MAD, NORMAL_MEDIAN = 1.4826, 1.2533
OWN_REFERENCE = "own_reference_leakage"
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

    def scaled(self, factor: Array) -> Course:
        """Each night's figure times a factor of that night, shape (n,)."""
        return Course(self.value * factor, self.lower * factor, self.upper * factor)

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Nights that have a value, shape (n,)."""
        known: NDArray[np.bool_] = np.isfinite(self.value)
        return known


@dataclass(frozen=True, slots=True)
class Change:
    """How much a figure has changed since the first good nights.

    Attributes
    ----------
    ratio
        Median of the last good nights over that of the first.
    is_clear
        Whether the logarithm of the ratio is more than thrice its standard error, by the scatter
        of both groups of nights.
    """

    ratio: float
    is_clear: bool

    @property
    def percent(self) -> float:
        """The change in percent."""
        return 100.0 * (self.ratio - 1.0)

    @property
    def gap_percent(self) -> float:
        """The change of a gap height in percent, if the figure is its loss factor K ∝ h³."""
        return 100.0 * (float(np.cbrt(self.ratio)) - 1.0)


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
    epoch
        Number of the baseline that each night belongs to, shape (n,); an event begins a new one.
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
    epoch: NDArray[np.int64]
    reference: Course
    own: Course
    frozen: Course
    coefficients: Mapping[str, Course]
    paths: Mapping[str, Course]
    baselines: Mapping[str, Sequence[tuple[dt.date, float]]]

    @property
    def statuses(self) -> list[str]:
        """What came of each night."""
        return self.fits["status"].to_list()

    @property
    def leakage(self) -> tuple[str, Course]:
        """The leakage that stands for the motor: at the reference conditions, if ever known."""
        courses = {"reference": self.reference, "frozen": self.frozen, "own": self.own}
        known = [name for name, course in courses.items() if course.is_known.any()]
        name = known[0] if known else "reference"
        return name, courses[name]

    def change(self, course: Course) -> Change | None:
        """Change since the first good nights of the newest epoch; None: too few nights."""
        newest = self.epoch == self.epoch[-1] if len(self.epoch) else np.zeros(0, dtype=bool)
        values = course.value[newest & course.is_known & (course.value > 0)]
        if len(values) < FIRST_NIGHTS + LAST_NIGHTS:
            return None
        first, last = np.log(values[:FIRST_NIGHTS]), np.log(values[-LAST_NIGHTS:])
        size = float(np.median(last) - np.median(first))
        error = float(np.hypot(_error_of_median(first), _error_of_median(last)))
        return Change(float(np.exp(size)), abs(size) > CLEAR * error)

    def relative_to_baseline(self, name: str) -> Course:
        """A coefficient over its baseline's mean, or else its first good nights' median."""
        course = self.coefficients[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            return course.scaled(1.0 / self._baseline_by_night(name, course))

    def _baseline_by_night(self, name: str, course: Course) -> Array:
        """What a night's coefficient is compared with, shape (n,)."""
        level = np.full(len(self.nights), np.nan)
        if self.baselines.get(name):
            starts, means = zip(*self.baselines[name], strict=True)
            place = np.searchsorted(_stamps(starts), _stamps(self.nights), side="right") - 1
            level[:] = np.array(means)[np.maximum(place, 0)]
            return level
        for number in np.unique(self.epoch):
            own = self.epoch == number
            first = course.value[own & course.is_known][:FIRST_NIGHTS]
            if len(first):
                level[own] = np.median(first)
        return level

    def gap_changes(self) -> dict[str, Course]:
        """(K/K_baseline)^(1/3) − 1 in percent by path, of every K that is ever identified."""
        changes = {}
        for name in self.coefficients:
            if not name.startswith("K_"):
                continue
            ratio = self.relative_to_baseline(name)
            # The lower end of a wide interval may be negative: its gap is then closed.
            parts = (ratio.value, np.maximum(ratio.lower, 0.0), ratio.upper)
            changes[name.removeprefix("K_")] = Course(
                *(100.0 * (np.cbrt(part) - 1.0) for part in parts)
            )
        return changes


def _error_of_median(values: Array) -> float:
    spread = NORMAL_MAD * float(np.median(np.abs(values - np.median(values))))
    return NORMAL_MEDIAN * spread / float(np.sqrt(len(values)))


def motor_histories(
    history: History, motors: Sequence[str], events: Mapping[str, Sequence[dt.date]]
) -> Iterator[MotorHistory]:
    """The history of each motor."""
    fits = _by_motor(history.fits)
    parameters = _by_motor(history.parameters)
    own_leakage = _by_motor(_own_reference(history.trends))
    baselines = _by_motor(history.trends.get("baselines", NO_BASELINES))
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
            events=events.get(motor_id, ()),
        )


def _by_motor(rows: pl.DataFrame) -> dict[str, pl.DataFrame]:
    return {part["motor_id"][0]: part for part in rows.partition_by("motor_id")}


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
    events: Sequence[dt.date],
) -> MotorHistory:
    nights = fits["night"].to_list()
    reference = _leakage(fits, "reference_leakage")
    coefficients = {
        name: course
        for name, course in courses.items()
        if name.startswith(COEFFICIENT_PREFIXES) and np.isfinite(course.lower).any()
    }
    begins = _stamps(sorted(events))
    return MotorHistory(
        motor_id=motor_id,
        fits=fits,
        nights=tuple(nights),
        epoch=np.searchsorted(begins, _stamps(nights), side="right").astype(np.int64),
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
    return _placed(stamps, rows.filter(pl.col("verdict").is_in(["identified", "fixed"])))


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

"""A motor's course over its nights, from its fits and its trends."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.report.tables import ReportTables, by_motor
from pipeline.schema import TRENDS, frame

REFERENCE = "reference_leakage"
OWN_REFERENCE = "own_reference_leakage"
COMPARABLE = "comparable_drain_flow"
FLOW = "drain_flow"
NO_TRENDS = frame(TRENDS, [])


@dataclass(frozen=True, slots=True)
class Course:
    """A figure over a motor's nights with its 95 % interval; NaN where there is none."""

    # value, lower, upper: shape (n,), one a night.
    value: Array
    lower: Array
    upper: Array

    @classmethod
    def without_interval(cls, value: Array) -> Course:
        """A figure that has no interval in any night."""
        nothing = np.full(len(value), np.nan)
        return cls(value, nothing, nothing)

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Nights that have a value, shape (n,)."""
        known: NDArray[np.bool_] = np.isfinite(self.value)
        return known


@dataclass(frozen=True)
class MotorHistory:
    """All nights of a motor."""

    motor_id: str
    # Its primary fits in time order, one row a night, n of them; none for a motor without any.
    fits: pl.DataFrame
    nights: tuple[dt.date, ...]  # labels of these nights
    # Its rows of `trends` by indicator, in time order; empty where no run has judged trends.
    trends: Mapping[str, pl.DataFrame]

    @property
    def statuses(self) -> list[str]:
        """Outcome of each night."""
        return self.fits["status"].to_list()

    @cached_property
    def leakages(self) -> dict[str, Course]:
        """Leakage by kind of conditions, the most comparable first; the bare drain flow last."""
        judged = self.course(REFERENCE)
        return {
            "reference": judged if judged.is_known.any() else self._fitted(REFERENCE),
            "frozen": self.course(OWN_REFERENCE),
            "comparable": self.course(COMPARABLE),
            "own": self._fitted("own_conditions_leakage"),
            "flow": self.flow,
        }

    @property
    def leakage_kind(self) -> str:
        """Conditions of the leakage that stands for the motor: the first that is ever known."""
        known = (kind for kind, course in self.leakages.items() if course.is_known.any())
        return next(known, "reference")

    @cached_property
    def flow(self) -> Course:
        """Mean drain flow of each night, not fitted, l/min."""
        flow = self.course(FLOW).value
        measured = self.fits["mean_flow_l_per_min"].cast(pl.Float64).to_numpy()
        return Course.without_interval(np.where(np.isfinite(flow), flow, measured))

    def course(self, indicator: str) -> Course:
        """Figures of an indicator in the nights that count."""
        rows = self.trends.get(indicator, NO_TRENDS).filter(pl.col("gated_reason").is_null())
        return Course(*(self._placed(rows, name) for name in ("value", "lower", "upper")))

    def column(self, indicator: str, name: str) -> Array:
        """A column of an indicator's rows, shape (n,)."""
        return self._placed(self.trends.get(indicator, NO_TRENDS), name)

    def baseline(self, indicator: str) -> float | None:
        """Mean of an indicator's newest baseline; None without one."""
        means = self.trends.get(indicator, NO_TRENDS)["baseline_mean"].drop_nulls()
        return float(means[-1]) if len(means) else None

    def _placed(self, rows: pl.DataFrame, name: str) -> Array:
        """Figures of some nights among all nights of the motor."""
        figures = np.full(len(self.nights), np.nan)
        stamps = np.array(self.nights, dtype="datetime64[D]")
        labels = rows["night"].to_numpy().astype("datetime64[D]")
        is_there = np.isin(labels, stamps)
        place = np.searchsorted(stamps, labels[is_there])
        figures[place] = rows[name].cast(pl.Float64).to_numpy()[is_there]
        return figures

    def _fitted(self, name: str) -> Course:
        columns = (f"{name}_l_per_min", f"{name}_lower", f"{name}_upper")
        return Course(*(self.fits[column].cast(pl.Float64).to_numpy() for column in columns))


def motor_histories(history: ReportTables, motors: Sequence[str]) -> Iterator[MotorHistory]:
    """The history of each motor."""
    fits = by_motor(history.fits)
    trends = by_motor(history.rows(TRENDS))
    for motor_id in motors:
        own = fits.get(motor_id, history.fits.clear())
        judged = trends.get(motor_id, NO_TRENDS).sort("indicator", "night")
        yield MotorHistory(
            motor_id,
            own,
            tuple(own["night"].to_list()),
            {
                part["indicator"][0]: part
                for part in judged.partition_by("indicator", maintain_order=True)
            },
        )

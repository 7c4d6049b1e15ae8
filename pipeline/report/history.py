"""A motor's course over its nights: the watch's figures, and those of each night's own fit."""

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
from pipeline.schema import BASELINES, TRENDS, WATCH, frame
from pipeline.trends.nights.decisions import LEAKAGE

NO_TRENDS, NO_WATCH, NO_BASELINE = (frame(one, []) for one in (TRENDS, WATCH, BASELINES))


@dataclass(frozen=True, slots=True)
class Course:
    """A figure over a motor's nights with its 95 % interval; NaN where there is none."""

    # value, lower, upper: shape (n,), one a night.
    value: Array
    lower: Array
    upper: Array

    def __getitem__(self, places: NDArray[np.int64]) -> Course:
        return Course(self.value[places], self.lower[places], self.upper[places])

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
    watch: pl.DataFrame  # its rows of `watch` in time order
    # Its rows of `trends` by indicator, in time order; empty where no run has made trends.
    trends: Mapping[str, pl.DataFrame]
    baselines: pl.DataFrame  # its rows of `baselines` of the leakage, in time order

    @property
    def statuses(self) -> list[str]:
        """Outcome of each night."""
        return self.fits["status"].to_list()

    @cached_property
    def leakage(self) -> Course:
        """Leakage at the motor's own conditions by the watch, l/min."""
        stem = "own_leakage"
        return Course(*(self.watched(f"{stem}_{end}") for end in ("l_per_min", "lower", "upper")))

    @cached_property
    def level(self) -> Array:
        """The same of each night's baseline, l/min, shape (n,); NaN before there is one."""
        level = np.full(len(self.nights), np.nan)
        for start, mean in self.baselines.select("start", "mean").drop_nulls().iter_rows():
            level[self.stamps >= np.datetime64(start)] = mean
        return level

    @cached_property
    def stamps(self) -> NDArray[np.datetime64]:
        """Its nights, shape (n,)."""
        return np.array(self.nights, dtype="datetime64[D]")

    def fitted(self, name: str) -> Array:
        """A column of `fits`, shape (n,); NaN where a night has none."""
        return self.fits[name].cast(pl.Float64).to_numpy()

    def watched(self, name: str) -> Array:
        """A column of `watch`, shape (n,); NaN in nights without a row."""
        return self._placed(self.watch, name)

    def course(self, indicator: str) -> Course:
        """Figures of a night's own indicator in the nights that count."""
        rows = self.trends.get(indicator, NO_TRENDS)
        rows = rows.filter(pl.col("gated_reason").is_null())
        return Course(*(self._placed(rows, name) for name in ("value", "lower", "upper")))

    def _placed(self, rows: pl.DataFrame, name: str) -> Array:
        """Figures of some nights among all nights of the motor."""
        figures = np.full(len(self.nights), np.nan)
        labels = rows["night"].to_numpy().astype("datetime64[D]")
        is_there = np.isin(labels, self.stamps)
        place = np.searchsorted(self.stamps, labels[is_there])
        figures[place] = rows[name].cast(pl.Float64).to_numpy()[is_there]
        return figures


def motor_histories(history: ReportTables, motors: Sequence[str]) -> Iterator[MotorHistory]:
    """The history of each motor."""
    fits = by_motor(history.fits)
    watches, trends, baselines = (
        by_motor(history.rows(table)) for table in (WATCH, TRENDS, BASELINES)
    )
    for motor_id in motors:
        own = fits.get(motor_id, history.fits.clear())
        shown = trends.get(motor_id, NO_TRENDS).sort("indicator", "night")
        parts = shown.partition_by("indicator", maintain_order=True)
        yield MotorHistory(
            motor_id,
            own,
            tuple(own["night"].to_list()),
            watches.get(motor_id, NO_WATCH).sort("night"),
            {part["indicator"][0]: part for part in parts},
            baselines.get(motor_id, NO_BASELINE).filter(indicator=LEAKAGE).sort("night"),
        )

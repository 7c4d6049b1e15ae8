"""A motor over its nights, from the published tables."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.schema import BASELINES, FITS, TRENDS, WATCH, Table, frame
from pipeline.store.tables import read_rows
from pipeline.trends.nights.decisions import LEAKAGE


def finite_rows(
    output: Path,
    table: Table,
    motor_ids: Sequence[str],
    nights: Collection[dt.date] | None = None,
) -> pl.DataFrame:
    """Rows of a table, NaN and infinity as null: no page can show them, and JSON has none.

    Raises StoreError if a file is damaged, or of a newer version of the program.
    """
    rows = read_rows(output, table, motor_ids, nights=nights)
    floats = [name for name, kind in rows.schema.items() if kind == pl.Float64]
    return rows.with_columns(
        pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name)
        for name in floats
        if not rows[name].is_finite().all()
    )


# A figure over a motor's nights and the ends of its interval, shape (n,) each; NaN: none.
Course = tuple[Array, Array, Array]


@dataclass(frozen=True)
class MotorHistory:
    """All nights of a motor."""

    motor_id: str
    fits: pl.DataFrame  # its primary fits in time order, one row a night, n of them
    watch: pl.DataFrame  # its rows of `watch` in time order
    # Its rows of `trends` by indicator, in time order; empty where no run has made trends.
    trends: Mapping[str, pl.DataFrame]
    baselines: pl.DataFrame  # its rows of `baselines` of the leakage, in time order

    @cached_property
    def nights(self) -> list[dt.date]:
        """Labels of its nights."""
        return self.fits["night"].to_list()

    @cached_property
    def stamps(self) -> NDArray[np.datetime64]:
        """The same, shape (n,)."""
        return np.array(self.nights, dtype="datetime64[D]")

    @cached_property
    def leakage(self) -> Course:
        """Leakage at the motor's own conditions by the watch, l/min."""
        value = self.watched("own_leakage_l_per_min")
        return value, self.watched("own_leakage_lower"), self.watched("own_leakage_upper")

    @cached_property
    def level(self) -> Array:
        """The same of each night's baseline, l/min, shape (n,); NaN before there is one."""
        level = np.full(len(self.nights), np.nan)
        for start, mean in self.baselines.select("start", "mean").drop_nulls().iter_rows():
            level[self.stamps >= np.datetime64(start)] = mean
        return level

    @cached_property
    def mean_flow(self) -> Array:
        """Drain flow as measured, l/min, shape (n,); NaN where a night has none."""
        return self.fits["mean_flow_l_per_min"].to_numpy()

    def watched(self, name: str) -> Array:
        """A column of `watch`, shape (n,); NaN in nights without a row."""
        return self._placed(self.watch, name)

    def course(self, indicator: str) -> Course:
        """An indicator of the nights that count."""
        rows = self.trends[indicator].filter(pl.col("gated_reason").is_null())
        return self._placed(rows, "value"), self._placed(rows, "lower"), self._placed(rows, "upper")

    def _placed(self, rows: pl.DataFrame, name: str) -> Array:
        """Figures of some nights among all nights of the motor."""
        nights = self.fits.select("night")
        found = nights.join(
            rows.select("night", name), on="night", how="left", maintain_order="left"
        )
        return found[name].cast(pl.Float64).to_numpy()


def motor_histories(output: Path, motor_ids: Sequence[str]) -> list[MotorHistory]:
    """The history of each motor."""
    read = [
        (table, by_motor(finite_rows(output, table, motor_ids).sort("night")))
        for table in (FITS, WATCH, TRENDS, BASELINES)
    ]
    histories = []
    for motor_id in motor_ids:
        own = [found.get(motor_id, frame(table, [])) for table, found in read]
        fits, watch, trends, baselines = own
        parts = trends.partition_by("indicator", maintain_order=True)
        histories.append(
            MotorHistory(
                motor_id,
                fits.filter("is_primary"),
                watch,
                {part["indicator"][0]: part for part in parts},
                baselines.filter(indicator=LEAKAGE),
            )
        )
    return histories


def by_motor(rows: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Rows of a table by motor, in their order."""
    return {part["motor_id"][0]: part for part in rows.partition_by("motor_id")}

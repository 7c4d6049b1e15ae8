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
from pipeline.config import Fleet, MotorSpec
from pipeline.schema import NIGHTS, TRENDS, Table, frame
from pipeline.store.tables import read_rows
from pipeline.trends.motor_states import MotorState


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


RECENT_NIGHTS = 30


@dataclass(frozen=True)
class MotorHistory:
    """A motor: its state, and all its nights."""

    state: MotorState  # as `motor-leakage status` prints it
    spec: MotorSpec | None  # None of a motor that the config has no more
    reference: tuple[float, float, float]  # reference conditions: bar, °C, rpm
    rows: pl.DataFrame  # its rows of `nights` in time order, n of them
    # Its rows of `trends` by indicator, in time order; empty where no run has made trends.
    trends: Mapping[str, pl.DataFrame]

    @property
    def motor_id(self) -> str:
        """The motor."""
        return self.state.motor_id

    @property
    def motor_type(self) -> str:
        """Its type."""
        return self.spec.file.motor_type if self.spec else str(self.state.row["motor_type"] or "")

    @property
    def newest_data(self) -> dt.datetime | None:
        """End of the newest data that were kept, UTC; None without any."""
        newest = self.rows["last_sample"].max()
        assert newest is None or isinstance(newest, dt.datetime)
        return newest

    @property
    def recent(self) -> list[str]:
        """Statuses of its newest 30 nights, of those that have a row."""
        if not self.nights:
            return []
        first = self.nights[-1] - dt.timedelta(days=RECENT_NIGHTS)
        return self.rows.filter(self.rows["night"] > first)["status"].to_list()

    @cached_property
    def nights(self) -> list[dt.date]:
        """Labels of its nights."""
        return self.rows["night"].to_list()

    @cached_property
    def stamps(self) -> NDArray[np.datetime64]:
        """The same, shape (n,)."""
        return np.array(self.nights, dtype="datetime64[D]")

    @property
    def baseline_leakage(self) -> float | None:
        """Leakage of the newest baseline at the motor's own conditions, l/min; None without any."""
        if (known := self.trends.get("own_leakage")) is None:
            return None
        means = self.rows.join(known.select("night", "baseline_mean"), on="night").sort("night")
        first = means.drop_nulls(("baseline_start", "baseline_mean")).unique(
            "baseline_start", keep="first", maintain_order=True
        )
        return first["baseline_mean"][-1] if first.height else None

    @cached_property
    def baselines(self) -> list[tuple[dt.date, dt.date]]:
        """First and last night of each baseline."""
        ends = self.rows.select("baseline_start", "baseline_end").drop_nulls()
        return list(ends.unique(maintain_order=True).iter_rows())

    def figure(self, name: str) -> Array:
        """A figure of `nights`, shape (n,); NaN in nights without it."""
        return self.rows[name].cast(pl.Float64).to_numpy()

    def course(self, indicator: str) -> tuple[Array, Array, Array]:
        """An indicator of the nights that count, and the ends of its interval, shape (n,) each."""
        rows = self.trends[indicator].filter(pl.col("reason").is_null())
        trend = self.rows.select("night").join(rows, on="night", how="left", maintain_order="left")
        value, lower, upper = (
            trend[name].cast(pl.Float64).to_numpy() for name in ("value", "lower", "upper")
        )
        return value, lower, upper


def motor_histories(fleet: Fleet, states: Sequence[MotorState]) -> list[MotorHistory]:
    """The history of each motor."""
    motor_ids = [state.motor_id for state in states]
    nights, trends = (
        by_motor(finite_rows(fleet.output, table, motor_ids).sort("night"))
        for table in (NIGHTS, TRENDS)
    )
    specs = {spec.motor_id: spec for spec in fleet.motors}
    histories = []
    for state in states:
        name, spec = state.motor_id, specs.get(state.motor_id)
        at = spec.settings.reference if spec else fleet.settings.reference
        own = trends.get(name, frame(TRENDS, [])).partition_by("indicator", maintain_order=True)
        histories.append(
            MotorHistory(
                state,
                spec,
                (at.pressure_bar, at.temperature_c, at.speed_rpm),
                nights.get(name, frame(NIGHTS, [])),
                {part["indicator"][0]: part for part in own},
            )
        )
    return histories


def by_motor(rows: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Rows of a table by motor, in their order."""
    return {part["motor_id"][0]: part for part in rows.partition_by("motor_id")}

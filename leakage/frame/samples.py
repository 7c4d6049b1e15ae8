"""Samples of a motor from a frame with named columns, or from arrays by name."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import narwhals as nw
import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.errors import LeakageError, ShapeError, StatisticsError
from leakage.estimation.blocks import ROUNDING, SECOND_US, Stretch
from leakage.physics.conditions import OperatingConditions

Columns: TypeAlias = Mapping[str, Array]
Period: TypeAlias = tuple[Any, Any]

TIME = "time"
INPUTS = ("pressure_bar", "oil_temperature_c", "speed_rpm")
FLOW = "leakage_l_per_min"
CHARGE = "charge_over_case_bar"
# Quantity and unit of each column: the quantity in front tells a column of another unit.
QUANTITIES = {
    "pressure_bar": ("pressure", "bar"),
    "oil_temperature_c": ("oil_temperature", "°C"),
    "speed_rpm": ("speed", "rpm"),
    FLOW: ("leakage", "l/min"),
}


@dataclass(frozen=True, slots=True, eq=False)
class FrameSamples:
    """Complete samples of a motor in time order, n of them."""

    # Since 1970 in UTC, or since where the seconds of the frame count from, [µs].
    time_us: NDArray[np.int64]
    on_clock: bool  # the times are dates
    # pressure_bar, speed_rpm: without their sign.
    pressure_bar: Array
    oil_temperature_c: Array
    speed_rpm: Array
    flow_l_per_min: Array | None  # measured drain flow; None where it is not needed
    charge_over_case_bar: Array | None  # charge above case pressure; None: one-sided leakage
    complete: Mask  # rows of the frame that are complete, shape (rows,)

    @property
    def conditions(self) -> OperatingConditions:
        """The conditions that drive the leakage."""
        return OperatingConditions.from_bar(
            self.pressure_bar, self.oil_temperature_c, self.speed_rpm, self.charge_over_case_bar
        )

    @property
    def inputs(self) -> dict[str, Array]:
        """Inputs of the residual tests by name."""
        return {
            "pressure_difference": self.pressure_bar,
            "oil_temperature": self.oil_temperature_c,
            "speed": self.speed_rpm,
        }

    @property
    def measured_l_per_min(self) -> Array:
        """Measured drain flow, shape (n,), of samples that were read with it."""
        assert self.flow_l_per_min is not None
        return self.flow_l_per_min

    @property
    def rounding_l_per_min(self) -> float:
        """Errors below this are rounding."""
        return ROUNDING * float(np.abs(self.measured_l_per_min).max())

    @property
    def period_us(self) -> int:
        """Median time between samples [µs]."""
        return max(int(np.median(np.diff(self.time_us))), 1) if len(self.time_us) > 1 else SECOND_US

    @property
    def index(self) -> NDArray[np.int64]:
        """Place of each sample on an even time base, increasing, shape (n,)."""
        period_us = self.period_us
        place = (self.time_us - self.time_us[0] + period_us // 2) // period_us
        # Two samples that are closer than half a period still are two.
        later = np.arange(len(place))
        index: NDArray[np.int64] = np.maximum.accumulate(place - later) + later
        return index

    def only(self, chosen: Mask) -> FrameSamples:
        """Return the chosen ones of these samples."""
        complete = self.complete.copy()
        complete[complete] = chosen
        flow, charge = self.flow_l_per_min, self.charge_over_case_bar
        return replace(
            self,
            time_us=self.time_us[chosen],
            pressure_bar=self.pressure_bar[chosen],
            oil_temperature_c=self.oil_temperature_c[chosen],
            speed_rpm=self.speed_rpm[chosen],
            flow_l_per_min=None if flow is None else flow[chosen],
            charge_over_case_bar=None if charge is None else charge[chosen],
            complete=complete,
        )

    def stretches(self, periods: Period | Sequence[Period] | None) -> tuple[Stretch, ...]:
        """Return periods as a user writes them, in the times of these samples."""
        if periods is None:
            return ()
        pair = len(periods) == 2 and not isinstance(periods[0], tuple | list)
        stretches = []
        for begin, end in [periods] if pair else periods:
            stretch = (self._moment(begin), self._moment(end))
            if not stretch[0] < stretch[1]:
                raise LeakageError("period", f"the period {begin} to {end} ends before it begins")
            stretches.append(stretch)
        return tuple(sorted(stretches))

    def _moment(self, value: Any) -> int:
        if isinstance(value, int | float | np.number):
            if self.on_clock:
                raise LeakageError("period", f"{value}: this frame's times are dates, not seconds")
            return round(float(value) * SECOND_US)
        if not self.on_clock:
            raise LeakageError("period", f"{value}: this frame's times are seconds, not dates")
        try:
            moment = dt.datetime.fromisoformat(str(value))
        except ValueError as error:
            raise LeakageError("period", f"{value!r} is no date: write 2026-03-01T22:00") from error
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=dt.UTC)
        return (moment - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)) // dt.timedelta(microseconds=1)


def read_samples(
    frame: Any, columns: Mapping[str, str] | None = None, *, with_flow: bool = True
) -> FrameSamples:
    """Return the complete samples of a frame; its columns and errors are those of `fit_frame`."""
    table = FrameTable(frame, columns or {})
    time_us, on_clock = table.times()
    values = {name: table.numbers(name) for name in (*INPUTS, FLOW)[: 3 + with_flow]}
    if table.has(CHARGE):
        values[CHARGE] = table.numbers(CHARGE)
    complete = np.logical_and.reduce([np.isfinite(value) for value in values.values()])
    if not complete.any():
        empty = [name for name, value in values.items() if not np.isfinite(value).any()]
        of = f"{', '.join(empty)} has no values" if empty else "each lacks a value"
        raise StatisticsError("no_samples", f"no row of {len(complete)} is complete: {of}")
    falls = np.flatnonzero(np.diff(time_us) <= 0)
    if len(falls):
        row = int(falls[0]) + 1
        what = "repeats" if time_us[row] == time_us[row - 1] else "falls"
        raise StatisticsError(
            "time_order",
            f"time {what} at row {row} ({len(falls)} such rows): sort the frame by time and keep"
            " a row of each, or let pipeline.notebook.prepare do it",
        )
    made = FrameSamples(
        time_us,
        on_clock,
        np.abs(values["pressure_bar"]),
        values["oil_temperature_c"],
        np.abs(values["speed_rpm"]),
        values.get(FLOW),
        values.get(CHARGE),
        np.ones(len(complete), dtype=np.bool_),
    )
    return made if complete.all() else made.only(complete)


class FrameTable:
    """Columns of a frame, or arrays by name."""

    def __init__(self, frame: Any, names: Mapping[str, str]) -> None:
        self._names = names
        self._columns = _open(frame)
        self._known = list(self._columns.columns)
        # Dates may be the index of a frame of pandas.
        index = nw.maybe_get_index(self._columns)
        self._index: Any = None
        if index is not None and index.dtype.kind == "M":
            self._index = nw.from_native(index.to_series(), series_only=True)

    def has(self, name: str) -> bool:
        return self._names.get(name, name) in self._known

    def _column(self, name: str) -> Any:
        if self.has(name):
            return self._columns[self._names.get(name, name)]
        known = ", ".join(map(str, self._known))
        stem, unit = QUANTITIES.get(name, ("", ""))
        other = [name for name in self._known if str(name).startswith(stem)]
        if stem and other:
            raise ShapeError(
                "column_unit",
                f"column {other[0]} is not in {unit} by its name: convert it and call it"
                f' {name}, or, if it is, say columns={{"{name}": "{other[0]}"}}',
            )
        raise ShapeError(
            "column_missing",
            f'no column {name}; there are {known}: rename it, or say columns={{"{name}": ...}}',
        )

    def numbers(self, name: str) -> Array:
        column = self._column(name)
        try:
            values: Array = column.cast(nw.Float64).to_numpy()
        except Exception as error:  # each backend has errors of its own
            raise ShapeError("column_type", f"column {name} holds no numbers: {error}") from error
        return values

    def times(self) -> tuple[NDArray[np.int64], bool]:
        """Return microseconds, and whether they are dates."""
        column = self._column(TIME) if self.has(TIME) or self._index is None else self._index
        if isinstance(column.dtype, nw.String):
            try:
                column = column.str.to_datetime()
            except Exception as error:  # each backend has errors of its own
                raise ShapeError("column_type", f"column time holds no times: {error}") from error
        on_clock = isinstance(column.dtype, nw.Datetime)
        if on_clock:
            column = column.dt.timestamp("us")
        time_us = column.to_numpy() if on_clock else SECOND_US * self.numbers(TIME)
        if column.null_count() or not np.isfinite(time_us).all():
            raise StatisticsError("time_missing", "a row has no time: drop such rows")
        return np.round(time_us).astype(np.int64), on_clock


def _open(frame: Any) -> nw.DataFrame[Any]:
    """Return a frame of any kind, or arrays by name, as narwhals' frame."""
    try:
        if isinstance(frame, Mapping):
            return nw.from_dict(frame, backend="polars")
        table = nw.from_native(frame)
    except TypeError as error:
        raise ShapeError(
            "frame_type", f"{type(frame).__name__} is no frame and no mapping of arrays"
        ) from error
    except Exception as error:  # of Polars
        raise ShapeError("shape", f"these are no columns of one frame: {error}") from error
    return table.collect() if isinstance(table, nw.LazyFrame) else table

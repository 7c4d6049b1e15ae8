"""Parquet in the types and layouts of many makes, by PyArrow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.ingest.conformance import Cell
from tests.dialects.dialect import Table
from tests.dialects.recorded import Recorded, Times, Values


def plain(values: Values) -> pa.Array:
    """Float64, null where there is no reading."""
    return pa.array(values, from_pandas=True)


def singles(values: Values) -> pa.Array:
    """Float32."""
    return pa.array(values.astype(np.float32), from_pandas=True)


def decimals(digits: int) -> Callable[[Values], pa.Array]:
    """Decimals with so many digits behind the point."""

    def convert(values: Values) -> pa.Array:
        step = Decimal(1).scaleb(-digits)
        cells = [
            Decimal(repr(value)).quantize(step) if np.isfinite(value) else None
            for value in values.tolist()
        ]
        return pa.array(cells, pa.decimal128(38, digits))

    return convert


def counts(scale: float) -> Callable[[Values], pa.Array]:
    """Whole numbers of a step."""

    def convert(values: Values) -> pa.Array:
        known = np.isfinite(values)
        whole = np.rint(np.where(known, values, 0.0) / scale).astype(np.int64)
        return pa.array(whole, mask=~known)

    return convert


@dataclass(frozen=True)
class Parquet(Table):
    """Columns."""

    numbers: Callable[[Values], pa.Array] = plain  # type of the readings
    scale: float = 1.0  # what a written number is times to be the reading
    finite: bool = False  # they are all finite, as the type can hold no others
    # time_unit, zone: of a time stamp; None: it has no zone and is on the logger's wall clock.
    time_unit: str = "us"
    zone: str | None = "UTC"
    within: tuple[str, ...] = ()  # names of columns around those of the readings
    dictionary: bool = False  # names of channels are in a dictionary
    options: Mapping[str, Any] = field(default_factory=dict)  # of `pyarrow.parquet.write_table`

    format: ClassVar[str] = "parquet"

    def source(self, channel: str) -> dict[str, Any]:
        keys = super().source(channel)
        if self.layout == "wide":
            keys["source"] = ".".join([*self.within, keys["source"]])
        return keys | ({"scale": self.scale} if self.scale != 1.0 else {})

    def holds(self, log: Recorded) -> bool:
        infinite = any(np.isinf(value).any() for value in log.values.values())
        return super().holds(log) and not (self.finite and infinite)

    @property
    def suffix(self) -> str:
        return ".parquet"

    def cells(self, values: Values) -> pa.Array:
        return self.numbers(values)

    def table(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[Cell]]) -> None:
        cells = {name: pa.array(list(own), pa.float64()) for name, own in columns.items()}
        self.file(path, time_us, cells)

    def _stamps(self, time_us: Times) -> pa.Array:
        form = self.logs.get("time_format")
        if form == "excel_days":
            return pa.array([self.excel_days(time) for time in time_us.tolist()], pa.float64())
        if form is not None:
            unit = form.removeprefix("epoch_")
            return self._in_unit(time_us, unit)
        local = time_us if self.zone else self.wall_clock_us(time_us)
        return self._in_unit(local, self.time_unit).cast(pa.timestamp(self.time_unit, self.zone))

    @staticmethod
    def _in_unit(time_us: Times, unit: str) -> pa.Array:
        if unit == "ns":
            return pa.array(time_us * 1000)
        per_unit = {"s": 1_000_000, "ms": 1_000, "us": 1}[unit]
        if (time_us % per_unit).any():
            return pa.array(time_us / per_unit)
        return pa.array(time_us // per_unit)

    def file(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[Any]]) -> Path:
        name = self.key("channel_column", "channel")
        if self.dictionary and name in columns:
            columns = {**columns, name: pa.array(columns[name], pa.string()).dictionary_encode()}
        for around in reversed(self.within):
            inner = pa.StructArray.from_arrays(list(columns.values()), names=list(columns))
            columns = {around: inner}
        time = {self.key("time", "time"): self._stamps(time_us)}
        pq.write_table(pa.table({**time, **columns}), path, **self.options)
        return path

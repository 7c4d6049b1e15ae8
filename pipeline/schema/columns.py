"""Definitions of columns and tables, and the columns that many tables share."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

TIMESTAMP = pl.Datetime("us", "UTC")
NUMBERS = pl.List(pl.Float64)
SHORT_NUMBERS = pl.List(pl.Float32)
COUNTS = pl.List(pl.Int64)
NAMES = pl.List(pl.String)


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name (with its unit, where it has one), type, unit and meaning."""

    name: str
    type: pl.DataType | type[pl.DataType]
    unit: str
    description: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table: its key sorts the rows, and no two rows share it."""

    name: str
    row: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]

    @property
    def schema(self) -> dict[str, pl.DataType | type[pl.DataType]]:
        """Polars types by column name."""
        return {column.name: column.type for column in self.columns}


RUN_ID = Column("run_id", pl.String, "", "Run that wrote the row: hash of inputs, code and config")
MOTOR_ID = Column("motor_id", pl.String, "", "The motor")
NIGHT = Column("night", pl.Date, "", "Local date on which the night ends")
FLUSHING_MODE = Column("flushing_mode", pl.String, "", "none, fixed or estimated")
FIT_KEY = (MOTOR_ID, NIGHT, FLUSHING_MODE)
FIT_KEY_NAMES = ("motor_id", "night", "flushing_mode")

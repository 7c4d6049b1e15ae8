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


def text(name: str, description: str) -> Column:
    """A column of texts."""
    return Column(name, pl.String, "", description)


def number(name: str, unit: str, description: str) -> Column:
    """A column of numbers."""
    return Column(name, pl.Float64, unit, description)


def count(name: str, description: str) -> Column:
    """A column of whole numbers."""
    return Column(name, pl.Int64, "", description)


def flag(name: str, description: str) -> Column:
    """A column of truth values."""
    return Column(name, pl.Boolean, "", description)


def day(name: str, description: str) -> Column:
    """A column of dates."""
    return Column(name, pl.Date, "", description)


def moment(name: str, description: str) -> Column:
    """A column of times."""
    return Column(name, TIMESTAMP, "UTC", description)


def half_widths(prefix: str, unit: str) -> tuple[Column, ...]:
    """Columns of a figure's ±, by its sources."""
    return tuple(
        number(f"{prefix}{name}_half_width", unit, what)
        for name, what in (
            ("statistical", "± from the samples: half of the 95 % interval"),
            ("sensor", "± from tolerances of sensors, stated or assumed by their kind"),
            ("model", "± from the night's structured misfit; null where it is not known"),
            ("total", "± of all parts by their squares: of the figure itself; verdicts go by it"),
        )
    )


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


RUN_ID = text("run_id", "Run that wrote the row: hash of inputs, code and config")
MOTOR_ID = text("motor_id", "The motor")
NIGHT = day("night", "Local date on which the night ends")
FLUSHING_MODE = text("flushing_mode", "none, fixed or estimated")
FIT_KEY = (MOTOR_ID, NIGHT, FLUSHING_MODE)
FIT_KEY_NAMES = ("motor_id", "night", "flushing_mode")

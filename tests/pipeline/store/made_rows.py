"""Rows of one table, written and published."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.schema import QUALITY, Table, frame
from pipeline.store.night_files import NewFile, NewRows, prepare_file, with_nights
from pipeline.store.tables import night_file

NIGHT = dt.date(2026, 1, 2)
LATER = dt.date(2026, 2, 1)
Row = dict[str, Any]


def row(motor: str, reason: str = "gap", refused: int = 1, night: dt.date = NIGHT) -> Row:
    return {
        "motor_id": motor,
        "night": night,
        "channel": "speed",
        "reason": reason,
        "n_samples": 864_000,
        "n_refused": refused,
    }


def rows(*some: Row, run_id: str = "first") -> pl.DataFrame:
    return frame(QUALITY, [{**one, "run_id": run_id} for one in some])


def new(*some: Row) -> pl.DataFrame:
    """Rows as a motor's task leaves them."""
    return frame(QUALITY, some)


def publish_night(
    output: Path,
    table: Table,
    night: dt.date,
    some: Mapping[str, pl.DataFrame],
    run_id: str,
    *more: Any,
) -> NewFile:
    """Prepare the file with a night, and put it there."""
    pieces = [
        rows.with_columns(run_id=pl.lit(run_id)).select(table.schema.keys()).sort(table.order)
        for _, rows in sorted(some.items())
    ]
    new = NewRows(tuple(some), sum(rows.height for rows in pieces), pieces)
    change = with_nights(table, [(night, new)])
    file = prepare_file(night_file(output, table, night), table, change, *more)
    file.land()
    return file


def all_files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


def example(table: Table) -> Row:
    """A value of each column's type."""
    values: dict[str, Any] = {
        "String": "mm²/s, µm",
        "Date": NIGHT,
        "Int64": 2**53 + 1,
        "Float64": 0.1,
        "Boolean": True,
        "List(Float64)": [1.5, -0.0, 1e-300],
        "List(Float32)": [1.5, -0.0],
        "List(Int64)": [1, 2**40],
        "List(String)": ["K_o", ""],
    }
    moment = dt.datetime(2026, 1, 2, 3, 4, 5, 678_901, tzinfo=dt.UTC)
    return {
        name: values.get(str(kind if isinstance(kind, pl.DataType) else kind()), moment)
        for name, kind in table.schema.items()
    }

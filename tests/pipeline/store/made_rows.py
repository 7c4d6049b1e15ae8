"""Rows of one table, written and published."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.schema import QUALITY, TYPES, Table, frame
from pipeline.store.publishing import Publisher, StagedNights, stage, staged_file
from pipeline.store.state import open_state

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
    return frame(QUALITY, [{**content, "run_id": run_id} for content in some])


def publish(
    output: Path,
    motors: Mapping[str, Mapping[Table, StagedNights]],
    run_id: str = "r",
    published: Callable[[], object] = lambda: None,
) -> None:
    """Stage nights of motors, and publish them, as a run does."""
    staging = output / "staging" / "run"
    staging.mkdir(parents=True, exist_ok=True)
    for motor_id, tables in motors.items():
        stage(staged_file(staging / "nights", motor_id), tables)
    tables = list(dict.fromkeys(table for some in motors.values() for table in some))
    with open_state(output) as state:
        Publisher(state, staging, run_id).nights("nights", tables, list(motors), published)


def publish_night(
    output: Path, some: Mapping[str, Sequence[Row]], run_id: str = "r", table: Table = QUALITY
) -> None:
    """Publish rows of one night by motor."""
    publish(output, {motor: {table: {NIGHT: rows}} for motor, rows in some.items()}, run_id)


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
        str(TYPES["causes"]): [{"cause": "K_o", "probability": 0.5}],
    }
    moment = dt.datetime(2026, 1, 2, 3, 4, 5, 678_901, tzinfo=dt.UTC)
    return {
        name: values.get(str(kind if isinstance(kind, pl.DataType) else kind()), moment)
        for name, kind in table.schema.items()
    }

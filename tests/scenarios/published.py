"""Published tables, as a reader has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl

Row = dict[str, Any]


def table(output: Path, name: str) -> pl.DataFrame:
    """A published table; without rows where nothing is published of it."""
    files = sorted((output / "tables" / name).rglob("*.parquet"))
    rows = pl.DataFrame() if not files else pl.read_parquet(files, hive_partitioning=False)
    return rows.sort("motor_id", "night") if files and name == "nights" else rows

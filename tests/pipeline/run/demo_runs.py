"""Runs over the demo fleet, and what they leave."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
from polars.testing import assert_frame_equal

from pipeline.config import load_fleet
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.schema import NIGHT_TABLES, OF_NIGHT, TABLES
from pipeline.schema import NIGHTS as OF_NIGHTS

FIRST = dt.date(2026, 1, 2)
NIGHTS = [FIRST, FIRST + dt.timedelta(days=1), FIRST + dt.timedelta(days=2)]
MOTORS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]
# Tables of a run itself: they say when and how long.
OF_RUNS = {"runs", "run_motors"}
CSV, PARQUET, MCAP = "CB400-01", "CB400-02", "CB560-01"


def run(
    fleet_file: Path,
    *motors: str,
    since: dt.date | None = None,
    until: dt.date | None = None,
    output: Path | None = None,
    repair: bool = False,
    **execution: Any,
) -> RunResult:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update={"backend": "sequential"} | execution)
    fleet = replace(fleet, execution=how, output=output or fleet.output)
    return run_fleet(RunRequest(fleet, motors, since, until, repair=repair))


def status_of(result: RunResult) -> dict[str, str]:
    return {outcome.motor_id: outcome.status for outcome in result.outcomes}


def nights_of(result: RunResult) -> dict[str, list[dt.date]]:
    return {outcome.motor_id: list(outcome.nights) for outcome in result.outcomes}


def rows(output: Path, table: str, *motors: str) -> pl.DataFrame:
    """A table as a reader sees it, but for the run that wrote each row."""
    (declared,) = (one for one in TABLES if one.name == table)
    if not (folder := output / "tables" / table).exists():
        return pl.DataFrame(schema=declared.schema).drop("run_id", strict=False)
    found = pl.read_parquet(folder / "**" / "*.parquet", hive_partitioning=False)
    if motors:
        found = found.filter(pl.col("motor_id").is_in(motors))
    return found.drop("run_id", strict=False).sort([k for k in declared.key if k != "run_id"])


def check_same_tables(output: Path, other: Path, *motors: str) -> None:
    """All rows that motors' tasks made, whichever runs they came from."""
    for table in (OF_NIGHTS, *NIGHT_TABLES):
        here, there = rows(output, table.name, *motors), rows(other, table.name, *motors)
        own = OF_NIGHT if table is OF_NIGHTS else here.columns  # the rest is of the trends
        assert_frame_equal(here.select(own), there.select(own), check_exact=True)


def log_file(fleet_file: Path, motor: str, night: dt.date) -> Path:
    (path,) = (fleet_file.parent.parent / "demo" / "logs" / motor).glob(f"{motor}_{night}.*")
    return path


def output_of(fleet_file: Path) -> Path:
    return fleet_file.parent.parent / "out"


def table_files(output: Path) -> dict[str, bytes]:
    """Every table file's bytes by its path, but for tables of the run itself, or that name it."""
    return {
        path.relative_to(output / "tables").as_posix(): path.read_bytes()
        for path in sorted((output / "tables").rglob("*"))
        if path.is_file()
        and path.relative_to(output / "tables").parts[0] not in {*OF_RUNS, "latest"}
    }

"""The command in this process, its refusals, and runs over the demo fleet: what they leave."""

from __future__ import annotations

import datetime as dt
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.config import load_fleet
from pipeline.errors import MotorLeakageError
from pipeline.run.fleet import RunRequest, RunResult, run_fleet
from pipeline.schema import TABLES

CSV, PARQUET = "CB400-01", "CB400-02"
Called = tuple[int, str, str]
Call = Callable[..., Called]


@contextmanager
def refused(code: str, words: str = "") -> Iterator[None]:
    """A block that ends with an error of the program: its code, and words of its message."""
    with pytest.raises(MotorLeakageError) as caught:
        yield
    assert caught.value.code == code
    assert words in caught.value.message


def python(code: str, *arguments: object, **settings: Any) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, which ends well."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True, **settings)


def contents(folder: Path) -> dict[str, bytes]:
    """Files of a folder by their path in it."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def change(fleet: Path, file: str, before: str, after: str) -> None:
    path = fleet.parent / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")


def without_workers(fleet: Path) -> Path:
    """For tests of what the command says, not of how its work is spread."""
    change(fleet, "fleet.toml", "[execution]\n", '[execution]\nbackend = "sequential"\n')
    return fleet


FIRST = dt.date(2026, 1, 2)
MOTORS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]
# Tables of a run itself: they say when and how long.
OF_RUNS = {"runs", "run_motors"}


def run(
    fleet_file: Path, output: Path | None = None, *, repair: bool = False, **execution: Any
) -> RunResult:
    fleet = load_fleet(fleet_file)
    how = fleet.execution.model_copy(update={"backend": "sequential"} | execution)
    fleet = replace(fleet, execution=how, output=output or fleet.output)
    return run_fleet(RunRequest(fleet, repair=repair))


def status_of(result: RunResult) -> dict[str, str]:
    return {outcome.motor_id: outcome.status for outcome in result.outcomes}


def rows(output: Path, table: str, *motors: str) -> pl.DataFrame:
    """A table as a reader sees it, but for the run that wrote each row."""
    (declared,) = (known for known in TABLES if known.name == table)
    if not (folder := output / "tables" / table).exists():
        return pl.DataFrame(schema=declared.schema).drop("run_id", strict=False)
    found = pl.read_parquet(folder / "**" / "*.parquet", hive_partitioning=False)
    if motors:
        found = found.filter(pl.col("motor_id").is_in(motors))
    return found.drop("run_id", strict=False).sort([k for k in declared.key if k != "run_id"])


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

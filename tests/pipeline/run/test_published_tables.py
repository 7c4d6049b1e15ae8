"""Tables of a run, as a reader sees them."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import polars as pl
import pytest

from pipeline.schema import TABLES
from tests.pipeline.run.demo_runs import MOTORS, rows

EXCITED = [motor for motor in MOTORS if motor != "CB1120-02"]


# What a reader of the tables sees


def test_a_run_records_what_made_it_and_how_long_it_took(fitted_output: Path) -> None:
    (run,) = rows(fitted_output, "runs").to_dicts()
    assert run["version"] == version("motor-leakage")
    outcomes = rows(fitted_output, "run_motors")
    assert (outcomes["read_s"] > 0).all()
    assert (outcomes["read_s"] < outcomes["total_s"]).all()
    # Motors are done one after another here, so theirs is no more than the run's.
    assert outcomes["total_s"].sum() <= run["total_s"]


# Nothing is raised, frozen or said in three nights.
WITHOUT_ROWS = {"alarms", "decisions", "intraday"}


@pytest.mark.parametrize("table", sorted({table.name for table in TABLES} - WITHOUT_ROWS))
def test_keys_stand_once_and_types_are_those_declared(fitted_output: Path, table: str) -> None:
    (declared,) = (one for one in TABLES if one.name == table)
    folder = fitted_output / "tables" / table
    found = pl.read_parquet(folder / "**" / "*.parquet", hive_partitioning=False)
    assert found.height
    assert found.select(declared.key).is_unique().all()
    assert dict(found.schema) == {
        name: kind if isinstance(kind, pl.DataType) else kind()
        for name, kind in declared.schema.items()
    }


def test_a_motor_at_one_pressure_has_no_leakage_at_the_reference(fitted_output: Path) -> None:
    fits = rows(fitted_output, "fits", "CB1120-02")
    assert set(fits["fitted_leakage_verdict"]) == {"outside_fitted_range"}
    assert fits["fitted_leakage_l_per_min"].is_null().all()

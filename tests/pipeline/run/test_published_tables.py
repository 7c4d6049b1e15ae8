"""Tables of a run, as a reader sees them."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path

import polars as pl
import pytest

from pipeline.schema import TABLES
from tests.pipeline.run.demo_runs import MOTORS, NIGHTS, rows

EXCITED = [motor for motor in MOTORS if motor != "CB1120-02"]


# What a reader of the tables sees


def test_input_files_tell_what_was_read(fitted_output: Path, demo_folder: Path) -> None:
    for row in rows(fitted_output, "log_files").iter_rows(named=True):
        path = demo_folder / "demo" / "logs" / row["path"]
        assert row["size_bytes"] == path.stat().st_size
        assert str(row["night"]) in row["path"]
        assert row["first_time"] < row["last_time"]
        assert row["rows"] > 10_000


def test_a_run_records_what_made_it_and_how_long_it_took(fitted_output: Path) -> None:
    (run,) = rows(fitted_output, "runs").to_dicts()
    assert run["version"] == version("motor-leakage")
    assert min(run["motors_s"], run["publish_s"], run["trends_s"]) > 0
    assert run["motors_s"] + run["publish_s"] + run["trends_s"] == pytest.approx(run["total_s"])
    outcomes = rows(fitted_output, "run_motors")
    assert (outcomes["read_s"] > 0).all()
    assert (outcomes["read_s"] < outcomes["total_s"]).all()
    # Motors are done one after another here, so theirs is no more than the run's.
    assert outcomes["total_s"].sum() <= run["motors_s"]


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


@pytest.mark.parametrize("motor", EXCITED)
def test_estimates_are_near_the_truth(fitted_output: Path, demo_folder: Path, motor: str) -> None:
    truth = json.loads((demo_folder / "demo" / "truth.json").read_text())["motors"][motor]["nights"]
    fits = {row["night"]: row for row in rows(fitted_output, "fits", motor).iter_rows(named=True)}
    for night in NIGHTS:
        true = truth[night.isoformat()]
        found = {
            row["parameter"]: row["value"]
            for row in rows(fitted_output, "parameters", motor).iter_rows(named=True)
            if row["night"] == night
        }
        for path, k in true["K_m3"].items():
            assert found[f"K_{path}"] == pytest.approx(k, rel=0.15), (night, path)
        assert found["C_f"] == pytest.approx(true["C_f_l_per_min"], abs=0.05)
        leakage = fits[night]["fitted_leakage_l_per_min"]
        assert leakage == pytest.approx(true["reference_leakage_l_per_min"], rel=0.015)


def test_a_motor_at_one_pressure_has_no_leakage_at_the_reference(fitted_output: Path) -> None:
    fits = rows(fitted_output, "fits", "CB1120-02")
    assert set(fits["fitted_leakage_verdict"]) == {"outside_fitted_range"}
    assert fits["fitted_leakage_l_per_min"].is_null().all()

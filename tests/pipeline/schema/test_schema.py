"""Names, types and units of the tables, against the design's list of them."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl
import pytest

from pipeline.schema import (
    COUNTS,
    FITS,
    NIGHT_TABLES,
    NUMBERS,
    PRESSURE_EDGES_BAR,
    QUALITY,
    SCHEMA_VERSION,
    SPEED_EDGES_RPM,
    TABLES,
    TEMPERATURE_EDGES_C,
    TIMESTAMP,
    Column,
    Table,
    data_dictionary,
    frame,
    staged_table,
)

EACH_TABLE = pytest.mark.parametrize("table", TABLES, ids=[table.name for table in TABLES])
FIT_KEY = ("motor_id", "night", "flushing_mode")
# Design 4: key and core columns; others may follow.
DESIGN: dict[str, tuple[tuple[str, ...], str]] = {
    "fits": (
        FIT_KEY,
        "motor_id motor_type night window_start window_end flushing_mode is_primary status reason "
        "n_training n_validation training_fit_percent validation_fit_percent "
        "previous_model_fit_percent training_rmse_l_per_min validation_rmse_l_per_min smoothing_s "
        "fpe aic aicc bic n_effective cost rank "
        "condition_number reference_leakage_l_per_min reference_leakage_lower "
        "reference_leakage_upper reference_leakage_systematic reference_verdict "
        "own_conditions_leakage_l_per_min own_conditions_leakage_lower "
        "own_conditions_leakage_upper outside_fitted_range",
    ),
    "parameters": (
        (*FIT_KEY, "parameter"),
        "value unit lower upper systematic feasible_min feasible_max verdict reason",
    ),
    "residual_tests": (
        (*FIT_KEY, "part", "smoothed", "test", "input", "lag"),
        "value bound outside",
    ),
    "residual_verdicts": (
        (*FIT_KEY, "part", "smoothed", "test", "input"),
        "verdict reason statistic degrees_of_freedom p_value n_lags n_outside",
    ),
    "predictions": (
        (*FIT_KEY, "time"),
        "part pressure_difference_bar oil_temperature_c speed_rpm measured_l_per_min "
        "predicted_l_per_min",
    ),
    "quality": (("motor_id", "night", "channel", "reason"), "n_samples n_refused"),
    "block_statistics": (
        ("motor_id", "night", "block_start"),
        "block_end part n statistics columns mean_temperature_c minimum_pressure_bar "
        "maximum_pressure_bar pressure_histogram minimum_temperature_c maximum_temperature_c "
        "temperature_histogram minimum_speed_rpm maximum_speed_rpm speed_histogram share_reversed "
        "n_beyond_curve model_hash",
    ),
    "input_files": (
        ("motor_id", "path"),
        "size_bytes sha256 rows first_time last_time status error_code message",
    ),
    "runs": (("run_id", "started_at"), "status seconds"),
    "motor_outcomes": (
        ("run_id", "started_at", "motor_id"),
        "status error_code message read_s clean_s statistics_s fit_s store_s",
    ),
    "data_dictionary": (("table", "column"), "type unit description"),
}
# How a unit shows in a column's name.
SUFFIXES = {
    "bar": "_bar", "°C": "_c", "rpm": "_rpm", "l/min": "_l_per_min", "s": "_s", "%": "_percent",
    "B": "_bytes", "MiB": "_mib",
}  # fmt: skip


@pytest.mark.parametrize("name", DESIGN)
def test_tables_of_the_design(name: str) -> None:
    table = next(table for table in TABLES if table.name == name)
    key, core = DESIGN[name]
    assert table.key == key
    assert set(core.split()) <= table.schema.keys()


@EACH_TABLE
def test_columns_have_a_name_and_a_meaning_and_the_key_is_of_them(table: Table) -> None:
    names = [column.name for column in table.columns]
    assert len(names) == len(set(names)) == len(table.schema)
    assert all(re.fullmatch(r"[a-z][a-z0-9_]*", name) for name in names)
    assert table.row
    assert all(column.description for column in table.columns)
    assert set(table.key) <= set(names)
    assert len(set(table.key)) == len(table.key) > 0
    assert "run_id" in names or table.name == "data_dictionary"
    if table in NIGHT_TABLES:  # whose rows of a night are replaced
        assert ("motor_id" in names, table.schema["night"]) == (True, pl.Date)
    for column in table.columns:
        is_time = isinstance(column.type, pl.Datetime)
        assert is_time == (column.unit == "UTC") == (column.type == TIMESTAMP), column.name


def in_name(column: Column, table: Table) -> bool:
    """True if the unit is in the name, or in that of the figure that the column goes with."""
    suffix = SUFFIXES[column.unit]
    stem = re.sub(
        r"_(lower|upper|systematic|(statistical|sensor|model|total)_half_width)$", "", column.name
    )
    if stem != column.name:
        return f"{stem}{suffix}" in table.schema
    return column.name.endswith(suffix) or column.name == "seconds"


@EACH_TABLE
def test_units_stand_in_the_names(table: Table) -> None:
    for column in table.columns:
        if column.unit in SUFFIXES:
            assert in_name(column, table), column.name
        for unit, suffix in SUFFIXES.items():
            if column.name.endswith(suffix):
                assert column.unit == unit, column.name


def test_a_name_means_one_thing_in_all_tables() -> None:
    kinds: dict[str, Column] = {}
    shared = {"value", "status", "reason", "unit", "column", "columns", "seconds", "start"}
    # Of the intraday check, a moment and per cent; of the watch a day and a share.
    shared |= {"since", "change_lower", "change_upper"}
    for table in TABLES:
        for column in table.columns:
            first = kinds.setdefault(column.name, column)
            if column.name not in shared:
                assert (column.type, column.unit) == (first.type, first.unit), column.name


def test_histogram_edges() -> None:
    """As the descriptions of their columns say: 20 bar from 0, 5 °C from −20, 10 rpm from 0."""
    for edges, first, step in (
        (PRESSURE_EDGES_BAR, 0.0, 20.0),
        (TEMPERATURE_EDGES_C, -20.0, 5.0),
        (SPEED_EDGES_RPM, 0.0, 10.0),
    ):
        assert edges[0] == first
        assert set(np.diff(edges)) == {step}


class TestFrame:
    STAGED: ClassVar = {"motor_id": "A", "night": dt.date(2026, 1, 2), "channel": "speed"}
    STAGED |= {"reason": "gap", "n_samples": 10, "n_refused": 1}
    ROW: ClassVar = STAGED | {"run_id": "r"}

    def test_unknown_column_is_refused(self) -> None:
        with pytest.raises(ValueError, match="quality has no column n_kept, n_lost"):
            frame(QUALITY, [self.ROW, self.ROW | {"n_lost": 1, "n_kept": 2}])

    def test_a_column_that_comes_later_is_not_taken(self) -> None:
        with pytest.raises(ValueError, match="run_id"):
            staged_table(QUALITY, [self.ROW])
        assert "run_id" not in staged_table(QUALITY, [self.STAGED]).column_names

    @EACH_TABLE
    def test_absent_values_are_null_whatever_the_order(self, table: Table) -> None:
        """A column that only the last of many rows has."""
        last = table.columns[-1].name
        kind = str(table.schema[last])
        values = {"Int64": 1, "Float64": 1.0, "Boolean": True, "Date": dt.date(2026, 1, 2)}
        values |= {"List(String)": ["x"], "List(Float32)": [1.0], "List(Float64)": [1.0]}
        value: Any = values.get(kind, "x")
        found = frame(table, [{}] * 1000 + [{last: value}])
        assert dict(found.schema) == dict(pl.Schema(table.schema))
        assert found[last].to_list() == [None] * 1000 + [value]
        assert found.drop(last).null_count().row(0) == (1001,) * (len(table.columns) - 1)

    def test_wrong_type_is_refused(self) -> None:
        for name, value in (("n_samples", "ten"), ("n_samples", np.nan), ("night", "2026-01-02")):
            with pytest.raises((TypeError, pl.exceptions.PolarsError)):
                frame(QUALITY, [self.ROW | {name: value}])
            with pytest.raises((TypeError, ValueError)):
                staged_table(QUALITY, [self.STAGED | {name: value}])


def test_values_of_numpy_times_and_lists_come_as_they_are() -> None:
    moment = dt.datetime(2026, 1, 2, 3, 4, 5, 678_901, tzinfo=dt.UTC)
    row = {"cost": 1, "n_training": np.int64(5), "window_start": moment, "singular_values": [2.5]}
    found = frame(FITS, iter([row, {"cost": float("nan")}, {"cost": None}]))
    assert found["cost"].to_list()[::2] == [1.0, None]
    assert found["cost"].is_nan().to_list() == [False, True, None]
    assert found.row(0, named=True).items() >= row.items()


def test_data_dictionary_has_every_column_once_and_its_type_as_polars_names_it() -> None:
    found = data_dictionary()
    types = dict(found.select("column", "type").rows())
    assert types["night"] == "Date"
    assert types["window_start"] == "Datetime(time_unit='us', time_zone='UTC')"
    assert types["statistics"] == str(NUMBERS) == "List(Float64)"
    assert types["speed_histogram"] == str(COUNTS)
    assert len({table.name for table in TABLES}) == len(TABLES)
    expected = {(table.name, column.name) for table in TABLES for column in table.columns}
    assert set(found.select("table", "column").iter_rows()) == expected
    assert found.height == len(expected)
    assert found["schema_version"].unique().to_list() == [SCHEMA_VERSION]
    assert not found.select(pl.any_horizontal(pl.all().is_null()).any()).item()
    keys = found.filter("in_key").group_by("table").len()
    assert dict(keys.iter_rows()) == {table.name: len(table.key) for table in TABLES}


def test_units_in_the_rows_are_those_that_the_columns_name(fitted_output: Path) -> None:
    """One spelling of a unit, as the names of columns have it."""
    named = {
        (table.name, column.name): set(re.findall(r"[^\s,:]+", column.description.split(":")[0]))
        for table in TABLES
        for column in table.columns
        if column.name in ("unit", "tolerance_unit")
        and table.name in ("parameters", "sensitivities")
    }
    assert len(named) == 3
    for (table, column), words in named.items():
        rows = pl.read_parquet(fitted_output / "tables" / table / "**" / "*.parquet")
        found = set(rows[column])
        assert found <= words, (table, column)
        assert "l_per_min" in found

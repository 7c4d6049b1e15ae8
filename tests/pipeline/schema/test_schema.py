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
    LATEST,
    NIGHT_TABLES,
    NIGHTS,
    NUMBERS,
    PRESSURE_EDGES_BAR,
    QUALITY,
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
# How a unit shows in a column's name.
SUFFIXES = {
    "bar": "_bar", "°C": "_c", "rpm": "_rpm", "l/min": "_l_per_min", "s": "_s", "%": "_percent",
    "h": "_hours", "B": "_bytes", "MiB": "_mib",
}  # fmt: skip
# Names that mean what their table is of.
OF_THEIR_TABLE = {"value", "status", "reason", "unit", "column", "lower", "upper"}


def test_tables_and_columns_are_few() -> None:
    """The limits of the design, section 4."""
    assert len(TABLES) == 17
    counts = {table.name: len(set(table.schema) - {"run_id"}) for table in TABLES}
    counts["latest"] -= counts["nights"]
    assert counts["nights"] <= 85
    assert counts["fits"] <= 48
    assert sum(counts.values()) <= 300


def test_latest_has_the_names_of_nights() -> None:
    names = [column.name for column in NIGHTS.columns if column.name != "run_id"]
    assert names == [column.name for column in LATEST.columns if column.name in names]


@EACH_TABLE
def test_columns_have_a_name_and_a_meaning_and_the_key_is_of_them(table: Table) -> None:
    names = [column.name for column in table.columns]
    assert len(names) == len(set(names)) == len(table.schema)
    assert all(re.fullmatch(r"[a-z][a-z0-9_]*", name) for name in names)
    assert table.row
    assert all(column.description for column in table.columns)
    assert set(table.key) <= set(names)
    assert "run_id" in names or table.name == "data_dictionary"
    if table in NIGHT_TABLES:  # whose rows of a night are replaced
        assert ("motor_id" in names, table.schema["night"]) == (True, pl.Date)
    for column in table.columns:
        is_time = isinstance(column.type, pl.Datetime)
        assert is_time == (column.unit == "UTC") == (column.type == TIMESTAMP), column.name


@EACH_TABLE
def test_units_stand_in_the_names(table: Table) -> None:
    for column in table.columns:
        if column.unit in SUFFIXES:
            assert _figure_of(column, table).endswith(SUFFIXES[column.unit]), column.name
        for unit, suffix in SUFFIXES.items():
            if column.name.endswith(suffix):
                assert column.unit == unit, column.name


def _figure_of(column: Column, table: Table) -> str:
    """Name of the figure that an end of an interval goes with, or of the column itself."""
    stem = re.sub(r"_(lower|upper)$", "", column.name)
    if stem == column.name:
        return stem
    return next(name for name in (*(f"{stem}{suffix}" for suffix in SUFFIXES.values()), stem)
                if name in table.schema)  # fmt: skip


@EACH_TABLE
def test_intervals_come_in_pairs_around_a_figure_of_the_same_unit(table: Table) -> None:
    columns = {column.name: column for column in table.columns}
    for name in columns:
        if name.endswith("_lower"):
            ends = [columns[name], columns[f"{name.removesuffix('lower')}upper"]]
            figure = columns[_figure_of(columns[name], table)]
            assert [end.unit for end in ends] == [figure.unit] * 2, name
    ends = [name.rpartition("_")[2] for name in columns]
    assert ends.count("lower") == ends.count("upper")


def test_a_name_means_one_thing_in_all_tables() -> None:
    kinds: dict[str, Column] = {}
    for table in TABLES:
        for column in table.columns:
            first = kinds.setdefault(column.name, column)
            if column.name not in OF_THEIR_TABLE:
                assert (column.type, column.unit) == (first.type, first.unit), column.name


def test_no_column_says_what_another_says() -> None:
    """One quantity, one name: meanings differ but for what tables share, and for intervals."""
    meanings: dict[str, str] = {}
    for table in TABLES:
        for column in table.columns:
            is_share = re.search(r"share|fraction|ratio", column.name)  # these are in percent
            assert not is_share or column.name == "viscosity_ratio", column.name
            is_end = re.search(r"(^|_)(lower|upper)$", column.name)
            name = meanings.setdefault(f"{column.unit} {column.description}", column.name)
            assert is_end or name == column.name, (table.name, column.name, name)


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
    row = {"cost": 1, "n_training": np.int64(5), "window_start": moment, "coefficients": [2.5]}
    found = frame(FITS, iter([row, {"cost": float("nan")}, {"cost": None}]))
    assert found["cost"].to_list()[::2] == [1.0, None]
    assert found["cost"].is_nan().to_list() == [False, True, None]
    assert found.row(0, named=True).items() >= row.items()


def test_data_dictionary_has_every_column_once_and_its_type_as_polars_names_it() -> None:
    found = data_dictionary()
    types = dict(found.select("column", "type").rows())
    assert types["night"] == "Date"
    assert types["window_start"] == "Datetime(time_unit='us', time_zone='UTC')"
    assert types["factor"] == str(NUMBERS) == "List(Float64)"
    assert types["speed_histogram"] == str(COUNTS)
    assert len({table.name for table in TABLES}) == len(TABLES)
    expected = {(table.name, column.name) for table in TABLES for column in table.columns}
    assert set(found.select("table", "column").iter_rows()) == expected
    assert found.height == len(expected)
    assert not found.select(pl.any_horizontal(pl.all().is_null()).any()).item()


def test_units_in_the_rows_are_those_that_the_columns_name(fitted_output: Path) -> None:
    """One spelling of a unit, as the names of columns have it."""
    named = {
        (table.name, column.name): set(re.findall(r"[^\s,:]+", column.description.split(":")[0]))
        for table in TABLES
        for column in table.columns
        if column.name in ("unit", "tolerance_unit")
        and table.name in ("parameters", "error_budget")
    }
    assert len(named) == 3
    for (table, column), words in named.items():
        rows = pl.read_parquet(fitted_output / "tables" / table / "**" / "*.parquet")
        found = set(rows[column])
        assert found <= words, (table, column)
        assert "l_per_min" in found

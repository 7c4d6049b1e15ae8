"""Names, types, units and meaning of every column of every table. The only place.

``docs/tables.md`` and the table ``data_dictionary`` are made from here. Columns are only ever
added; each addition raises the version.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import polars as pl
import pyarrow as pa

from pipeline.schema.columns import COUNTS, FIT_KEY_NAMES, NUMBERS, TIMESTAMP, Column, Table
from pipeline.schema.fits import FITS
from pipeline.schema.parameters import PARAMETERS, SENSITIVITIES, STARTS
from pipeline.schema.residuals import PREDICTIONS, RESIDUAL_TESTS, RESIDUAL_VERDICTS
from pipeline.schema.runs import DATA_DICTIONARY, INPUT_FILES, MOTOR_OUTCOMES, RUNS
from pipeline.schema.samples import (
    BLOCK_STATISTICS,
    OPERATION,
    PRESSURE_EDGES_BAR,
    QUALITY,
    QUALITY_REASONS,
    SPEED_EDGES_RPM,
    TEMPERATURE_EDGES_C,
)
from pipeline.schema.trends import (
    ALARM_CONTENT,
    ALARMS,
    BASELINES,
    CHANGE_POINTS,
    DECISIONS,
    LATEST,
    LOOKS,
    TRENDS,
)

__all__ = [
    "ALARMS",
    "ALARM_CONTENT",
    "BASELINES",
    "BLOCK_STATISTICS",
    "CHANGE_POINTS",
    "COUNTS",
    "DATA_DICTIONARY",
    "DECISIONS",
    "FITS",
    "FIT_KEY_NAMES",
    "INPUT_FILES",
    "LATEST",
    "LOOKS",
    "MOTOR_OUTCOMES",
    "NIGHT_TABLES",
    "NUMBERS",
    "OPERATION",
    "PARAMETERS",
    "PREDICTIONS",
    "PRESSURE_EDGES_BAR",
    "QUALITY",
    "QUALITY_REASONS",
    "RESIDUAL_TESTS",
    "RESIDUAL_VERDICTS",
    "RUNS",
    "SCHEMA_VERSION",
    "SENSITIVITIES",
    "SPEED_EDGES_RPM",
    "STARTS",
    "TABLES",
    "TEMPERATURE_EDGES_C",
    "TIMESTAMP",
    "TRENDS",
    "TREND_TABLES",
    "WHOLE_TABLES",
    "Column",
    "Table",
    "data_dictionary",
    "frame",
    "staged_table",
]


SCHEMA_VERSION = 6

# One file a night; a redone night of a motor replaces that motor's rows in each of them.
NIGHT_TABLES = (
    FITS,
    PARAMETERS,
    SENSITIVITIES,
    STARTS,
    RESIDUAL_TESTS,
    RESIDUAL_VERDICTS,
    PREDICTIONS,
    QUALITY,
    OPERATION,
    BLOCK_STATISTICS,
    INPUT_FILES,
)

# The same, made from the tables above after all motors are done.
TREND_TABLES = (TRENDS, ALARMS, BASELINES, CHANGE_POINTS)

# One file each.
WHOLE_TABLES = (LATEST, DECISIONS, DATA_DICTIONARY)

TABLES = (
    LATEST,
    *NIGHT_TABLES,
    *TREND_TABLES,
    LOOKS,
    DECISIONS,
    RUNS,
    MOTOR_OUTCOMES,
    DATA_DICTIONARY,
)


def frame(table: Table, rows: Iterable[Mapping[str, Any]]) -> pl.DataFrame:
    """Rows as a frame with exactly the table's columns and types; absent values are null.

    Raises
    ------
    ValueError
        If a row has a column that the table has not: a figure would be lost silently.
    """
    # Not by way of Arrow, which loads pandas, where there is one, with its first array.
    return pl.DataFrame(
        _known(rows, table.name, table.schema), schema=table.schema, orient="row", strict=True
    )


def staged_table(table: Table, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """The same in Arrow, without the run: many rows of many columns take a quarter of the time.

    Raises
    ------
    ValueError, TypeError
        If a row has a column that the table has not, or a value that its column cannot hold.
    """
    schema = _staged_schema(table)
    every = pa.array(_known(rows, table.name, schema.names), pa.struct(schema))
    return pa.Table.from_struct_array(every)


@cache
def _staged_schema(table: Table) -> pa.Schema:
    empty = pl.DataFrame(schema=table.schema).drop("run_id")
    return empty.to_arrow(compat_level=pl.CompatLevel.oldest()).schema


def _known(
    rows: Iterable[Mapping[str, Any]], table: str, columns: Iterable[str]
) -> list[Mapping[str, Any]]:
    """The rows, which have no other columns than these."""
    every = list(rows)
    strangers = set().union(*every) - set(columns)
    if strangers:
        raise ValueError(f"{table} has no column {', '.join(sorted(strangers))}")
    return every


def data_dictionary() -> pl.DataFrame:
    """The table `data_dictionary`: every column of every table."""
    return frame(
        DATA_DICTIONARY,
        [
            {
                "table": table.name,
                "column": column.name,
                "type": str(column.type if isinstance(column.type, pl.DataType) else column.type()),
                "unit": column.unit,
                "description": column.description,
                "in_key": column.name in table.key,
                "schema_version": SCHEMA_VERSION,
            }
            for table in TABLES
            for column in table.columns
        ],
    )

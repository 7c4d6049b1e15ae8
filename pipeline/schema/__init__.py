"""Names, types, units and meaning of every column of every table. The only place.

``docs/tables.md`` and the table ``data_dictionary`` are made from here. Columns are only ever
added; each addition raises the version.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import polars as pl

from pipeline.schema.columns import (
    COUNTS,
    FIT_KEY_NAMES,
    NUMBERS,
    TIMESTAMP,
    Column,
    Table,
)
from pipeline.schema.fits import (
    FITS,
    PARAMETERS,
    SENSITIVITIES,
    STARTS,
)
from pipeline.schema.residuals import (
    PREDICTIONS,
    RESIDUAL_TESTS,
    RESIDUAL_VERDICTS,
)
from pipeline.schema.runs import (
    DATA_DICTIONARY,
    INPUT_FILES,
    MOTOR_OUTCOMES,
    RUNS,
)
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


def frame(table: Table, rows: Iterable[Mapping[str, Any]], *, without: str = "") -> pl.DataFrame:
    """Rows as a frame with exactly the table's columns and types; absent values are null.

    Parameters
    ----------
    table
        The table.
    rows
        Column names to values.
    without
        A column that is added later.

    Raises
    ------
    ValueError
        If a row has a column that the table has not: a figure would be lost silently.
    """
    schema = {name: kind for name, kind in table.schema.items() if name != without}
    rows = list(rows)
    strangers = {name for row in rows for name in row} - schema.keys()
    if strangers:
        raise ValueError(f"{table.name} has no column {', '.join(sorted(strangers))}")
    return pl.DataFrame(rows, schema=schema, orient="row", strict=True)


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

"""Names, types, units and meaning of every column of every table. The only place.

``columns.csv`` has a line a column, in the order of the tables; ``docs/tables.md`` and the table
``data_dictionary`` are made from it, and rows are checked by it. From the first release on columns
are only added, and each addition raises the version.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any, Literal

import polars as pl
import pyarrow as pa

SCHEMA_VERSION = 1

Row = dict[str, Any]
"""A row of a table."""

Type = pl.DataType | type[pl.DataType]
TIMESTAMP = pl.Datetime("us", "UTC")
NUMBERS = pl.List(pl.Float64)
COUNTS = pl.List(pl.Int64)
TYPES: Mapping[str, Type] = {
    "text": pl.String,
    "number": pl.Float64,
    "count": pl.Int64,
    "flag": pl.Boolean,
    "day": pl.Date,
    "moment": TIMESTAMP,
    "numbers": NUMBERS,
    "counts": COUNTS,
    "names": pl.List(pl.String),
    "causes": pl.List(pl.Struct({"cause": pl.String, "probability": pl.Float64})),
}
"""Types by the word in ``columns.csv``."""

# Edges of the coarse histograms of `blocks`: the last bin holds all beyond.
PRESSURE_EDGES_BAR = tuple(float(edge) for edge in range(0, 401, 20))
TEMPERATURE_EDGES_C = tuple(float(edge) for edge in range(-20, 121, 5))
SPEED_EDGES_RPM = tuple(float(edge) for edge in range(0, 151, 10))


@dataclass(frozen=True, slots=True)
class Reason:
    """A reason of `quality`: its words on a page, and its meaning in a sentence."""

    words: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name (with its unit, if any), type, unit and meaning."""

    name: str
    type: Type
    unit: str
    description: str
    group: str = ""  # what it belongs to, in a table of many columns


@dataclass(frozen=True, slots=True)
class Table:
    """A table: no two of its rows share the key."""

    name: str
    row: str
    key: tuple[str, ...]
    columns: tuple[Column, ...] = field(hash=False)  # the name tells tables apart, and is quicker

    @property
    def schema(self) -> dict[str, Type]:
        """Polars types by column name."""
        return {column.name: column.type for column in self.columns}

    @property
    def order(self) -> tuple[str, ...]:
        """Columns that sort the rows of a file: those of a night, or of a run, lie together."""
        first = [name for name in ("night", "started_at") if name in self.schema][:1]
        return (*first, *(name for name in self.key if name not in first))


def _lines(name: str) -> Iterator[list[str]]:
    """Yield lines of a file beside this module, without its header."""
    with Path(__file__).with_name(name).open(encoding="utf-8", newline="") as file:
        lines = csv.reader(file)
        next(lines)
        yield from lines


# In the order of the rules; those behind `transport_delay` are of the time base, where all channels
# have come together, or of the night's windows.
QUALITY_REASONS = {name: Reason(*words) for name, *words in _lines("quality_reasons.csv")}
_COLUMNS = {
    name: list(lines) for name, lines in groupby(_lines("columns.csv"), lambda line: line[0])
}


def _table(name: str, row: str, copied: tuple[Column, ...] = ()) -> Table:
    """Return the table of a name, of which a row is `row`; columns of another come first."""
    key, columns = [], []
    for _, column, in_key, kind, unit, meaning, group in _COLUMNS[name]:
        columns.append(Column(column, TYPES[kind], unit, meaning, group))
        key += [column] * bool(in_key)
    return Table(name, row, tuple(key) or ("motor_id",), (*copied, *columns))


NIGHTS = _table("nights", "a motor, a night, also one without a fit")
LATEST = _table(
    "latest",
    "a motor, as of the last run: its newest night, and where that has no figure the newest night "
    "with samples",
    tuple(column for column in NIGHTS.columns if column.name != "run_id"),
)
FITS = _table("fits", "a motor, a night, a flushing mode")
PARAMETERS = _table("parameters", "a fit, a parameter")
ERROR_BUDGET = _table("error_budget", "a fit, an indicator, a source of systematic error")
RESIDUAL_TESTS = _table("residual_tests", "a fit, a part, a test (and input)")
PREDICTIONS = _table("predictions", "a fit, a time, thinned for plots by its extremes")
QUALITY = _table("quality", "a motor, a night, a channel, a reason")
BLOCKS = _table("blocks", "a motor, a block of some minutes")
TRENDS = _table("trends", "a motor, a night, an indicator")
ALARMS = _table("alarms", "a change of state")
INTRADAY = _table("intraday", "a change of state of the intraday check")
DECISIONS = _table("decisions", "what people said of a motor")
LOG_FILES = _table("log_files", "a file read")
RUNS = _table("runs", "a run")
RUN_MOTORS = _table("run_motors", "a motor in a run")
DATA_DICTIONARY = _table("data_dictionary", "a column of a table")

# Columns of `nights` that a motor's own night fills; the others follow from all of its nights.
OF_NIGHT = tuple(
    column.name for column in NIGHTS.columns if column.group in ("what", "data", "fit")
)
OF_TRENDS = tuple(
    column.name for column in NIGHTS.columns if column.name not in (*OF_NIGHT, "run_id")
)
# Columns of what a row of `alarms` says; the others are its key, or follow from it.
ALARM_CONTENT = ("from_state", "to_state", "cause", "sentence", "closed_as")

# A redone night of a motor replaces that motor's rows in each of them.
NIGHT_TABLES = (
    FITS,
    PARAMETERS,
    ERROR_BUDGET,
    RESIDUAL_TESTS,
    PREDICTIONS,
    QUALITY,
    BLOCKS,
    LOG_FILES,
)
# The same, made from the tables above and the nights' own rows after all motors are done.
TREND_TABLES = (NIGHTS, TRENDS, ALARMS)
# A file a night, as many rows are rewritten; of all others but those below one file a month.
NIGHTLY_TABLES = (PREDICTIONS, BLOCKS, RESIDUAL_TESTS)
# One file each.
WHOLE_TABLES = (LATEST, DECISIONS, DATA_DICTIONARY)
TABLES = (
    NIGHTS,
    LATEST,
    *NIGHT_TABLES[:-1],
    *TREND_TABLES[1:],
    INTRADAY,
    DECISIONS,
    LOG_FILES,
    RUNS,
    RUN_MOTORS,
    DATA_DICTIONARY,
)

# Outcomes of a motor's night, verdicts on its model, and what nights say of the drain flow.

OK, STOOD_STILL, NO_NEW_DATA = "ok", "stood_still", "no_new_data"
INSUFFICIENT_DATA, FAILED = "insufficient_data", "failed"
# Outcomes of nights of which a log could be read.
WITH_SAMPLES = (OK, STOOD_STILL, INSUFFICIENT_DATA)

# Lack of fit up to which a model is supported, and up to which it is doubtful (model.md, 7b).
SUPPORTED, DOUBTFUL = 0.02, 0.05
ModelVerdict = Literal["supported", "doubtful", "disproved"]
LAG_COLUMNS = ("drain_lag_s", "drain_lag_gain_percent")
# Nights that decide on the drain flow's delay, how close their lags are to each other, and what
# they explain: steady motors scatter over the whole range (model.md, 7c.7).
DECIDING_NIGHTS, AGREEING_S, LEAST_GAIN_PERCENT = 8, 0.5, 5.0


def frame(table: Table, rows: Iterable[Mapping[str, Any]]) -> pl.DataFrame:
    """Return rows as a frame with exactly the table's columns and types; absent values are null.

    Raises ValueError if a row has a column that the table has not: a figure would be lost silently.
    """
    # Not by way of Arrow, which loads pandas, where it is installed, with its first array.
    return pl.DataFrame(
        _known(rows, table.name, table.schema), schema=table.schema, orient="row", strict=True
    )


def staged_table(table: Table, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Return same in Arrow, without the run: many rows of many columns take a quarter of the time.

    Raises ValueError or TypeError for a column that the table has not, or a value that a column
    cannot hold.
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
    """Return the rows, which have no other columns than these."""
    every = list(rows)
    strangers = set().union(*every) - set(columns)
    if strangers:
        raise ValueError(f"{table} has no column {', '.join(sorted(strangers))}")
    return every


def data_dictionary() -> pl.DataFrame:
    """Return the table `data_dictionary`: every column of every table."""
    return frame(
        DATA_DICTIONARY,
        [
            {
                "table": table.name,
                "column": column.name,
                "type": str(column.type if isinstance(column.type, pl.DataType) else column.type()),
                "unit": column.unit,
                "description": column.description,
            }
            for table in TABLES
            for column in table.columns
        ],
    )


def model_verdict(lack_of_fit: float) -> ModelVerdict:
    """Return verdict on a model by its lack of fit."""
    if lack_of_fit <= SUPPORTED:
        return "supported"
    return "doubtful" if lack_of_fit <= DOUBTFUL else "disproved"


def agreed_lag(fits: Iterable[Mapping[str, Any]]) -> tuple[float, float] | None:
    """Return the lag [s] that nights agree on and its gain [%], medians; None: they do not.

    `fits` are the deciding nights' rows of `fits`.
    """
    rows = list(fits)
    lags = [row["drain_lag_s"] for row in rows]
    if not rows or None in lags:
        return None
    lag, gain = median(lags), median(row["drain_lag_gain_percent"] for row in rows)
    agree = max(abs(other - lag) for other in lags) <= AGREEING_S
    return (round(lag, 2), gain) if agree and lag > 0.0 and gain >= LEAST_GAIN_PERCENT else None

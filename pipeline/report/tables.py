"""The published tables as the report reads them: a night's rows of all motors, or all nights'.

A file that is damaged costs its own rows and is named; one of a newer version of the program ends
the report.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from pipeline.errors import StoreError
from pipeline.report.explain import EXPLAINED
from pipeline.schema import (
    FIT_KEY_NAMES,
    FITS,
    PREDICTIONS,
    RUNS,
    TREND_TABLES,
    Table,
    frame,
)
from pipeline.store.tables import files_of, read_table
from pipeline.trends.nights.decisions import Decision, read_decisions

# Tables of a night that its page shows.
SHOWN_TABLES = (*EXPLAINED, PREDICTIONS)


@dataclass(frozen=True, slots=True)
class Read:
    """Rows, and in words which files could not be read."""

    rows: pl.DataFrame
    faults: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportTables:
    """All nights of all motors."""

    fits: pl.DataFrame  # the primary fit of each motor and night, sorted by motor and night
    # Tables of trends and alarms by name, as far as they are there.
    trends: Mapping[str, pl.DataFrame] = field(default_factory=dict)
    decisions: tuple[Decision, ...] = ()  # acknowledgements, findings and resets, the oldest first
    fleet: str = ""  # name of the fleet in the newest run; empty where there is none
    faults: tuple[str, ...] = ()  # files that could not be read, in words

    def rows(self, table: Table) -> pl.DataFrame:
        """All rows of a table of trends or alarms; none where it is not there."""
        return self.trends.get(table.name, frame(table, []))


def read_night(output: Path, night: dt.date) -> dict[str, Read]:
    """Rows of one night by table, sorted by key; of fits' child tables those of primary fits.

    Raises StoreError if a file is of a newer version of the program.
    """
    found: dict[str, Read] = {}
    for table in SHOWN_TABLES:
        found[table.name] = _read(output, table, nights=[night])
    fits = found["fits"].rows
    if fits["is_primary"].all():
        return found
    primary = fits.filter("is_primary").select(FIT_KEY_NAMES)
    return {
        name: Read(_children(read.rows, primary), read.faults) if name != "fits" else read
        for name, read in found.items()
    }


def _children(rows: pl.DataFrame, fits: pl.DataFrame) -> pl.DataFrame:
    """Rows that belong to some fits; all rows of a table that has no key of fits."""
    if not set(FIT_KEY_NAMES) <= set(rows.columns):
        return rows
    return rows.join(fits, on=FIT_KEY_NAMES, how="semi", maintain_order="left")


def read_tables(output: Path) -> ReportTables:
    """All that is known of all nights, but for what only one night's figures need.

    Raises StoreError if a file is of a newer version of the program.
    """
    fits = _read(output, FITS)
    runs = _read(output, RUNS, ["started_at", "fleet"])
    trends = {table.name: _read(output, table) for table in TREND_TABLES}
    newest = runs.rows.sort("started_at").get_column("fleet").drop_nulls()
    return ReportTables(
        fits=fits.rows.filter("is_primary").sort("motor_id", "night"),
        trends={name: read.rows for name, read in trends.items() if read.rows.height},
        decisions=read_decisions(output),
        fleet=newest[-1] if len(newest) else "",
        faults=tuple(fault for read in (fits, runs, *trends.values()) for fault in read.faults),
    )


def by_motor(rows: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Rows of a table by motor."""
    return {part["motor_id"][0]: part for part in rows.partition_by("motor_id")}


def _read(
    output: Path,
    table: Table,
    columns: Sequence[str] | None = None,
    nights: Sequence[dt.date] | None = None,
) -> Read:
    """Rows of a table one below the other; damaged files are left out and named."""
    paths = files_of(output, table, nights)
    columns = list(table.schema) if columns is None else columns

    def part(path: Path) -> pl.DataFrame | str:
        try:
            return read_table(path, table, nights, columns)
        except StoreError as error:
            if error.code != "store_read":
                raise
            return error.message

    parts = [part(path) for path in paths]
    empty = pl.DataFrame(schema=table.schema).select(columns)
    frames = [found for found in parts if isinstance(found, pl.DataFrame)]
    faults = tuple(found for found in parts if isinstance(found, str))
    return Read(_finite(pl.concat([empty, *frames])), faults)


def _finite(rows: pl.DataFrame) -> pl.DataFrame:
    """NaN and infinity as null: no page can show them, and JSON has none."""
    floats = [name for name, kind in rows.schema.items() if kind == pl.Float64]
    return rows.with_columns(
        pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name)
        for name in floats
        if not rows[name].is_finite().all()
    )

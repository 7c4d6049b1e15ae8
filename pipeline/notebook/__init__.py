"""For notebooks: samples cleaned as the nightly run does, and published tables.

Imports `leakage`, `logs`, `store`, `night`, `ingest`'s contract, `config` and `schema`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import polars as pl

from pipeline.errors import UsageError
from pipeline.notebook.preparing import Prepared, fit_periods, prepare, prepare_log
from pipeline.schema import TABLES
from pipeline.store.tables import existing_tables, files_of

__all__ = [
    "Prepared",
    "Tables",
    "fit_periods",
    "open_tables",
    "prepare",
    "prepare_log",
]


@dataclass(frozen=True, slots=True)
class Tables:
    """The published tables of an output folder."""

    output: Path

    def table(self, name: str) -> pl.LazyFrame:
        """Return a table by name; columns that an older file lacks are null.

        Raises UsageError (``unknown_table``) if there is none of this name.
        """
        known = {table.name: table for table in TABLES}
        if name not in known:
            raise UsageError("unknown_table", f"no table {name}; there are {', '.join(known)}")
        schema = known[name].schema
        paths = files_of(self.output, known[name])
        if not paths:
            return pl.LazyFrame(schema=schema)
        return pl.scan_parquet(
            paths,
            schema=schema,
            missing_columns="insert",
            extra_columns="ignore",
            hive_partitioning=False,
        )

    def fits(self) -> pl.LazyFrame:
        """Return the primary fit of each motor and night."""
        return self.table("fits").filter("is_primary").sort("motor_id", "night")

    def nights(self) -> pl.LazyFrame:
        """Return the nights of all motors."""
        return self.table("nights").sort("motor_id", "night")


def open_tables(output: Path | str) -> Tables:
    """Open the published tables of an output folder.

    Raises UsageError (``no_tables``) if there are none.
    """
    tables = Tables(Path(output))
    existing_tables(tables.output)
    return tables

"""Published tables of a fleet, lazily as frames of Polars."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import polars as pl

from pipeline.errors import StoreError, UsageError
from pipeline.schema import ALARMS, FITS, LATEST, TABLES, TRENDS, WATCH
from pipeline.store.published import faults_of
from pipeline.store.tables import existing_tables, files_of


@dataclass(frozen=True, slots=True)
class Tables:
    """The published tables of an output folder."""

    output: Path

    def table(self, name: str) -> pl.LazyFrame:
        """A table by name, whole; columns that an older file lacks are null.

        Raises
        ------
        UsageError
            ``unknown_table``: there is none of this name.
        """
        known = {table.name: table for table in TABLES}
        if name not in known:
            raise UsageError("unknown_table", f"no table {name}; there are {', '.join(known)}")
        table = known[name]
        if not (paths := files_of(self.output, table)):
            return pl.LazyFrame(schema=table.schema)
        return pl.scan_parquet(
            paths,
            schema=table.schema,
            missing_columns="insert",
            extra_columns="ignore",
            hive_partitioning=False,
        )

    def fits(self) -> pl.LazyFrame:
        """The primary fit of each motor and night."""
        return self.table(FITS.name).filter("is_primary").sort("motor_id", "night")

    def watch(self, motor_id: str) -> pl.LazyFrame:
        """What is told of a motor, in order of nights."""
        return self.table(WATCH.name).filter(motor_id=motor_id).sort("night")

    def trend(self, motor_id: str, indicator: str) -> pl.LazyFrame:
        """The course of an indicator of a motor, in order of nights."""
        here = (pl.col("motor_id") == motor_id) & (pl.col("indicator") == indicator)
        return self.table(TRENDS.name).filter(here).sort("night")

    def alarms(self) -> pl.LazyFrame:
        """All changes of state, in order of nights."""
        return self.table(ALARMS.name).sort("night", "motor_id", "indicator")

    def latest(self) -> pl.LazyFrame:
        """The table `latest`, a row a motor."""
        return self.table(LATEST.name)

    def verify(self) -> None:
        """Compare every file with the checksum under which it was published.

        Raises
        ------
        StoreError
            ``store_read``: a file is not what was published.
        """
        faults = faults_of(self.output, None)
        if faults:
            told = "; ".join(f"{fault.path}: {fault.message}" for fault in faults)
            raise StoreError("store_read", told)


def open_tables(output: Path | str, *, verify: bool = False) -> Tables:
    """Open the published tables of a fleet; `motor-leakage pull` brings those of an object store.

    Parameters
    ----------
    output
        The output folder.
    verify
        Compare every file with its checksum first.

    Raises
    ------
    UsageError
        ``no_tables``: there are none.
    StoreError
        If a file is not what was published.
    """
    tables = Tables(Path(output))
    existing_tables(tables.output)
    if verify:
        tables.verify()
    return tables

"""Write nights of a database as Parquet logs, which `fit-fleet` reads as any other: a file a motor.

    python nights_to_parquet.py plant.db logs --since 2026-01-02 --until 2026-01-04

Without days: the last nights that are over. Adapt `connect`, `QUERY` and the hour; the same rows
make the same bytes, so that a night is fitted anew only if its rows changed.
"""

from __future__ import annotations

import argparse
import datetime as dt
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl

# Each connection of Python's DB-API has its own mark in the place of `?`, such as `%s`.
QUERY = "SELECT * FROM log WHERE time >= ? AND time < ? ORDER BY motor, time"
MOTOR = "motor"  # the column of the motor's name
NIGHT_ENDS = dt.time(6, tzinfo=dt.UTC)  # as `[nights]` of the fleet has it
DAY = dt.timedelta(days=1)
# Rows may come late: so many nights are written again.
LOOK_BACK = 3 * DAY


def connect(database: str) -> Any:
    """A connection: of `psycopg`, `pyodbc`, `adbc_driver_postgresql.dbapi`, … instead."""
    return sqlite3.connect(database)


def write_night(connection: Any, folder: Path, night: dt.date) -> None:
    """Write the night that ends on a day, `folder/<motor>/<night>.parquet`, each file whole."""
    end = dt.datetime.combine(night, NIGHT_ENDS)
    borders = [(end - DAY).isoformat(" "), end.isoformat(" ")]
    rows = pl.read_database(
        QUERY, connection, execute_options={"parameters": borders}, infer_schema_length=None
    )
    for (motor,), own in rows.partition_by(MOTOR, as_dict=True, include_key=False).items():
        path = folder / str(motor) / f"{night}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        own.write_parquet(path.with_suffix(".part"))
        path.with_suffix(".part").replace(path)


def nights(since: dt.date, until: dt.date) -> Iterator[dt.date]:
    """Nights from one to another, both included."""
    while since <= until:
        yield since
        since += DAY


def main() -> None:
    """Write the nights that are asked for."""
    now = dt.datetime.now(dt.UTC)
    over = now.date() if now.timetz() >= NIGHT_ENDS else now.date() - DAY
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--since", type=dt.date.fromisoformat, default=over - LOOK_BACK)
    parser.add_argument("--until", type=dt.date.fromisoformat, default=over)
    asked = parser.parse_args()
    connection = connect(asked.database)
    for night in nights(asked.since, asked.until):
        write_night(connection, asked.folder, night)
    connection.close()


if __name__ == "__main__":
    main()

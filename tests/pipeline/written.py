"""Rows of nights as the files of a table, and what the state file of an output remembers."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.logs.processed import ProcessedLogs, read_processed
from pipeline.schema import Table
from pipeline.store.atomic_files import put
from pipeline.store.published import note
from pipeline.store.publishing import Publisher
from pipeline.store.state import STATE_FILE, open_state
from pipeline.store.tables import as_parquet, label_of, labelled_file, name_of
from pipeline.trends.tasks import Record, read_records


def night_file(output: Path, table: Table, night: dt.date) -> Path:
    """The file that has a night."""
    return labelled_file(output, table, label_of(table, night))


def write_table(path: Path, rows: pl.DataFrame) -> None:
    """A table file that the state file does not list."""
    put(path, as_parquet(rows))


@contextmanager
def publisher_of(
    output: Path, run_id: str = "r", staging: Path | None = None
) -> Iterator[Publisher]:
    """A publisher with the state of an output."""
    with open_state(output) as state:
        yield Publisher(state, staging or output / "staging" / "run", run_id)


def write_nights(output: Path, table: Table, rows: pl.DataFrame) -> None:
    """Publish rows in the files of their nights, in place of all that these nights have there."""
    files: defaultdict[Path, list[pl.DataFrame]] = defaultdict(list)
    for (night,), part in rows.partition_by("night", as_dict=True).items():
        files[night_file(output, table, night)].append(part)
    listed: dict[str, str | None] = {}
    for path, parts in files.items():
        new = pl.concat(parts)
        if path.exists():
            before = pl.read_parquet(path, hive_partitioning=False)
            kept = before.filter(~pl.col("night").is_in(new["night"].unique().implode()))
            new = pl.concat([kept, new], how="diagonal")
        write_table(path, new.sort(table.order))
        listed[name_of(output, path)] = None
    with open_state(output) as state:
        note(state, listed)


# Files and folders of an output that outlive a run.
LASTING = {*("tables", "lock", "heartbeat.json", "views.sql", STATE_FILE)}


def processed_of(output: Path, motor_id: str = "M1") -> ProcessedLogs:
    """Record of processed logs of a motor."""
    with open_state(output) as state:
        return read_processed(state, motor_id)


def record_of(output: Path, motor_id: str = "M1") -> Record | None:
    """Record of a motor's trends."""
    with open_state(output) as state:
        return read_records(state).get(motor_id)


def change(output: Path, statement: str, *values: Any) -> None:
    """Change something of what is remembered."""
    with open_state(output) as state:
        state.write(statement, *values)

"""Staged rows: what a motor's task leaves in a file for the run to publish.

In its first line the file has an index: of each table file that rows go into the nights, also those
without rows, which replace rows of before. An Arrow stream each follows.
"""

from __future__ import annotations

import datetime as dt
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from pathlib import Path

import polars as pl
import pyarrow as pa

from pipeline.errors import StoreError
from pipeline.schema import Table, staged_table
from pipeline.store.tables import label_of

# Rows of one table, by night.
StagedNights = Mapping[dt.date, Sequence[Mapping[str, object]]]


@dataclass(frozen=True, slots=True)
class Staged:
    """Staged rows of a motor that go into one table file, not read yet."""

    path: Path
    begin: int
    size: int
    nights: tuple[dt.date, ...]

    def rows(self) -> pa.Table:
        """The rows; the file is open only while it is read: a fleet has many."""
        with self.path.open("rb") as file:
            file.seek(self.begin)
            return pa.ipc.open_stream(file.read(self.size)).read_all()


def stage(path: Path, tables: Mapping[Table, StagedNights]) -> None:
    """Write a motor's rows by table and night; the folder above the file's must be there.

    Raises StoreError if they cannot be written.
    """
    streams, index = [], []
    for table, nights in tables.items():
        for label, some in groupby(sorted(nights), partial(label_of, table)):
            own = list(some)
            rows = staged_table(table, chain.from_iterable(nights[night] for night in own))
            sink = pa.BufferOutputStream()
            with pa.ipc.new_stream(sink, rows.schema) as stream:
                stream.write_table(rows)
            streams.append(sink.getvalue())
            index.append((table.name, label, streams[-1].size, [str(night) for night in own]))
    line = json.dumps(index).encode() + b"\n"
    try:
        with suppress(FileExistsError):
            path.parent.mkdir()
        path.write_bytes(b"".join([line, *streams]))
    except OSError as error:
        raise StoreError("store_write", f"rows cannot be staged: {error}") from error


def staged_in(
    folder: Path, tables: Iterable[Table], motor_ids: Collection[str]
) -> Mapping[tuple[Table, str], Mapping[str, Staged]]:
    """What some motors have staged, by table, name of the table file, and motor, in order."""
    named = {table.name: table for table in tables}
    found: defaultdict[tuple[Table, str], dict[str, Staged]] = defaultdict(dict)
    paths = {motor_id: staged_file(folder, motor_id) for motor_id in sorted(motor_ids)}
    for motor_id, path in paths.items():
        if not path.exists():
            continue
        with path.open("rb") as file:
            index, begin = json.loads(file.readline()), file.tell()
        for name, label, size, nights in index:
            own = Staged(path, begin, size, tuple(map(dt.date.fromisoformat, nights)))
            found[named[name], label][motor_id] = own
            begin += size
    return found


def staged_file(folder: Path, motor_id: str) -> Path:
    """File of a motor's staged rows."""
    return folder / f"{motor_id}.arrow"


def read_staged(
    table: Table, staged: Mapping[str, Staged], run_id: str
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Rows of motors for a table file, and the motors and nights of which they are all rows."""
    # As one chunk: Polars takes chunks over one by one.
    rows = pl.from_arrow(pa.concat_tables(one.rows() for one in staged.values()).combine_chunks())
    assert isinstance(rows, pl.DataFrame)
    pa.default_memory_pool().release_unused()  # the motors' own copies
    rows = rows.with_columns(run_id=pl.lit(run_id)).select(table.schema.keys())
    done = [(motor_id, night) for motor_id, one in staged.items() for night in one.nights]
    key = {name: table.schema[name] for name in ("motor_id", "night")}
    return rows, pl.DataFrame(done, schema=key, orient="row")

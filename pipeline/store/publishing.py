"""Rows on their way into tables: staged by the tasks of motors, published by the run.

A task leaves its rows in a file: a line with an index, then an Arrow stream for each table file.
Month by month the run writes new table files beside their places, notes them as coming, renames
them, and notes them as published in a transaction with what the caller has to say of them.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple

import polars as pl
import pyarrow as pa

from pipeline.errors import StoreError
from pipeline.schema import TABLES, TIMESTAMP, Table, frame, staged_table
from pipeline.store.atomic_files import drop, flush_path, prepare, put, store_errors
from pipeline.store.published import NO_FILE, announce, note, set_aside, verify_file
from pipeline.store.state import StateDatabase
from pipeline.store.tables import (
    ENDING,
    as_parquet,
    damaged,
    files_of,
    from_parquet,
    label_of,
    labelled_file,
    name_of,
    table_folder,
    whole_file,
)

# Views of all tables for DuckDB, and its names of types.
VIEWS = "views.sql"
TYPES = {
    pl.String: "VARCHAR",
    pl.Int64: "BIGINT",
    pl.Float64: "DOUBLE",
    pl.Float32: "FLOAT",
    pl.Boolean: "BOOLEAN",
    pl.Date: "DATE",
    TIMESTAMP: "TIMESTAMPTZ",
}

# Rows of a table, by night.
StagedNights = Mapping[dt.date, Sequence[Mapping[str, object]]]
# Rows of a table file, given those that are there.
Change = Callable[[pl.DataFrame], pl.DataFrame]


@dataclass(frozen=True, slots=True)
class Staged:
    """Staged rows of a motor that go into a table file, not read yet."""

    path: Path
    begin: int
    size: int
    nights: tuple[dt.date, ...]

    def rows(self) -> pa.Table:
        """Return the rows; the file is open only while it is read: a fleet has many."""
        with self.path.open("rb") as file:
            file.seek(self.begin)
            return pa.ipc.open_stream(file.read(self.size)).read_all()


def stage(path: Path, tables: Mapping[Table, StagedNights]) -> None:
    """Write a motor's rows by table and night; the folder above the file's must be there."""
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
    """Return what some motors have staged, by table, name of the table file and motor, in order."""
    named = {table.name: table for table in tables}
    staged: defaultdict[tuple[Table, str], dict[str, Staged]] = defaultdict(dict)
    paths = {motor_id: staged_file(folder, motor_id) for motor_id in sorted(motor_ids)}
    for motor_id, path in paths.items():
        if not path.exists():
            continue
        with path.open("rb") as file:
            index, begin = json.loads(file.readline()), file.tell()
        for name, label, size, nights in index:
            own = Staged(path, begin, size, tuple(map(dt.date.fromisoformat, nights)))
            staged[named[name], label][motor_id] = own
            begin += size
    return staged


def staged_file(folder: Path, motor_id: str) -> Path:
    """Return file of a motor's staged rows."""
    return folder / f"{motor_id}.arrow"


def read_staged(
    table: Table, staged: Mapping[str, Staged], run_id: str
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return rows of motors for a table file, and motors and nights of which they are all rows."""
    # As a single chunk: Polars takes chunks over singly.
    rows = pl.from_arrow(pa.concat_tables(part.rows() for part in staged.values()).combine_chunks())
    assert isinstance(rows, pl.DataFrame)
    pa.default_memory_pool().release_unused()  # the motors' own copies
    rows = rows.with_columns(run_id=pl.lit(run_id)).select(table.schema.keys())
    done = [(motor_id, night) for motor_id, part in staged.items() for night in part.nights]
    key = {name: table.schema[name] for name in ("motor_id", "night")}
    return rows, pl.DataFrame(done, schema=key, orient="row")


class NewFile(NamedTuple):
    """A table file as it comes to be; without a temporary file where it stays."""

    path: Path
    sha256: str | None  # None if there is neither a file nor a row
    temporary: Path | None = None


@dataclass(slots=True)
class Publisher:
    """Publishes the rows that the tasks of a run have staged."""

    state: StateDatabase
    staging: Path  # the run's folder of staged rows
    run_id: str  # goes into every row

    def nights(
        self,
        folder: str,
        tables: Iterable[Table],
        motor_ids: Collection[str],
        published: Callable[[], object] = lambda: None,
    ) -> None:
        """Publish what motors have staged; `published` is called as the last files are noted.

        Raises StoreError if a file cannot be written, or the present file is damaged.
        """
        staged = staged_in(self.staging / folder, tables, motor_ids)
        months = sorted({label[:7] for _, label in staged})
        self._vacate(staged)
        for month in months:
            keys = [key for key in staged if key[1][:7] == month]
            files = (self._with_staged(*key, staged[key]) for key in keys)
            self._publish(files, published if month == months[-1] else lambda: None)
        if not months:
            with self.state.transaction():
                published()
        # Of no further use: what is not on the disk yet need not be written to it.
        rmtree(self.staging / folder, ignore_errors=True)

    def whole(self, table: Table, rows: pl.DataFrame) -> None:
        """Publish a table that is a single file, whatever is there."""
        path = whole_file(self.state.output, table)
        before = verify_file(self.state, name_of(self.state.output, path)).sha256
        self._publish([_new_file(path, rows, before)])

    def add(self, month: str, rows: Mapping[Table, Sequence[Mapping[str, Any]]]) -> None:
        """Add rows to a month (YYYY-MM) of tables; those of the same key go."""
        self._publish(
            self._changed(table, month, partial(_with_rows, table, frame(table, some)))
            for table, some in rows.items()
        )

    def change(self, table: Table, label: str, change: Change) -> None:
        """Change the rows of a table file, if any are others."""
        self._publish([self._changed(table, label, change)])

    def _with_staged(self, table: Table, label: str, staged: Mapping[str, Staged]) -> NewFile:
        """Return the file with the staged rows that go into it."""
        rows, done = read_staged(table, staged, self.run_id)
        return self._changed(table, label, partial(_with_rows, table, rows, replaced=done))

    def _vacate(self, staged: Mapping[tuple[Table, str], Mapping[str, Staged]]) -> None:
        """Remove rows that move to another month first: no key is ever in two files."""
        moving = {key: files for key, files in staged.items() if "night" not in key[0].key}
        if len(moving) < 2:
            return
        keys = {
            (table, label): read_staged(table, files, "")[0].select(table.key)
            for (table, label), files in moving.items()
        }
        for table, label in sorted(keys, key=lambda key: key[1]):
            others = pl.concat(some for key, some in keys.items() if key != (table, label))
            self.change(table, label, partial(_with_rows, table, frame(table, []), replaced=others))

    def _changed(self, table: Table, label: str, change: Change) -> NewFile:
        """Return a file with other rows; none are added to a damaged file."""
        path = labelled_file(self.state.output, table, label)
        file = verify_file(self.state, name_of(self.state.output, path))
        if file.fault is not None:
            if file.fault.code == "table_altered":
                set_aside(self.state, file.name)
            raise damaged(path, table, file.fault.message)
        if file.sha256 is None:
            return _new_file(path, change(frame(table, [])), NO_FILE)
        return _new_file(path, change(from_parquet(path, table, file.content)), file.sha256)

    def _publish(
        self, files: Iterable[NewFile], published: Callable[[], object] = lambda: None
    ) -> None:
        """Prepare files, put them into their places, and note them before and afterwards."""
        digests: dict[str, str | None] = {}
        temporaries: dict[Path, Path] = {}
        try:
            for file in files:
                digests[name_of(self.state.output, file.path)] = file.sha256
                if file.temporary is not None:
                    temporaries[file.path] = file.temporary
            names = [name_of(self.state.output, path) for path in temporaries]
            announce(self.state, {name: digests[name] for name in names})
            for path, temporary in temporaries.items():
                with store_errors(path):
                    temporary.replace(path)
            for folder in sorted({path.parent for path in temporaries}):
                with store_errors(folder):
                    flush_path(folder)
            with self.state.transaction():
                note(self.state, digests)
                published()
        except BaseException:
            for temporary in temporaries.values():
                drop(temporary)
            raise


def _new_file(path: Path, rows: pl.DataFrame, before: str | None) -> NewFile:
    """Return a file with some rows; where none is there, and none is to come, none is made."""
    if before == NO_FILE and rows.is_empty():
        return NewFile(path, None)
    content = as_parquet(rows)
    digest = hashlib.sha256(content).hexdigest()
    return NewFile(path, digest, None if digest == before else prepare(path, content))


def _with_rows(
    table: Table, rows: pl.DataFrame, present: pl.DataFrame, replaced: pl.DataFrame | None = None
) -> pl.DataFrame:
    """Return rows there with new ones, in place of those of the same key and of some others."""
    before, within, after = present.clear(), present, present.clear()
    if replaced is not None and "night" in table.key:
        # Other nights lie before and after them, and are neither copied nor sorted.
        span = [pl.col("night").min().alias("first"), pl.col("night").max().alias("last")]
        first, last = replaced.select(span).row(0)
        begin = present["night"].search_sorted(first, "left")
        end = present["night"].search_sorted(last, "right")
        before, within, after = present[:begin], present[begin:end], present[end:]
    within = within.join(rows, on=list(table.key), how="anti")
    if replaced is not None:
        within = within.join(replaced, on=replaced.columns, how="anti")
    return pl.concat([before, pl.concat([within, rows]).sort(table.order), after])


def write_views(output: Path) -> None:
    """Write `views.sql`, with paths relative to its folder.

    Raises StoreError if it cannot be written.
    """
    head = f"-- Views of all tables; made by each run. In this folder: duckdb -init {VIEWS}\n"
    tables = (_view(output, table) for table in TABLES)
    text = "\n".join([head, *tables, *_comments()]) + "\n"
    if not (output / VIEWS).exists() or (output / VIEWS).read_text("utf-8") != text:
        put(output / VIEWS, text.encode())


def _view(output: Path, table: Table) -> str:
    """Return statement that makes a table's view; a table without a file yet has no rows."""
    files = f"{table_folder(Path(), table).as_posix()}/**/*{ENDING}"
    how = "union_by_name = true, hive_partitioning = false"
    rows = f"SELECT * FROM read_parquet('{files}', {how})"
    if not files_of(output, table):
        columns = ", ".join(f"NULL::{kind} AS {name}" for name, kind in _columns(table))
        rows = f"SELECT {columns} WHERE false"
    return f"CREATE OR REPLACE VIEW {table.name} AS {rows};"


def _columns(table: Table) -> Iterator[tuple[str, str]]:
    """Yield columns of a table with DuckDB's names of their types."""
    for name, kind in table.schema.items():
        yield f'"{name}"', _type(kind)


def _type(kind: object) -> str:
    if isinstance(kind, pl.List):
        return f"{_type(kind.inner)}[]"
    if isinstance(kind, pl.Struct):
        return f"STRUCT({', '.join(f'{field.name} {_type(field.dtype)}' for field in kind.fields)})"
    return next(text for known, text in TYPES.items() if kind == known)


def _comments() -> Iterator[str]:
    """Yield statements with the words of the dictionary, for views that are there."""
    for table in TABLES:
        yield f"COMMENT ON VIEW {table.name} IS {_text(f'One row is {table.row}')};"
        for column in table.columns:
            unit = f" [{column.unit}]" if column.unit else ""
            words = _text(f"{column.description}{unit}")
            yield f'COMMENT ON COLUMN {table.name}."{column.name}" IS {words};'


def _text(words: str) -> str:
    """Return a text of SQL."""
    return "'" + words.replace("'", "''") + "'"

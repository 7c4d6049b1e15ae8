"""Nights of a database as Parquet files, from which they are then read as any log is.

A night is a file, written as its rows come and put in its place whole. A file is never replaced by
the same rows, so that a night is made anew only if its rows changed.
"""

from __future__ import annotations

import datetime as dt
import filecmp
import json
import logging
from bisect import bisect_left
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.clock import FARTHEST_AHEAD, MICROSECOND, latest_us, utc
from pipeline.config import MotorSpec
from pipeline.config.hashes import hash_of
from pipeline.config.logs import END, START, Database, Logs
from pipeline.config.nights import DAY, Night, night, night_of, nights_between
from pipeline.errors import LogError
from pipeline.ingest import LogFile
from pipeline.logs.database import SLOW, Connection, DatabaseError
from pipeline.store.atomic_files import prepare, put
from pipeline.workers.process import reading

log = logging.getLogger(__name__)

# What is known of a motor's nights, beside them.
RECORD = "landed.json"
# Codes that are of one night; after another the next would fail as well.
OF_A_NIGHT = (SLOW, "database_rows")


def land_nights(spec: MotorSpec, latest: int, silent: Collection[str] = ()) -> dict[str, LogError]:
    """Ask for the nights of a motor that are over and due, and write each to a file.

    Returns the errors of nights that had no answer yet, by name of the file that is missing. The
    queries of the `silent` files did not end in time; they end the asking.

    Raises StoreError (``store_write``) if a file cannot be written.
    """
    database, record = _database(spec), spec.log_root / RECORD
    last = night_of(latest - FARTHEST_AHEAD // MICROSECOND, spec.settings.nights) - DAY
    source = _source(spec)
    answered = _answered(record, source)
    again = last - database.look_back_days * DAY
    due = [
        label
        for label in nights_between(database.begin, last)
        if label >= again or str(label) not in answered
    ]
    faults: dict[str, LogError] = {}
    with Connection(database, spec.file.logs.time_zone) as connection:
        for label in sorted(due, key=lambda label: (str(label) in answered, label)):
            fault = _fault_of(connection, spec, label, silent)
            if fault is None:
                if str(label) not in answered:
                    answered.add(str(label))
                    found = {"source": source, "answered": sorted(answered)}
                    put(record, json.dumps(found, indent=0).encode())
            elif str(label) in answered:
                words = "%s: %s; what was read of this night before stays"
                log.warning(words, spec.motor_id, fault.message)
                break
            else:
                faults[file_name(label)] = fault
                if fault.code not in OF_A_NIGHT:
                    break
    return faults


def _answered(record: Path, source: str) -> set[str]:
    """Nights that had an answer from a source."""
    try:
        found = json.loads(record.read_bytes())
        if found["source"] == source:
            return set(found["answered"])
    except (OSError, ValueError, TypeError, KeyError):
        pass  # without a record all nights are asked for, and files with the same rows stay
    return set()


def _source(spec: MotorSpec) -> str:
    """Hash of all that says which rows are those of a night."""
    nights = spec.settings.nights.model_dump(mode="json")
    return hash_of({"query": nightly_query(spec), "zone": spec.file.logs.time_zone, **nights})


def _fault_of(
    connection: Connection, spec: MotorSpec, label: dt.date, silent: Collection[str]
) -> LogError | None:
    """Land a night; its fault, where it had no answer."""
    name = file_name(label)
    if name in silent:
        return LogError("log_no_answer", Path(name), "its query did not end in time")
    try:
        with reading(name):
            _land(connection, spec, label)
    except DatabaseError as error:
        return LogError(error.code, Path(name), error.message)
    return None


def land_newest(spec: MotorSpec, most: int) -> bool:
    """Write the newest nights with rows, the present one too; False where there are none.

    Raises
    ------
    StoreError
        If a file cannot be written; a `DatabaseError` without an answer.
    """
    database, nights = _database(spec), spec.settings.nights
    with Connection(database, spec.file.logs.time_zone) as connection:
        labels = nights_between(database.begin, night_of(latest_us(), nights))
        windows = [night(label, nights) for label in labels]
        there = nights_with_rows(connection, nightly_query(spec), windows)
        for place in there[-most:]:
            _land(connection, spec, labels[place])
    return bool(there)


def nights_with_rows(connection: Connection, sql: str, nights: Sequence[Night]) -> range:
    """Places of the first night of a query that has rows, to the last; an empty range: none has."""

    def has_rows(first: int, last: int) -> bool:
        rows = between(sql, nights[first].start_us, nights[last].end_us)
        asked = f"SELECT EXISTS (SELECT FROM (\n{rows}\n) AS log)"
        return connection.ask(asked, lambda batches, _: any(one[0][0].as_py() for one in batches))

    places = range(len(nights))
    end = bisect_left(places, True, key=lambda place: not has_rows(place, -1))
    return range(bisect_left(places[:end], True, key=lambda place: has_rows(0, place)), end)


def file_name(label: dt.date) -> str:
    """Name of a night's file."""
    return f"{label}.parquet"


def nightly_query(spec: MotorSpec) -> str:
    """The query of a motor: its columns, rows and tags of the config's one, in order of time."""
    # Imported where it is needed: few motors have a database.
    from pipeline.ingest.table import wanted_columns

    logs = spec.file.logs
    channels = {name: one for name, one in spec.file.channels.items() if one.constant is None}
    columns = wanted_columns(LogFile(Path(), logs, channels)).all
    order = ", ".join(str(place) for place in range(1, len(columns) + 1))
    return (
        f"SELECT {', '.join(map(identifier, columns))} FROM (\n{_database(spec).query}\n) AS log"
        f"{_rows_of(logs, [one.source for one in channels.values()])} ORDER BY {order}"
    )


def _rows_of(logs: Logs, tags: Sequence[str]) -> str:
    """Condition on the rows: those of the motor, and in a long table of tags that are used."""
    own = []
    if logs.layout == "long":
        texts = ", ".join(map(_text, dict.fromkeys(tags)))
        own.append(f"{identifier(logs.channel_column)} IN ({texts})")
    if logs.motor_column:
        own.append(f"{identifier(logs.motor_column)} = {_text(logs.motor_name)}")
    return f" WHERE {' AND '.join(own)}" if own else ""


def identifier(name: str) -> str:
    """A name in a query."""
    return '"' + name.replace('"', '""') + '"'


def _text(value: str) -> str:
    """A text in a query; a backslash is no escape in it."""
    return "'" + value.replace("'", "''") + "'"


def between(sql: str, start_us: int, end_us: int) -> str:
    """A query with the borders of a night in the place of the marks."""
    return sql.replace(START, _stamp(start_us)).replace(END, _stamp(end_us))


def _stamp(time_us: int) -> str:
    return f"TIMESTAMPTZ '{utc(time_us)}'"


def _database(spec: MotorSpec) -> Database:
    database = spec.file.logs.database
    assert database is not None
    return database


def _land(connection: Connection, spec: MotorSpec, label: dt.date) -> None:
    """Write a night's rows to its file, unless it holds them already, or there are none."""
    here, path = night(label, spec.settings.nights), spec.log_root / file_name(label)

    def write(batches: Iterator[pa.RecordBatch], schema: pa.Schema) -> None:
        rows = 0

        def write_to(stream: BinaryIO) -> None:
            nonlocal rows
            rows = write_parquet(batches, schema, stream)

        found = prepare(path, write_to)
        if rows == 0 or (path.exists() and filecmp.cmp(found.temporary, path, shallow=False)):
            found.drop()
        else:
            found.land()

    connection.ask(between(nightly_query(spec), here.start_us, here.end_us), write)


def write_parquet(batches: Iterator[pa.RecordBatch], schema: pa.Schema, stream: BinaryIO) -> int:
    """Write rows of a database as Parquet, a row group a batch; returns how many there are."""
    rows = 0
    fields = [pa.field(field.name, _required_type(field)) for field in schema]
    with pq.ParquetWriter(stream, pa.schema(fields), compression="zstd") as file:
        for batch in batches:
            columns = map(_stored, batch.columns, file.schema.types)
            file.write_batch(pa.record_batch(list(columns), file.schema))
            rows += batch.num_rows
    return rows


def _required_type(field: pa.Field) -> pa.DataType:
    kind = stored_type(field.type)
    if kind is None:
        message = f"column {field.name!r} is of type {field.type}: convert it in the query"
        raise DatabaseError("database_rows", message)
    return kind


def stored_type(kind: pa.DataType) -> pa.DataType | None:
    """Type of a column in the file; None for one that no log has.

    PostgreSQL's `numeric` comes as text, and is a number.
    """
    if isinstance(kind, pa.OpaqueType):
        return pa.float64() if kind.type_name == "numeric" else None
    return None if pa.types.is_interval(kind) or pa.types.is_nested(kind) else kind


def _stored(column: pa.Array, kind: pa.DataType) -> pa.Array:
    return column if column.type == kind else column.storage.cast(kind)

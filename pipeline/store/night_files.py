"""Staged rows of motors, and the night files made of them.

A motor's task stages its rows in a file of its own; the run then publishes night by night, so that
its memory does not grow with the fleet's history.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import json
import logging
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from math import ceil
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa

from pipeline.errors import StoreError
from pipeline.schema import Table, staged_table
from pipeline.store.atomic_files import Prepared, move, prepare, read, scratch
from pipeline.store.encoding import prepare_table
from pipeline.store.tables import PUT_ASIDE, UNREADABLE, damaged, decode, night_file

log = logging.getLogger(__name__)

# Rows of one table, by night.
StagedNights = Mapping[dt.date, Sequence[Mapping[str, object]]]
# Motors whose staged rows are read together; those of all would fill the memory.
MOTORS_AT_ONCE = 64
# Column for the night under which a row is staged; its own may be absent.
STAGED_NIGHT = "staged night"
# Arrow maps arrays without a copy at multiples of so many bytes; its streams are as long.
ALIGNMENT = 8


class StagedRows:
    """Staged rows of one motor: an index in the first line of a file, then an Arrow stream a table.

    The file is open only while it is read: a fleet has more of them than a process may open.

    Attributes
    ----------
    heights
        By name of a table, its staged nights, in order, with their numbers of rows.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as file:
            index = json.loads(file.readline())
            ends = accumulate((size for size, _ in index.values()), initial=file.tell())
        self._begins = dict(zip(index, ends, strict=False))
        self.heights = {
            name: {dt.date.fromisoformat(night): height for night, height in heights.items()}
            for name, (_, heights) in index.items()
        }

    def between(
        self, table: Table, first: dt.date, last: dt.date
    ) -> tuple[dict[dt.date, int], pa.Table]:
        """Heights of some nights of a table, and their rows."""
        heights = self.heights[table.name]
        chosen = {night: height for night, height in heights.items() if first <= night <= last}
        begin = sum(height for night, height in heights.items() if night < first)
        with pa.memory_map(str(self._path)) as content:
            content.seek(self._begins[table.name])
            with pa.ipc.open_stream(content) as stream:
                return chosen, stream.read_all().slice(begin, sum(chosen.values()))


@dataclass(frozen=True, slots=True)
class NewRows:
    """A run's rows of a night, and the motors that they are of; some have none."""

    motor_ids: tuple[str, ...]
    height: int
    pieces: Iterable[pl.DataFrame]  # the rows, one piece after the other in order of the key


def new_rows(
    table: Table, staged: Mapping[str, StagedRows], nights: Sequence[dt.date], run_id: str
) -> dict[dt.date, NewRows]:
    """Staged rows of some nights of a table; nights that no motor has done are left out.

    The rows of one night are read motors by motors when they are asked for, those of several at
    once.
    """
    motors = {
        night: [one for one in sorted(staged) if night in staged[one].heights[table.name]]
        for night in nights
    }
    pieces: dict[dt.date, Iterable[pl.DataFrame]] = {}
    if len(nights) == 1:
        pieces = {one: _pieces(table, staged, some, one, run_id) for one, some in motors.items()}
    elif staged:
        every = _rows_of_some(table, staged, nights[0], nights[-1], run_id)
        pieces = {night: [rows] for night, rows in every.items()}
    return {
        night: NewRows(
            tuple(some), sum(staged[one].heights[table.name][night] for one in some), pieces[night]
        )
        for night, some in motors.items()
        if some
    }


def _pieces(
    table: Table,
    staged: Mapping[str, StagedRows],
    motor_ids: Sequence[str],
    night: dt.date,
    run_id: str,
) -> Iterator[pl.DataFrame]:
    """Rows of motors in order: keys begin with the motor."""
    for at in range(0, len(motor_ids), MOTORS_AT_ONCE):
        some = {motor_id: staged[motor_id] for motor_id in motor_ids[at : at + MOTORS_AT_ONCE]}
        yield _rows_of_some(table, some, night, night, run_id)[night]


def _rows_of_some(
    table: Table, staged: Mapping[str, StagedRows], first: dt.date, last: dt.date, run_id: str
) -> dict[dt.date, pl.DataFrame]:
    """Rows of motors that are read together: each step costs more a frame than a row."""
    parts = {motor_id: own.between(table, first, last) for motor_id, own in staged.items()}
    heights: Counter[dt.date] = Counter()
    for own, _ in parts.values():
        heights.update(own)
    # As one chunk: Polars takes chunks over one by one.
    every = pl.from_arrow(pa.concat_tables(rows for _, rows in parts.values()).combine_chunks())
    assert isinstance(every, pl.DataFrame)
    labels = [night for own, _ in parts.values() for night in own]
    counts = [height for own, _ in parts.values() for height in own.values()]
    nights = pl.Series(STAGED_NIGHT, np.repeat(np.array(labels, dtype="M8[D]"), counts))
    rows = every.with_columns(nights, run_id=pl.lit(run_id)).sort(STAGED_NIGHT, *table.key)
    rows = rows[list(table.schema)]
    ordered = sorted(heights)
    begins = accumulate((heights[night] for night in ordered), initial=0)
    return {
        night: rows.slice(begin, heights[night])
        for night, begin in zip(ordered, begins, strict=False)
    }


def stage(path: Path, tables: Mapping[Table, StagedNights]) -> None:
    """Write a motor's rows by table and night for the run to publish, nights without rows included.

    Raises StoreError if they cannot be written.
    """
    streams, index = [], {}
    for table, nights in tables.items():
        in_order = sorted(nights)
        rows = staged_table(table, chain.from_iterable(nights[night] for night in in_order))
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, rows.schema) as stream:
            stream.write_table(rows)
        streams.append(sink.getvalue())
        index[table.name] = streams[-1].size, {str(night): len(nights[night]) for night in in_order}
    line = json.dumps(index).encode() + b"\n"
    try:
        with scratch(path) as file:
            file.write(line.rjust(ceil(len(line) / ALIGNMENT) * ALIGNMENT))
            for content in streams:
                file.write(content)
    except OSError as error:
        raise StoreError("store_write", f"rows cannot be staged: {error}") from error


@dataclass(frozen=True, slots=True)
class NightFile:
    """A table file that is prepared, and not in its place yet."""

    path: Path  # its place
    before: str | None  # SHA-256 of the present file; None without one
    after: str | None  # SHA-256 of the new file; None if there is neither a file nor a row
    # True if the present file is damaged or gone: rows of motors that are not published with it
    # have to be made anew.
    lost_rows: bool = False
    prepared: Prepared | None = None  # the new file; None if the present one stays

    def land(self) -> None:
        """Put it into its place, and a damaged file there aside; raises as `Prepared.land`.

        That survives a power cut once its folder is flushed.
        """
        if self.lost_rows and self.before is not None:
            move(self.path, self.path.with_suffix(PUT_ASIDE))
        if self.prepared is not None:
            self.prepared.land(flush=False)

    def drop(self) -> None:
        """Remove the new file; the present one stays."""
        if self.prepared is not None:
            self.prepared.drop()


def prepare_night(
    output: Path,
    table: Table,
    night: dt.date,
    new: NewRows,
    accepted: Collection[str | None] = (),
) -> NightFile:
    """Prepare a night's file with the new rows of some motors; those of the others stay.

    Raises StoreError if the new file cannot be written, or the present one not be read.
    """
    path = night_file(output, table, night)
    before, rows_before = _present(path, table, accepted)
    gone = before is None and bool(accepted) and None not in accepted
    lost_rows = gone or (before is not None and rows_before is None)
    if before is None and not new.height:
        return NightFile(path, None, None, lost_rows)
    pieces = new.pieces
    if rows_before is not None:
        kept = rows_before.filter(~pl.col("motor_id").is_in(new.motor_ids))
        pieces = _merged(kept, pieces, table)
    prepared = prepare_table(path, pieces)
    if prepared.sha256 == before:
        prepared.drop()
        return NightFile(path, before, before)
    return NightFile(path, before, prepared.sha256, lost_rows, prepared)


def _merged(
    kept: pl.DataFrame, pieces: Iterable[pl.DataFrame], table: Table
) -> Iterator[pl.DataFrame]:
    """Rows that stay and new ones, in order of the key, which begins with the motor."""
    for rows in pieces:
        if rows.height:
            is_before = pl.col("motor_id") <= rows["motor_id"][-1]
            yield pl.concat([kept.filter(is_before), rows]).sort(table.key)
            kept = kept.filter(~is_before)
    yield kept


def prepare_file(path: Path, content: bytes) -> NightFile:
    """Prepare a file that replaces the present one as a whole; raises as `prepare`."""
    try:
        before = hashlib.sha256(read(path)).hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        before = None
    except OSError:
        before = UNREADABLE
    after = hashlib.sha256(content).hexdigest()
    return NightFile(
        path, before, after, prepared=None if after == before else prepare(path, content)
    )


def _present(
    path: Path, table: Table, accepted: Collection[str | None]
) -> tuple[str | None, pl.DataFrame | None]:
    """Hash and rows of a night's file; no hash if there is no file, no rows if it is damaged.

    A file is damaged if it reads as such twice: an error on the way from the disk is none.
    """
    for attempt in range(2):
        digest = UNREADABLE
        try:
            content = read(path)
            digest = hashlib.sha256(content).hexdigest()
            if accepted and digest not in accepted:
                raise damaged(path, table, ValueError("it is not what its manifest says"))
            return digest, decode(path, table, content)
        except (FileNotFoundError, NotADirectoryError):
            return None, None
        except OSError as error:
            if error.errno != errno.EIO:
                raise StoreError(
                    "store_read", f"{path.name} of {table.name} cannot be read: {error.strerror}"
                ) from error
            fault = damaged(path, table, error)
        except StoreError as error:
            if error.code != "store_read":
                raise
            fault = error
        if attempt:
            log.warning("%s; it is put aside, and the next run makes that night anew", fault)
    return digest, None

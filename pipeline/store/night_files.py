"""Staged rows of motors, and the files of tables made of them.

A motor's task stages its rows in a file of its own; the run merges them night by night into the
files that are there, so that its memory does not grow with the fleet's history.
"""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import json
import logging
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain
from math import ceil
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa

from pipeline.errors import StoreError
from pipeline.schema import Table, frame, staged_table
from pipeline.store.atomic_files import Prepared, move, read, scratch
from pipeline.store.encoding import prepare_table
from pipeline.store.tables import PUT_ASIDE, damaged, groups_of

log = logging.getLogger(__name__)

# Rows of one table, by night.
StagedNights = Mapping[dt.date, Sequence[Mapping[str, object]]]
# Motors of a night whose staged rows are read together, and cells of a table's nights; all would
# fill the memory.
MOTORS_AT_ONCE = 64
CELLS_AT_ONCE = 2_000_000
# What stands for the hash of a file that cannot be read.
UNREADABLE = "unreadable"
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
) -> Iterator[tuple[dt.date, NewRows]]:
    """Staged rows of some nights of a table in turn; nights that no motor has done are left out.

    Nights with few rows are read together; of one with many the rows are read motors by motors.
    """
    motors = {
        night: [one for one in sorted(staged) if night in staged[one].heights[table.name]]
        for night in sorted(nights)
    }
    heights = {
        night: sum(staged[one].heights[table.name][night] for one in some)
        for night, some in motors.items()
        if some
    }
    for together in _batches(heights, CELLS_AT_ONCE // len(table.schema)):
        first, last = together[0], together[-1]
        rows = {}
        if len(together) > 1:
            rows = _rows_of_some(table, staged, first, last, run_id)
        for night in together:
            ids = motors[night]
            pieces = [rows[night]] if rows else _pieces(table, staged, ids, night, run_id)
            yield night, NewRows(tuple(ids), heights[night], pieces)


def _batches(heights: Mapping[dt.date, int], rows: int) -> Iterator[list[dt.date]]:
    """Nights, as many together as have at most so many rows."""
    batch: list[dt.date] = []
    total = 0
    for night, height in heights.items():
        if batch and total + height > rows:
            yield batch
            batch, total = [], 0
        batch.append(night)
        total += height
    if batch:
        yield batch


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
class NewFile:
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


# The rows of a file, given those of the present one row group by row group.
Change = Callable[[Iterator[pl.DataFrame]], Iterable[pl.DataFrame]]


def prepare_file(
    path: Path, table: Table, change: Change, accepted: Collection[str | None] = ()
) -> NewFile:
    """Prepare a file with changed rows; where none is there, and none is to come, none is made.

    Raises StoreError if the new file cannot be written, or the present one not be read.
    """
    before, content = _present(path, table, accepted)
    gone = before is None and bool(accepted) and None not in accepted
    lost_rows = gone or (before is not None and content is None)
    present = iter(()) if content is None else groups_of(path, table, content)
    pieces = chain([frame(table, [])], change(present))
    if before is None:
        rows = next((one for one in pieces if one.height), None)
        if rows is None:
            return NewFile(path, None, None, lost_rows)
        pieces = chain([rows], pieces)
    prepared = prepare_table(path, pieces)
    if prepared.sha256 == before:
        prepared.drop()
        return NewFile(path, before, before)
    return NewFile(path, before, prepared.sha256, lost_rows, prepared)


def prepare_whole(path: Path, rows: pl.DataFrame) -> NewFile:
    """Prepare a file that replaces the present one, whatever that is; raises as `prepare_table`."""
    try:
        before: str | None = hashlib.sha256(read(path)).hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        before = None
    except OSError:
        before = UNREADABLE
    prepared = prepare_table(path, [rows])
    if prepared.sha256 == before:
        prepared.drop()
        return NewFile(path, before, before)
    return NewFile(path, before, prepared.sha256, prepared=prepared)


def with_nights(table: Table, new: Iterable[tuple[dt.date, NewRows]]) -> Change:
    """The change that replaces the rows of some motors and nights; the nights come in order."""

    def change(present: Iterator[pl.DataFrame]) -> Iterator[pl.DataFrame]:
        stored = _Stored(present)
        for night, rows in new:
            yield from stored.until(pl.col("night") < night)
            here = pl.concat(
                [pl.DataFrame(schema=table.schema), *stored.until(pl.col("night") == night)]
            )
            kept = here.filter(~pl.col("motor_id").is_in(rows.motor_ids))
            yield from _merged(kept, rows.pieces, table)
        yield from stored.rest()

    return change


class _Stored:
    """Rows of a file, taken from the front."""

    def __init__(self, groups: Iterator[pl.DataFrame]) -> None:
        self._groups = groups
        self._front: pl.DataFrame | None = next(groups, None)

    def until(self, is_taken: pl.Expr) -> Iterator[pl.DataFrame]:
        """The rows at the front of which something is true."""
        while self._front is not None:
            count = self._front.select(is_taken.sum()).item()
            yield self._front.head(count)
            if count < self._front.height:
                self._front = self._front.slice(count)
                return
            self._front = next(self._groups, None)

    def rest(self) -> Iterator[pl.DataFrame]:
        """All rows that are left."""
        if self._front is not None:
            yield self._front
            yield from self._groups


def _merged(
    kept: pl.DataFrame, pieces: Iterable[pl.DataFrame], table: Table
) -> Iterator[pl.DataFrame]:
    """Rows that stay and new ones, in order of the key, which begins with the motor."""
    for rows in pieces:
        if rows.height:
            is_before = pl.col("motor_id") <= rows["motor_id"][-1]
            yield pl.concat([kept.filter(is_before), rows]).sort(table.order)
            kept = kept.filter(~is_before)
    yield kept


def with_keys(table: Table, rows: pl.DataFrame, replaced: pl.DataFrame | None = None) -> Change:
    """The change that adds rows, in place of those of the same key or of some others."""

    def change(present: Iterator[pl.DataFrame]) -> Iterator[pl.DataFrame]:
        kept = [one.join(rows, on=list(table.key), how="anti") for one in present]
        if replaced is not None:
            kept = [one.join(replaced, on=replaced.columns, how="anti") for one in kept]
        yield pl.concat([*kept, rows]).sort(table.order)

    return change


def _present(
    path: Path, table: Table, accepted: Collection[str | None]
) -> tuple[str | None, bytes | None]:
    """Hash and content of a file; no hash if there is no file, no content if it is damaged.

    A file is damaged if it reads as such twice: an error on the way from the disk is none.
    """
    digest: str | None = None
    for attempt in range(2):
        digest = UNREADABLE
        try:
            content = read(path)
            digest = hashlib.sha256(content).hexdigest()
            _require_sound(path, table, content, digest, accepted)
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
        else:
            return digest, content
        if attempt:
            log.warning("%s; it is put aside, and the next run makes its nights anew", fault)
    return digest, None


def _require_sound(
    path: Path, table: Table, content: bytes, digest: str, accepted: Collection[str | None]
) -> None:
    """Compare a file with its digests; of one that is not listed the pages prove themselves."""
    if not accepted:
        deque(groups_of(path, table, content), maxlen=0)
    elif digest not in accepted:
        raise damaged(path, table, ValueError("it is not what was published"))

"""Publishing of staged rows: night by night, each file whole, its manifest before and after it."""

from __future__ import annotations

import datetime as dt
import os
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, TypeVar

import polars as pl

from pipeline.errors import StoreError
from pipeline.schema import Table, frame
from pipeline.store.atomic_files import flush_folders, move, remove_all
from pipeline.store.encoding import encode_table
from pipeline.store.manifest import (
    Key,
    Manifest,
    announce,
    manifest_key,
    read_manifest,
    update_manifest,
)
from pipeline.store.months import part_month
from pipeline.store.night_files import (
    MOTORS_AT_ONCE,
    NewRows,
    NightFile,
    StagedRows,
    new_rows,
    prepare_file,
    prepare_night,
)
from pipeline.store.tables import (
    PUT_ASIDE,
    days_of,
    month_file,
    night_file,
    read_rows,
    run_file,
    whole_file,
)

Item = TypeVar("Item")
Result = TypeVar("Result")

# Lets the next run make nights anew for all motors but some.
Forget = Callable[[Collection[dt.date], Collection[str]], object]
# Nights of motors that are prepared together, where few motors have few rows a night.
NIGHTS_AT_ONCE = 400


_Prepared = tuple[NightFile, dt.date, tuple[str, ...]]


@dataclass(slots=True)
class Publisher:
    """Publishes the rows that the tasks of a run have staged.

    Parameters
    ----------
    output, staging
        Output folder, and the run's folder of staged rows.
    run_id
        Goes into every row.
    threads
        Tables whose files are prepared at once.

    Attributes
    ----------
    damaged
        Files that were damaged and put aside, by path relative to the folder of the tables.
    months
        Months in which it has published nights, YYYY-MM.
    """

    output: Path
    staging: Path
    run_id: str
    threads: int = 1
    damaged: list[str] = field(default_factory=list)
    months: set[str] = field(default_factory=set)

    def nights(
        self,
        folder: str,
        tables: Iterable[Table],
        motor_ids: Sequence[str],
        forget: Forget,
    ) -> None:
        """Publish the staged rows of some motors, the oldest night first.

        Parameters
        ----------
        folder
            Below the staging folder, with a file of staged rows a motor.
        tables, motor_ids
            Tables, and motors whose rows are published.
        forget
            Called before a damaged file is replaced: its rows are then made anew, even if this run
            is broken off.

        Raises
        ------
        StoreError
            If a file cannot be written.
        """
        paths = {one: self.staging / folder / f"{one}.arrow" for one in motor_ids}
        files = {one: StagedRows(path) for one, path in paths.items() if path.exists()}
        staged = {
            table: {one: file for one, file in files.items() if table.name in file.heights}
            for table in tables
        }
        nights = {
            night for file in files.values() for some in file.heights.values() for night in some
        }
        months = {f"{night:%Y-%m}" for night in nights}
        self.months |= months
        for month in sorted(months):
            for table in part_month(self.output, self.staging, staged, month):
                self._give_up(table, month, staged[table], forget)
        for table, motors in staged.items():
            if "night" not in table.key:
                self._vacate(table, motors, forget)
        size = NIGHTS_AT_ONCE // len(files) if 0 < len(files) <= MOTORS_AT_ONCE else 1
        ordered = sorted(nights)
        for some in (ordered[at : at + size] for at in range(0, len(ordered), size)):
            # A table's rows are read when its files are prepared.
            new = {
                table: partial(new_rows, table, motors, some, self.run_id)
                for table, motors in staged.items()
            }
            self._publish(some, new, forget)
        # Of no further use: what is not on the disk yet need not be written to it.
        remove_all(self.staging / folder)

    def _give_up(
        self, table: Table, month: str, staged: Mapping[str, StagedRows], forget: Forget
    ) -> None:
        """Put a damaged file of a month aside, and let its nights be made anew."""
        path = month_file(self.output, table, month)
        name = self._name_of(path)
        self.damaged.append(name)
        for night in days_of(month):
            new = {
                motor_id for motor_id, rows in staged.items() if night in rows.heights[table.name]
            }
            forget((night,), new)
        move(path, path.with_suffix(PUT_ASIDE))
        update_manifest(self.output, month, month, {name: None})

    def _vacate(self, table: Table, staged: Mapping[str, StagedRows], forget: Forget) -> None:
        """Remove rows that move to an earlier night from the later one, before they are there.

        A key without the night would otherwise be in two files for a moment.
        """
        key = list(table.key)
        places: defaultdict[dt.date, list[pl.DataFrame]] = defaultdict(list)
        nights = sorted({night for rows in staged.values() for night in rows.heights[table.name]})
        if len(nights) < 2:
            return
        for night, new in new_rows(table, staged, nights, self.run_id).items():
            if new.height:
                places[night] += [rows.select(key) for rows in new.pieces]
        for night in nights:
            earlier = [keys for other, some in places.items() if other < night for keys in some]
            if not earlier:
                continue
            try:
                present = read_rows(self.output, table, list(staged), nights=[night])
            except StoreError:
                continue  # nobody can read it, and it is replaced
            kept = present.join(pl.concat(earlier), on=key, how="anti", maintain_order="left")
            if kept.height < present.height:
                left = present.join(kept, on=key, how="anti")["motor_id"].unique()
                rows = kept.filter(pl.col("motor_id").is_in(left.implode()))
                rows = rows.with_columns(run_id=pl.lit(self.run_id)).sort(table.key)
                without = {night: NewRows(tuple(left), rows.height, [rows])}
                self._publish([night], {table: partial(dict, without)}, forget)

    def _publish(
        self,
        nights: Sequence[dt.date],
        new: Mapping[Table, Callable[[], Mapping[dt.date, NewRows]]],
        forget: Forget,
    ) -> None:
        """Prepare all files of some nights, announce them, and put them into their places."""
        manifests = {
            night: read_manifest(self.output, f"{night:%Y-%m}", str(night)) or Manifest()
            for night in nights
        }
        with ExitStack() as undone:

            def prepared(table: Table, stopped: Event) -> list[_Prepared]:
                """Files of a table, each with its night and the motors with new rows."""
                files: list[_Prepared] = []
                for night, rows in new[table]().items():
                    if stopped.is_set():
                        break
                    name = self._name_of(night_file(self.output, table, night))
                    accepted = manifests[night].accepted(name)
                    file = prepare_night(self.output, table, night, rows, accepted)
                    undone.callback(file.drop)
                    files.append((file, night, rows.motor_ids))
                return files

            # Writing, packing and flushing let other threads go on.
            found = [one for some in _side_by_side(prepared, new, self.threads) for one in some]
            for file, night, motor_ids in found:
                if file.lost_rows:
                    if file.before is not None:
                        self.damaged.append(self._name_of(file.path))
                    forget((night,), set(motor_ids))
            self._land([file for file, _, _ in found])
            undone.pop_all()

    def whole(self, table: Table, rows: pl.DataFrame) -> None:
        """Publish a table that is one file; raises as `nights`."""
        self.put({whole_file(self.output, table): rows})

    def of_run(
        self, started: dt.datetime, rows: Mapping[Table, Sequence[Mapping[str, Any]]]
    ) -> None:
        """Publish the tables that have a file for each run; raises as `nights`."""
        files = {
            run_file(self.output, table, started): frame(table, some)
            for table, some in rows.items()
        }
        self.put(files)

    def put(self, files: Mapping[Path, pl.DataFrame]) -> None:
        """Publish files of one manifest that replace the present ones; raises as `nights`."""
        with ExitStack() as undone:
            prepared = []
            for path, rows in files.items():
                prepared.append(prepare_file(path, encode_table(path.name, rows)))
                undone.callback(prepared[-1].drop)
            self._land(prepared)
            undone.pop_all()

    def _land(self, files: Sequence[NightFile]) -> None:
        """Put files into their places; their manifests list old and new ones meanwhile."""
        by_manifest: defaultdict[Key, dict[str, NightFile]] = defaultdict(dict)
        for file in files:
            name = self._name_of(file.path)
            by_manifest[manifest_key(name)][name] = file
        for key, some in sorted(by_manifest.items()):
            # The digest of a damaged file is not accepted.
            changes = {
                name: (None if file.lost_rows else file.before, file.after)
                for name, file in some.items()
            }
            announce(self.output, *key, changes)
        for file in files:
            file.land()
        flush_folders({file.path.parent for file in files if file.prepared is not None})
        for key, some in sorted(by_manifest.items()):
            update_manifest(self.output, *key, {name: file.after for name, file in some.items()})

    def _name_of(self, path: Path) -> str:
        """Path relative to the folder of the tables, as manifests name it."""
        return path.relative_to(self.output / "tables").as_posix()


def _side_by_side(
    work: Callable[[Item, Event], Result], items: Collection[Item], threads: int
) -> list[Result]:
    """Results by item in their order; a failure or a signal stops the work on the others.

    `work` stops where its event is set, and looks at it between pieces that take little time.
    """
    stopped = Event()
    threads = min(threads, len(items), os.cpu_count() or 1)
    if threads < 2:
        return [work(item, stopped) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        under_way = [pool.submit(work, item, stopped) for item in items]
        try:
            wait(under_way, return_when=FIRST_EXCEPTION)
        finally:
            stopped.set()
    return [one.result() for one in under_way]

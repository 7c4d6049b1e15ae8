"""Publishing of staged rows: night by night, each file whole, its manifest before and after it."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.errors import StoreError
from pipeline.schema import Table, frame
from pipeline.store.atomic_files import move
from pipeline.store.manifest import (
    Manifest,
    announce,
    manifest_key,
    read_manifest,
    update_manifest,
)
from pipeline.store.months import part_month
from pipeline.store.tables import (
    PUT_ASIDE,
    NightFile,
    StagedRows,
    days_of,
    encode_table,
    month_file,
    prepare_file,
    prepare_night,
    read_rows,
    run_file,
    whole_file,
)

# Completes all rows of a night, given the motors whose rows are new.
Finish = Callable[[pl.DataFrame, Sequence[str]], pl.DataFrame]
# Lets the next run make nights anew for all motors but some.
Forget = Callable[[Path, Collection[dt.date], Collection[str]], object]
Rows = Mapping[str, pl.DataFrame]


@dataclass(slots=True)
class Publisher:
    """Publishes the rows that the tasks of a run have staged.

    Parameters
    ----------
    output, staging
        Output folder, and the run's folder of staged rows.
    run_id
        Goes into every row.

    Attributes
    ----------
    lost
        Nights of which a file was damaged, with the motors whose rows are new: those of the others
        have to be made anew.
    damaged
        Files that were put aside for it, by path relative to the folder of the tables.
    months
        Months in which it has published nights, YYYY-MM.
    """

    output: Path
    staging: Path
    run_id: str
    lost: dict[dt.date, set[str]] = field(default_factory=dict)
    damaged: list[str] = field(default_factory=list)
    months: set[str] = field(default_factory=set)

    def nights(
        self,
        tables: Iterable[Table],
        motor_ids: Sequence[str],
        forget: Forget,
        finish: Mapping[str, Finish] | None = None,
    ) -> None:
        """Publish the staged rows of some motors, the oldest night first.

        Parameters
        ----------
        tables, motor_ids
            Tables, and motors whose rows are published.
        forget
            Called before a damaged file is replaced: its rows are then made anew, even if this run
            is broken off.
        finish
            By table, completes a night's rows.

        Raises
        ------
        StoreError
            If a file cannot be written.
        """
        staged = {table: self.staged(table, motor_ids) for table in tables}
        nights = {n for motors in staged.values() for rows in motors.values() for n in rows.nights}
        months = {f"{night:%Y-%m}" for night in nights}
        self.months |= months
        for month in sorted(months):
            for table in part_month(self.output, self.staging, staged, month):
                self._give_up(table, month, staged[table], forget)
        for table, motors in staged.items():
            if "night" not in table.key:
                self._vacate(table, motors, forget)
        for night in sorted(nights):
            # One table at a time: all rows of a large fleet would fill the memory.
            here = {table: partial(_of_night, some, night) for table, some in staged.items()}
            self._night(night, here, forget, finish or {})

    def staged(self, table: Table, motor_ids: Sequence[str]) -> dict[str, StagedRows]:
        """Staged rows of a table by motor, of those that have some."""
        folder = self.staging / table.name
        paths = {motor_id: folder / f"{motor_id}.arrow" for motor_id in motor_ids}
        return {motor_id: StagedRows(path) for motor_id, path in paths.items() if path.exists()}

    def _give_up(
        self, table: Table, month: str, staged: Mapping[str, StagedRows], forget: Forget
    ) -> None:
        """Put a damaged file of a month aside, and let its nights be made anew."""
        path = month_file(self.output, table, month)
        name = path.relative_to(self.output / "tables").as_posix()
        self.damaged.append(name)
        for night in days_of(month):
            new = {motor_id for motor_id, rows in staged.items() if night in rows.nights}
            self.lost.setdefault(night, set()).update(new)
            forget(self.output, (night,), new)
        move(path, path.with_suffix(PUT_ASIDE))
        update_manifest(self.output, month, month, {name: None})

    def _vacate(self, table: Table, staged: Mapping[str, StagedRows], forget: Forget) -> None:
        """Remove rows that move to an earlier night from the later one, before they are there.

        A key without the night would otherwise be in two files for a moment.
        """
        key = list(table.key)
        places: defaultdict[dt.date, list[pl.DataFrame]] = defaultdict(list)
        for rows in staged.values():
            for night in rows.nights:
                found = rows.rows(night)
                if found is not None and found.height:
                    places[night].append(found.select(key))
        for night in sorted({night for rows in staged.values() for night in rows.nights}):
            earlier = [keys for other, some in places.items() if other < night for keys in some]
            if not earlier:
                continue
            try:
                present = read_rows(self.output, table, list(staged), nights=[night])
            except StoreError:
                continue  # nobody can read it, and it is replaced
            kept = present.join(pl.concat(earlier), on=key, how="anti", maintain_order="left")
            if kept.height < present.height:
                left = present.join(kept, on=key, how="anti")["motor_id"].unique().sort()
                rows_of = {
                    motor_id: kept.filter(pl.col("motor_id") == motor_id).drop("run_id")
                    for motor_id in left
                }
                self._night(night, {table: partial(dict, rows_of)}, forget, {})

    def _night(
        self,
        night: dt.date,
        new: Mapping[Table, Callable[[], Rows]],
        forget: Forget,
        finish: Mapping[str, Finish],
    ) -> None:
        """Prepare all files of a night, announce them, and put them into their places."""
        manifest = read_manifest(self.output, f"{night:%Y-%m}", night.isoformat()) or Manifest()
        files: list[NightFile] = []
        with ExitStack() as undone:
            for table, rows_of in new.items():
                if not (motors := rows_of()):
                    continue
                last = partial(_finished, finish.get(table.name), list(motors))
                name = f"{table.name}/month={night:%Y-%m}/{night}.parquet"
                file = prepare_night(
                    self.output, table, night, motors, self.run_id, last, manifest.accepted(name)
                )
                undone.callback(file.drop)
                files.append(file)
                if file.lost_rows:
                    if file.before is not None:
                        self.damaged.append(name)
                    self.lost.setdefault(night, set()).update(motors)
                    forget(self.output, (night,), set(motors))
            self._land(files)
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
        """Put files of one manifest into their places; it lists old and new ones meanwhile."""
        root = self.output / "tables"
        by_name = {file.path.relative_to(root).as_posix(): file for file in files}
        key = manifest_key(next(iter(by_name)))
        # The digest of a damaged file is not accepted.
        before = {name: None if file.lost_rows else file.before for name, file in by_name.items()}
        after = {name: file.after for name, file in by_name.items()}
        announce(self.output, *key, {name: (before[name], after[name]) for name in by_name})
        for file in files:
            file.land()
        update_manifest(self.output, *key, after)


def _of_night(staged: Mapping[str, StagedRows], night: dt.date) -> Rows:
    """New rows of a night, by motor that has done it."""
    found = {motor_id: rows.rows(night) for motor_id, rows in staged.items()}
    return {motor_id: rows for motor_id, rows in found.items() if rows is not None}


def _finished(finish: Finish | None, motor_ids: Sequence[str], rows: pl.DataFrame) -> pl.DataFrame:
    return rows if finish is None else finish(rows, motor_ids)

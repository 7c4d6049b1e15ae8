"""Publishing of staged rows, month by month.

New files are written beside their places, flushed and read back; noted as coming; renamed; and
noted as published, in one transaction with what the caller has to say of them.
"""

from __future__ import annotations

import datetime as dt
import os
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import polars as pl

from pipeline.schema import NIGHTLY_TABLES, TREND_TABLES, Table, frame
from pipeline.store.atomic_files import flush_folders, remove_all
from pipeline.store.night_files import (
    Change,
    NewFile,
    StagedRows,
    new_rows,
    prepare_file,
    prepare_whole,
    with_keys,
    with_nights,
)
from pipeline.store.published import accepted, announce, note
from pipeline.store.state import State
from pipeline.store.tables import days_of, month_file, name_of, night_file, whole_file

Item = TypeVar("Item")
Result = TypeVar("Result")

# Lets the next run make nights anew for all motors but some.
Forget = Callable[[Collection[dt.date], Collection[str]], object]

# Staged rows of a table by motor.
_Staged = Mapping[str, StagedRows]


@dataclass(slots=True)
class Publisher:
    """Publishes the rows that the tasks of a run have staged.

    Parameters
    ----------
    state, staging
        State of the output, and the run's folder of staged rows.
    run_id
        Goes into every row.
    threads
        Tables whose files are prepared at once.

    Attributes
    ----------
    damaged
        Files that were damaged and put aside, by path relative to the folder of the tables.
    """

    state: State
    staging: Path
    run_id: str
    threads: int = 1
    damaged: list[str] = field(default_factory=list)

    def nights(
        self,
        folder: str,
        tables: Iterable[Table],
        motor_ids: Sequence[str],
        forget: Forget,
        published: Callable[[], object] = lambda: None,
    ) -> None:
        """Publish the staged rows of some motors, the oldest month first.

        Parameters
        ----------
        folder
            Below the staging folder, with a file of staged rows a motor.
        tables, motor_ids
            Tables, and motors whose rows are published.
        forget
            Called before a damaged file is replaced: its rows are then made anew, even if this run
            is broken off.
        published
            Called in the transaction that notes the last files.

        Raises
        ------
        StoreError
            If a file cannot be written.
        """
        paths = {one: self.staging / folder / f"{one}.arrow" for one in motor_ids}
        files = {one: StagedRows(path) for one, path in paths.items() if path.exists()}
        months: defaultdict[str, set[dt.date]] = defaultdict(set)
        for file in files.values():
            for night in {night for heights in file.heights.values() for night in heights}:
                months[f"{night:%Y-%m}"].add(night)
        staged = {
            table: {one: file for one, file in files.items() if table.name in file.heights}
            for table in tables
        }
        for table, motors in staged.items():
            if "night" not in table.key and len(months) > 1:
                self._vacate(table, motors, months)
        for month, nights in sorted(months.items()):
            also = published if month == max(months) else lambda: None
            self._publish_month(staged, sorted(nights), forget, also)
        if not months:
            with self.state.transaction():
                published()
        # Of no further use: what is not on the disk yet need not be written to it.
        remove_all(self.staging / folder)

    def whole(self, table: Table, rows: pl.DataFrame) -> None:
        """Publish a table that is one file; raises as `nights`."""
        with ExitStack() as undone:
            file = prepare_whole(whole_file(self.output, table), rows)
            undone.callback(file.drop)
            self._land([file])
            undone.pop_all()

    def add(self, month: str, rows: Mapping[Table, Sequence[Mapping[str, Any]]]) -> None:
        """Add rows to a month (YYYY-MM) of tables; those of the same key go; raises as `nights`."""
        with ExitStack() as undone:
            files = []
            for table, some in rows.items():
                path = month_file(self.output, table, month)
                change = with_keys(table, frame(table, some))
                files.append(prepare_file(path, table, change, self._accepted(path)))
                undone.callback(files[-1].drop)
            self._land(files)
            undone.pop_all()

    def _publish_month(
        self,
        staged: Mapping[Table, _Staged],
        nights: Sequence[dt.date],
        forget: Forget,
        published: Callable[[], object],
    ) -> None:
        """Prepare all files with some nights of a month, and put them into their places."""
        with ExitStack() as undone:

            def prepare(table: Table) -> list[NewFile]:
                files = []
                for path, change in self._changes(table, staged[table], nights):
                    files.append(prepare_file(path, table, change, self._accepted(path)))
                    undone.callback(files[-1].drop)
                return files

            made = dict(zip(staged, side_by_side(prepare, staged, self.threads), strict=True))
            for table, files in made.items():
                for file in files:
                    if file.lost_rows:
                        self._give_up(file, table, staged[table], forget)
            self._land([file for files in made.values() for file in files], published)
            undone.pop_all()

    def _changes(
        self, table: Table, staged: _Staged, nights: Sequence[dt.date]
    ) -> Iterator[tuple[Path, Change]]:
        """What is new in the files of a table with some nights of a month."""
        new = new_rows(table, staged, nights, self.run_id)
        path = night_file(self.output, table, nights[0])
        if table in NIGHTLY_TABLES:
            for night, rows in new:
                yield night_file(self.output, table, night), with_nights(table, [(night, rows)])
        elif "night" in table.key:
            yield path, with_nights(table, new)
        else:
            found = list(new)
            every = [frame(table, []), *(piece for _, rows in found for piece in rows.pieces)]
            done = [(one, night) for night, rows in found for one in rows.motor_ids]
            replaced = pl.DataFrame(
                done, schema={"motor_id": pl.String, "night": pl.Date}, orient="row"
            )
            yield path, with_keys(table, pl.concat(every), replaced)

    def _vacate(
        self, table: Table, staged: _Staged, months: Mapping[str, Collection[dt.date]]
    ) -> None:
        """Remove rows that move to another month before they are there.

        A key without the night would otherwise be in two files for a moment.
        """
        keys = {
            month: [
                piece.select(table.key)
                for _, rows in new_rows(table, staged, sorted(nights), self.run_id)
                for piece in rows.pieces
            ]
            for month, nights in months.items()
        }
        for month in sorted(months):
            path = month_file(self.output, table, month)
            others = [one for other, some in keys.items() if other != month for one in some]
            if not (path.exists() and others):
                continue
            change = with_keys(table, frame(table, []), pl.concat(others))
            file = prepare_file(path, table, change, self._accepted(path))
            if file.lost_rows:  # nobody can read it, and it is replaced
                file.drop()
            else:
                self._land([file])

    def _give_up(self, file: NewFile, table: Table, staged: _Staged, forget: Forget) -> None:
        """Let the nights of a damaged file be made anew, but for what comes with the new one."""
        if file.before is not None:
            self.damaged.append(name_of(self.output, file.path))
        elif table in TREND_TABLES:
            return  # it was missed before its trends were made, and they are complete
        for night in days_of(file.path.stem):
            new = {one for one, rows in staged.items() if night in rows.heights[table.name]}
            forget((night,), new)

    @property
    def output(self) -> Path:
        """The output folder."""
        return self.state.output

    def _accepted(self, path: Path) -> tuple[str, ...]:
        return accepted(self.state, name_of(self.output, path))

    def _land(
        self, files: Sequence[NewFile], published: Callable[[], object] = lambda: None
    ) -> None:
        """Put files into their places, and note them before and afterwards."""
        named = {name_of(self.output, file.path): file for file in files}
        coming = {name: one.after for name, one in named.items() if one.prepared is not None}
        announce(self.state, coming)
        for file in files:
            file.land()
        flush_folders({file.path.parent for file in files if file.prepared is not None})
        with self.state.transaction():
            note(self.state, {name: one.after for name, one in named.items()})
            published()


def side_by_side(
    work: Callable[[Item], Result], items: Collection[Item], threads: int
) -> list[Result]:
    """Results by item in their order; after a failure those that wait are not begun."""
    threads = min(threads, len(items), os.cpu_count() or 1)
    if threads < 2:
        return list(map(work, items))
    with ThreadPoolExecutor(threads) as pool:
        under_way = [pool.submit(work, item) for item in items]
        try:
            wait(under_way, return_when=FIRST_EXCEPTION)
            return [one.result() for one in under_way if one.done()]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
